// What the server says: the HTTP contract of exmesh_graph/studio (docs/studio.md).

export type Json = null | boolean | number | string | Json[] | { [key: string]: Json };
export type Op = { [key: string]: Json };

export interface Parameter {
  name: string; type: string; value: Json; text: string; default: Json; set: boolean; unit: string; doc: string;
  ge: number | null; gt: number | null; le: number | null; lt: number | null; multiple_of: number | null;
  choices: Json[] | null; optional: boolean; required: boolean; tuning: boolean; auto: string; reference: string;
  rounds_differ: boolean; target: string; path: boolean;
}

export interface Port {
  port: string; types: string[]; label: string; optional?: boolean; component?: boolean; facets: { [name: string]: Json };
  wired?: boolean; doc?: string;
}

export interface Layer { when: string; round: number; type: string; set: { [name: string]: Json } }

export interface GraphNode {
  id: string; name: string; kind: "node" | "component" | "block" | "part"; type: string; family: string; parent: string;
  doc: string; comment: string; version: string; traits: string[]; file: string; line: number; names: string[]; inputs: Port[]; outputs: Port[]; parameters: Parameter[]; layers: Layer[];
  problems: number; editable: string[]; bypassed: boolean; repeat?: number; repeat_text?: string; graph?: string;
}

export interface End { node: string; port: string; side: string }

export interface Wire {
  id: string; from: End; to: End; label: string; kind: "artifact" | "component"; text: string; target: string;
  rounds: string | null; problem: boolean;
}

export interface Problem {
  code: string; what: string; file: string; line: number; where: string; node: string; port: string; wire: string;
  expected: string; found: string; nearest: string[]; fix: string; rounds: number;
}

export interface Output { type: string; digest: string; bytes: number }
export type Outputs = { [port: string]: Output };

export interface PlannedRound { name: string; state: string; reason: string; seconds: number | null; key: string; outputs?: Outputs }
export interface Planned { state: string; reason: string; seconds: number | null; known: boolean; rounds: PlannedRound[] }
export interface Plan {
  counts: { hit: number; run: number; unknown: number }; seconds: number; complete: boolean; nodes: { [id: string]: Planned };
}

export interface Variant { name: string; doc: string; patches: number }

export interface Graph {
  nodes: GraphNode[]; wires: Wire[]; outputs: { name: string; node: string; port: string }[];
}

export interface Document extends Graph {
  revision: number; file: string; path: string; name: string; doc: string; variant: string; variants: Variant[];
  folder: string; store: string; runs: string; seed: number; params: Parameter[]; problems: Problem[]; patch: string;
  ops: Op[]; can_undo: boolean; can_redo: boolean; dirty: boolean; plan: Plan | null; plan_pending?: boolean; disk: "same" | "changed"; events: number;
}

export interface NodeType {
  type: string; family: string; kind: "node" | "component"; doc: string; title: string; version: string;
  traits: string[]; libraries: string[]; inputs: Port[]; outputs: Port[]; parameters: Parameter[]; plug?: string;
}
export interface Catalog { types: NodeType[]; broken: { [pack: string]: string }; wire_types: { [type: string]: string[] } }

export interface EndChoice { node: string; port: string; side?: string; link: string; ok: boolean; why: string; in_use: boolean; target?: string }
export interface Ends { port: Port; target?: string; ends: EndChoice[]; types: string[] }

export interface Headline { value: Json; unit?: string; floor?: number | null; goal?: number | null; better?: string; node?: string; after_seconds?: number }

export interface Run {
  id: string; graph: string; file: string; variant: string; state: string; started: number; seconds: number;
  left: number | null; nodes: number; ready: number; hits: number; running: string[]; at: Json[]; failed: string[];
  ours: boolean; sweep: boolean; can_stop: boolean; can_resume: boolean; headline: { [label: string]: Headline };
  report: boolean; label: string;
}

export interface Failure { message: string; error: string; traceback: string; replay: string; run_again: string; node_alone: string; file: string; at: string }
export interface Progress { step: number; total: number; left: number | null; figures: { [name: string]: number }; message?: string }

export interface NodeState {
  name: string; id: string; type: string; state: string; seconds: number | null; spent: number | null;
  peak_memory: number | null; began: number | null; progress: Progress | null; warnings: string[]; outputs: Outputs | null;
  failure: Failure | null; key?: string | null;
}
export interface RunDetail extends Run { nodes_detail: NodeState[]; command: string; machine: { [key: string]: Json } }

export interface Curve { node: string; name: string; axis: string; x: number[]; y: number[]; t?: number[] }
export interface LogLine { kind: string; time: number; text: string; node?: string }

export interface Show {
  kind: string; id: string; title: string; count?: number; names?: string[]; layers?: string[]; width?: number; height?: number;
  levels?: number; has?: string[]; faces?: number; vertices?: number; caption?: string;
  items?: GalleryItem[]; files?: { path: string; bytes: number }[]; main?: string; facts?: { [name: string]: Json };
}
export interface GalleryItem { file: string; title: string; caption: string; compare?: number; model: boolean }
export interface Artifact {
  digest: string; type: string; bytes: number; title: string; facets: { [name: string]: Json }; made_by: string; shows: Show[];
}
export interface Table { columns: string[]; rows: Json[][]; note: string }

export interface SweepFigure { mean: number | null; spread: number | null; difference: number | null; exceeds: boolean | null; unit: string; better: string; text?: string; verdict?: string }
export interface SweepRow { variant: string; state: string; figures: { [label: string]: SweepFigure }; seconds: number; shared: number; nodes: number }
export interface SweepMember { variant: string; repeat: number; nodes: { [name: string]: string } }
export interface SweepResult { table: { labels: string[]; rows: SweepRow[]; members?: SweepMember[] }; page: string }
export interface AblationVariant { name: string; patches: Op[]; how: string; why: string }
export interface Ablation {
  variants: AblationVariant[]; text: string;
  plan: { variants: { name: string; nodes: number; shared: number; counts: { [state: string]: number } }[]; nodes: number; distinct: number };
}
export interface Comparison {
  lines: string[]; figures: { label: string; a: Json; b: Json; unit: string; better: string }[];
  nodes: { name: string; same: boolean; a: Outputs | null; b: Outputs | null }[];
}
export interface TextView { file: string; text: string; patch: string; new_text: string; diff: string; why_not?: { what: string; fix?: string } }
