// Two small solvers of the layout: crossings between two columns, and places under separation.

// Crossings among lines that join keys of one column to keys of the next, which has `rows`: inversions of their ranks, by a Fenwick tree.
export function crossings(lines: [number, number][], rank: Int32Array, rows: number): number {
  const sorted = Float64Array.from(lines, ([a, b]) => rank[a] * rows + rank[b]).sort(), tree = new Int32Array(rows + 2);
  let total = 0;
  for (let before = 0; before < sorted.length; before++) {
    const b = sorted[before] % rows;
    let notAbove = 0;
    for (let k = b + 1; k > 0; k -= k & -k) notAbove += tree[k];
    total += before - notAbove;
    for (let k = b + 1; k <= rows + 1; k += k & -k) tree[k] += 1;
  }
  return total;
}

// The places nearest to `wanted` (weighted least squares) with at least `gaps` between neighbours: pooled violators.
export function apart(wanted: number[], weights: number[], gaps: number[]): number[] {
  const offsets = [0];
  for (const gap of gaps) offsets.push(offsets[offsets.length - 1] + gap);
  const pools: { mean: number; weight: number; count: number }[] = [];
  wanted.forEach((goal, k) => {
    let pool = { mean: goal - offsets[k], weight: weights[k], count: 1 };
    while (pools.length && pools[pools.length - 1].mean > pool.mean) {
      const before = pools.pop()!, weight = before.weight + pool.weight;
      pool = { mean: (before.mean * before.weight + pool.mean * pool.weight) / weight, weight, count: before.count + pool.count };
    }
    pools.push(pool);
  });
  const places: number[] = [];
  for (const { mean, count } of pools) for (let k = 0; k < count; k++) places.push(mean + offsets[places.length]);
  return places;
}
