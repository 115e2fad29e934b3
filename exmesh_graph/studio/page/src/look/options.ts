// How things are looked at: shared by both sides, so that two artifacts are seen alike.
import { create } from "zustand";

export interface LookOptions {
  mode: "beside" | "wipe"; cut: number; // share of the width left of the line
  show: string; // id of what is shown of an artifact
  index: number; single: boolean; layer: string; map: string; // views and maps
  shown: string; light: string; turn: number; exposure: number; behind: boolean; turntable: boolean; full: boolean; // models
  x: number; y: number; zoom: number; // pictures: place of the middle (0 to 1) and magnification
}

export const useLook = create<LookOptions>(() => ({
  mode: "beside", cut: 0.5, show: "", index: 0, single: false, layer: "", map: "", shown: "shaded", light: "recovered", turn: 0, exposure: 0,
  behind: false, turntable: false, full: false, x: 0.5, y: 0.5, zoom: 1,
}));
export const setLook = useLook.setState;
