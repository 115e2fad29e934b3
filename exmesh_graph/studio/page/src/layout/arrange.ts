// Places boxes and wires as report/drawing/layout.py does, turned by 90 degrees and with ports: columns are longest paths
// from the sources, a wire that skips columns runs through one way point in each, boxes are ordered by the barycentre
// heuristic (Sugiyama, Tagawa, Toda 1981) and then moved as near to their neighbours as the order allows. A frame is laid
// out by itself and takes part in the layout around it as one box.
import { apart, crossings } from "./place";
import type { BoxShape, FrameShape, Layout, Point, WireEnd, WireShape } from "./shapes";

const GAP_ALONG = 40, GAP_ACROSS = 18, MARGIN = 22, TITLE = 30, WAY = 8;

interface Key { kind: "box" | "way" | "in" | "out"; name: string; column: number; text: string; at: number } // `at`: its number
interface Link { left: Key; right: Key; source: string; wires: WireShape[]; from: WireEnd; to: WireEnd | null }

export function arrange(boxes: BoxShape[], frames: FrameShape[], wires: WireShape[]): Layout {
  return new Scope([], boxes, frames, wires).lay().layout;
}

const sourceOf = (end: WireEnd) => `${end.id}|${end.inner ? "inner" : ""}|${end.port}`;

class Scope {
  private readonly path: string;
  private readonly itemOf = new Map<string, string>(); // box, frame or "frame::inner" -> the item of this scope it lies in
  private readonly leaves = new Map<string, BoxShape>();
  private readonly inner = new Map<string, { layout: Layout; ins: Map<string, number>; outs: Map<string, number>; mine: FrameShape }>();
  private readonly column = new Map<string, number>();
  private readonly links = new Map<string, Link>();
  private readonly chains = new Map<string, Key[]>(); // wire -> the keys it runs through
  private readonly before: [Key, Link][][] = []; // of each key by its number: what is wired to it from the left, and how
  private readonly after: [Key, Link][][] = [];
  private readonly keys = new Map<string, Key>();
  private last = 0;

  constructor(private readonly scopes: string[], boxes: BoxShape[], frames: FrameShape[], private readonly wires: WireShape[]) {
    this.path = scopes.join("\n");
    const depth = scopes.length;
    const inside = (other: string[]) => other.length >= depth && scopes.every((name, k) => other[k] === name);
    for (const box of boxes) {
      if (!inside(box.scopes)) continue;
      this.itemOf.set(box.id, box.scopes[depth] ?? box.id);
      if (box.scopes.length === depth) this.leaves.set(box.id, box);
    }
    for (const frame of frames) {
      if (!inside(frame.scopes)) continue;
      const item = frame.scopes[depth] ?? frame.id;
      this.itemOf.set(frame.id, item);
      this.itemOf.set(`${frame.id}::inner`, item);
      if (frame.scopes.length === depth) {
        const scope = new Scope([...scopes, frame.id], boxes, frames, wires).lay();
        this.inner.set(frame.id, { ...scope, mine: frame });
      }
    }
  }

  lay(): { layout: Layout; ins: Map<string, number>; outs: Map<string, number> } {
    this.columns();
    this.connect();
    const rows = this.order();
    const ys = this.straighten(rows);
    return this.draw(rows, ys);
  }

  private item(end: WireEnd): string | undefined {
    return this.itemOf.get(end.inner ? `${end.id}::inner` : end.id);
  }

  private size(item: string): { width: number; height: number } {
    return this.inner.get(item)?.layout ?? this.leaves.get(item)!;
  }

