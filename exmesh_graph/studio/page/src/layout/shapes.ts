// What the layout is given and what it gives back. x runs along the flow (left to right), y across it; pixels.

export interface BoxShape {
  id: string; width: number; height: number; scopes: string[]; // frames around it, from the outermost on
  inputs: Map<string, number>; outputs: Map<string, number>; // port -> y from the centre of the box
}

export interface FrameShape { id: string; scopes: string[]; inputs: string[]; outputs: string[] }

// `inner`: the end that a frame shows to what lies in it (what a round begins with, what it hands on).
export interface WireEnd { id: string; port: string; inner: boolean }
export interface WireShape { id: string; from: WireEnd; to: WireEnd }

export type Point = readonly [number, number];

export interface Rect { x: number; y: number; width: number; height: number }

export interface Layout {
  width: number; height: number;
  boxes: Map<string, Rect>;
  frames: Map<string, Rect & { inputs: Map<string, number>; outputs: Map<string, number> }>; // port -> y from its top
  paths: Map<string, Point[]>; // wire -> corners, from its start to its end
}
