// report/view/viewer.js: the viewer of `exmesh view` and of run reports.
declare module "viewer" {
  import type { BufferGeometry, Material, Mesh, PerspectiveCamera, Scene, Texture, WebGLRenderer, Color } from "three";
  import type { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
  export interface Model { geometry: BufferGeometry; maps: { [name: string]: Texture }; materials: { [name: string]: Material }; light: Texture | null; eye?: number[] }
  export function lightOf(told: { width: number; height: number; data: Uint16Array }): Texture;
  export function readModel(bytes: Uint8Array): Promise<Model>;
  export class Viewer {
    constructor(canvas: HTMLCanvasElement, options?: { azimuth?: number; background?: number });
    renderer: WebGLRenderer; scene: Scene; camera: PerspectiveCamera; controls: OrbitControls; mesh: Mesh; solid: Mesh; plain: Color; stale: boolean; model?: Model;
    show(model: Model, options: { light?: Texture | null; shown?: string; turn?: number; exposure?: number; behind?: boolean; turntable?: boolean }): void;
    resize(width: number, height: number): void;
    run(drawn?: () => void): void;
  }
}