  // The column of every item: longest path; items without inputs go right before their first user.
  private columns(): void {
    const items = [...new Set(this.itemOf.values())];
    const near = new Map(items.map((item) => [item, new Set<string>()])), users = new Map(items.map((item) => [item, new Set<string>()]));
    const fed = new Set<string>();
    for (const wire of this.wires) {
      const a = this.item(wire.from), b = this.item(wire.to);
      if (a !== undefined && b !== undefined && a !== b) { near.get(b)!.add(a); users.get(a)!.add(b); }
      if (a === undefined && b !== undefined) fed.add(b);
    }
    const missing = new Map(items.map((item) => [item, near.get(item)!.size]));
    let ready = items.filter((item) => !missing.get(item));
    const waiting = new Set(items);
    while (waiting.size) {
      if (!ready.length) ready = [waiting.values().next().value!]; // a cycle between frames: place one anyway
      const next: string[] = [];
      for (const item of ready) {
        if (!waiting.delete(item)) continue;
        const sources = [...near.get(item)!].filter((source) => this.column.has(source));
        this.column.set(item, 1 + Math.max(-1, ...sources.map((source) => this.column.get(source)!)));
        for (const user of users.get(item)!) {
          missing.set(user, missing.get(user)! - 1);
          if (!missing.get(user)) next.push(user);
        }
      }
      ready = next;
    }
    for (const item of items) {
      const later = [...users.get(item)!].map((user) => this.column.get(user)!);
      if (!near.get(item)!.size && !fed.has(item) && later.length) this.column.set(item, Math.max(this.column.get(item)!, Math.min(...later) - 1));
    }
    const framed = this.path ? 1 : 0; // column 0 is the border of a frame
    for (const [item, column] of this.column) this.column.set(item, column + framed);
    this.last = Math.max(0, ...this.column.values()) + framed;
  }

  private key(kind: Key["kind"], name: string, column: number): Key {
    const text = `${kind}|${name}|${column}`;
    let key = this.keys.get(text);
    if (!key) this.keys.set(text, (key = { kind, name, column, text, at: this.keys.size }));
    return key;
  }

  // Every wire cut into steps from one column to the next.
  private connect(): void {
    for (const item of this.column.keys()) this.key("box", item, this.column.get(item)!);
    for (const wire of this.wires) {
      const mine = this.item(wire.from), theirs = this.item(wire.to), source = sourceOf(wire.from);
      if (mine === theirs) continue; // both outside, or both in one frame
      const next = theirs === undefined && wire.to.inner && wire.to.id === this.scopes[this.scopes.length - 1];
      const start = mine === undefined ? this.key("in", source, 0) : this.key("box", mine, this.column.get(mine)!);
      const end = theirs === undefined ? this.key("out", next ? `next|${wire.to.port}` : source, this.last) : this.key("box", theirs, this.column.get(theirs)!);
      if (start.column >= end.column) continue; // against the flow: drawn straight
      const chain = [start];
      for (let column = start.column + 1; column < end.column; column++) chain.push(this.key("way", source, column));
      chain.push(end);
      this.chains.set(wire.id, chain);
      for (let k = 1; k < chain.length; k++) {
        const lands = k === chain.length - 1, text = `${chain[k - 1].text}>${chain[k].text}|${source}|${lands ? `${wire.to.id}.${wire.to.port}` : ""}`;
        const link = this.links.get(text);
        if (link) link.wires.push(wire);
        else this.links.set(text, { left: chain[k - 1], right: chain[k], source, wires: [wire], from: wire.from, to: lands ? wire.to : null });
      }
    }
    for (const { at } of this.keys.values()) { this.before[at] = []; this.after[at] = []; }
    for (const link of this.links.values()) {
      this.before[link.right.at].push([link.left, link]);
      this.after[link.left.at].push([link.right, link]);
    }
  }

  private order(): Key[][] {
    const rows: Key[][] = Array.from({ length: this.last + 1 }, () => []);
    for (const key of this.keys.values()) rows[key.column].push(key);
    const place = new Float64Array(this.keys.size), mean = new Float64Array(this.keys.size);
    const settle = (row: Key[]) => row.forEach((key, k) => { place[key.at] = k / Math.max(1, row.length - 1); });
    const [before, after] = [this.before, this.after].map((near) => near.map((found) => ({ others: found.map(([other]) => other.at), leans: found.map(([, link]) => 1e-3 * this.lean(link)) })));
    const count = this.counter();
    rows.forEach(settle);
    let best = rows.map((row) => [...row]), fewest = count(rows), found = 0;
    for (let sweep = 0; sweep < 12 && fewest && sweep < found + 4; sweep++) { // three that find nothing better: it goes to and fro
      const near = sweep % 2 ? after : before;
      for (const row of sweep % 2 ? [...rows].reverse() : rows) {
        for (const { at } of row) {
          const { others, leans } = near[at];
          let sum = 0;
          for (let k = 0; k < others.length; k++) sum += place[others[k]] + leans[k];
          mean[at] = others.length ? sum / others.length : place[at];
        }
        row.sort((a, b) => mean[a.at] - mean[b.at]);
        settle(row);
      }
      const crossed = count(rows);
      if (crossed < fewest) { best = rows.map((row) => [...row]); fewest = crossed; found = sweep; }
    }
    return best;
  }

  // Where on its box a wire starts or ends, small against places: what lies above on one box should come above.
  private lean(link: Link): number {
    return this.port(link.left, link, true) / 1000;
  }

  // Counts the crossings of all wires.
  private counter(): (rows: Key[][]) => number {
    const between: [number, number][][] = Array.from({ length: this.last + 1 }, () => []), rank = new Int32Array(this.keys.size);
    for (const { left, right } of this.links.values()) between[left.column].push([left.at, right.at]);
    return (rows) => {
      for (const row of rows) row.forEach((key, k) => { rank[key.at] = k; });
      return between.reduce((total, lines, column) => total + (lines.length ? crossings(lines, rank, rows[column + 1].length) : 0), 0);
    };
  }

  private across(key: Key): number {
    return key.kind === "box" ? this.size(key.name).height : key.kind === "way" ? WAY : 18;
  }

  // y of a wire's end on a box, from the box's centre.
  private port(key: Key, link: Link, start: boolean): number {
    if (key.kind !== "box") return 0;
    const frame = this.inner.get(key.name), end = start ? link.from : link.to;
    if (!frame) return (end && (start ? this.leaves.get(key.name)!.outputs : this.leaves.get(key.name)!.inputs).get(end.port)) || 0;
    const half = frame.layout.height / 2, own = end?.id === key.name && !end.inner;
    const name = own ? (start ? `next|${end!.port}` : `${key.name}|inner|${end!.port}`) : link.source;
    return ((start ? frame.outs : frame.ins).get(name) ?? half) - half;
  }

  private straighten(rows: Key[][]): Float64Array {
    const keys = [...this.keys.values()], ys = new Float64Array(keys.length), across = keys.map((key) => this.across(key));
    for (const row of rows) {
      let y = 0;
      for (const { at } of row) { ys[at] = y + across[at] / 2; y += across[at] + GAP_ACROSS; }
    }
    const gaps = rows.map((row) => row.slice(1).map((key, k) => (across[row[k].at] + across[key.at]) / 2 + (key.kind === "way" || row[k].kind === "way" ? 10 : GAP_ACROSS)));
    const sweeps = keys.length > 800 ? 16 : 60, pulls = keys.map((key) => this.pulls(key));
    const weights = rows.map((row) => row.map(({ at }) => pulls[at].weight.reduce((sum, one) => sum + one, 0)));
    const firm = weights.map((row) => row.map((weight) => weight || 0.05));
    for (let sweep = 0; sweep < sweeps; sweep++) {
      let moved = 0;
      for (let k = 0; k < rows.length; k++) {
        const index = sweep % 2 ? rows.length - 1 - k : k, row = rows[index];
        const wanted = row.map(({ at }, place) => {
          const { others, by, weight } = pulls[at], total = weights[index][place];
          let sum = 0;
          for (let n = 0; n < others.length; n++) sum += weight[n] * (ys[others[n]] + by[n]);
          return total ? sum / total : ys[at];
        });
        apart(wanted, firm[index], gaps[index]).forEach((y, place) => { const { at } = row[place]; moved = Math.max(moved, Math.abs(y - ys[at])); ys[at] = y; });
      }
      if (moved < 0.3) break;
    }
    const top = keys.reduce((least, { at }) => Math.min(least, ys[at] - across[at] / 2), 0), down = MARGIN + (this.path ? TITLE : 0) - top;
    return ys.map((y) => y + down);
  }

  // What a key is drawn to: its neighbours, how far from their centres its own wants to be, and how strongly.
  private pulls(key: Key): { others: number[]; by: number[]; weight: number[] } {
    const others: number[] = [], by: number[] = [], weight: number[] = [];
    for (const [near, left] of [[this.before[key.at], true], [this.after[key.at], false]] as const)
      for (const [other, link] of near) {
        others.push(other.at);
        by.push(this.port(other, link, left) - this.port(key, link, !left));
        weight.push([3, 1, 12][Number(key.kind === "way") + Number(other.kind === "way")]);
      }
    return { others, by, weight };
  }

  private draw(rows: Key[][], ys: Float64Array): { layout: Layout; ins: Map<string, number>; outs: Map<string, number> } {
    const left: number[] = [], right: number[] = [];
    let x = this.path ? 0 : MARGIN;
    rows.forEach((row, column) => {
      const border = this.path && (column === 0 || column === this.last), width = border ? 0 : Math.max(0, ...row.filter((key) => key.kind === "box").map((key) => this.size(key.name).width));
      left.push(x); right.push(x + width);
      x += width + (border || (this.path && column === this.last - 1) ? 64 : GAP_ALONG + Math.min(50, 1.5 * row.length));
    });
    const end = right[right.length - 1] + (this.path ? 0 : MARGIN);
    const bottom = Math.max(0, ...[...this.keys.values()].map((key) => ys[key.at] + this.across(key) / 2)) + MARGIN;
    const layout: Layout = { width: Math.max(end, this.path ? 190 : 0), height: Math.max(bottom, this.path ? 90 : 0), boxes: new Map(), frames: new Map(), paths: new Map() };
    const ins = new Map<string, number>(), outs = new Map<string, number>();
    for (const key of this.keys.values()) {
      if (key.kind === "in") ins.set(key.name, ys[key.at]);
      if (key.kind === "out") outs.set(key.name, ys[key.at]);
      if (key.kind === "box") this.put(layout, key.name, (left[key.column] + right[key.column]) / 2, ys[key.at]);
    }
    for (const wire of this.wires) {
      const chain = this.chains.get(wire.id), corners: Point[] = [];
      const a = this.item(wire.from), b = this.item(wire.to);
      const head = a !== undefined && a !== b ? layout.paths.get(`${a}\n${wire.id}`) : undefined, tail = b !== undefined && a !== b ? layout.paths.get(`${b}\n${wire.id}`) : undefined;
      if (chain) {
        const link = { from: wire.from, to: wire.to, source: sourceOf(wire.from) } as Link;
        chain.forEach((key, k) => {
          const y = ys[key.at], { width } = key.kind === "box" ? this.size(key.name) : { width: 0 }, middle = (left[key.column] + right[key.column]) / 2;
          if (k === 0) corners.push([key.kind === "box" ? middle + width / 2 : left[0], y + this.port(key, link, true)]);
          else if (k === chain.length - 1) corners.push([key.kind === "box" ? middle - width / 2 : layout.width, y + this.port(key, link, false)]);
          else { corners.push([left[key.column] - 8, y]); corners.push([right[key.column] + 8, y]); }
        });
      }
      const joined = [...(head ?? []), ...corners, ...(tail ?? [])];
      for (const item of [a, b]) if (item !== undefined) layout.paths.delete(`${item}\n${wire.id}`);
      if (a !== undefined && a === b) continue;
      if (joined.length) layout.paths.set(wire.id, joined);
    }
    return { layout, ins, outs };
  }

  // Puts a box, or a frame with all it holds, into the layout. Paths that reach a frame's border wait under "frame\nwire".
  private put(layout: Layout, item: string, x: number, y: number): void {
    const frame = this.inner.get(item), { width, height } = this.size(item), dx = x - width / 2, dy = y - height / 2;
    if (!frame) { layout.boxes.set(item, { x: dx, y: dy, width, height }); return; }
    const spread = (names: string[], known: Map<string, number>, name: (port: string) => string) =>
      new Map(names.map((port, k) => [port, known.get(name(port)) ?? TITLE + 18 + 20 * k]));
    layout.frames.set(item, { x: dx, y: dy, width, height,
      inputs: spread(frame.mine.inputs, frame.ins, (port) => `${item}|inner|${port}`), outputs: spread(frame.mine.outputs, frame.outs, (port) => `next|${port}`) });
    for (const [id, rect] of frame.layout.boxes) layout.boxes.set(id, { ...rect, x: rect.x + dx, y: rect.y + dy });
    for (const [id, rect] of frame.layout.frames) layout.frames.set(id, { ...rect, x: rect.x + dx, y: rect.y + dy });
    const inside = new Map(this.wires.map((wire) => [wire.id, wire]));
    for (const [id, points] of frame.layout.paths) {
      const moved = points.map(([px, py]) => [px + dx, py + dy] as const), wire = inside.get(id)!;
      const done = this.item(wire.from) === item && this.item(wire.to) === item;
      layout.paths.set(done ? id : `${item}\n${id}`, moved);
    }
  }
}
