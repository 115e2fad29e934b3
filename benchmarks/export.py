"""How long does an export take, and how large is it? A bumpy sphere with a full atlas, by the exporter and its gate.

    python benchmarks/export.py [--faces 200000] [--size 2048] [--quick] [--json FILE]

Base colour and normals carry noise as real maps do, which is what PNG compression is slow on. Times are seconds of the
clock and of the processor, without Blender.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np

from exmesh_graph.export.usd import validate_usd, write_usd
from exmesh_graph.export.usd.rules import Pictures
from exmesh_graph.types import Asset


def main() -> None:
    """Export once, judge once more, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--faces", type=int, default=200_000)
    parser.add_argument("--size", type=int, default=2048, help="side of the maps")
    parser.add_argument("--quick", action="store_true", help="5 000 faces, 256 maps")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    faces, size = (5000, 256) if options.quick else (options.faces, options.size)
    asset = bumpy_sphere(faces, size)
    with tempfile.TemporaryDirectory(prefix="exmesh-export-") as folder:
        out = Path(folder) / "usd"
        rows = {"export with gate": timed(lambda: write_usd(out, asset))}
        rows["gate alone, four files"] = timed(lambda: judge(out))
        sizes = {path.name: path.stat().st_size for path in sorted(out.rglob("*")) if path.is_file()}
    print(f"{len(asset.faces)} faces, {size} x {size} maps, {sum(sizes.values()) / 1e6:.1f} MB")
    for name, (clock, processor) in rows.items():
        print(f"  {name:<24}{clock:6.2f} s   processor {processor:6.2f} s")
    for name, count in sizes.items():
        print(f"  {name:<24}{count / 1e6:8.2f} MB")
    if options.json:
        options.json.write_text(json.dumps({"faces": len(asset.faces), "size": size, "seconds": rows, "bytes": sizes}))


def judge(folder: Path) -> None:
    """The gate as the exporter runs it."""
    pictures = Pictures()
    for file in ("asset.usda", "scene.usda", "asset.usdz", "asset_ar.usdz"):
        assert not validate_usd(folder / file, pictures)


def timed(work) -> tuple[float, float]:
    """(clock, processor) seconds of `work()`."""
    clock, processor = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - clock, time.process_time() - processor


def bumpy_sphere(faces: int, size: int) -> Asset:
    """A closed latitude-longitude sphere of about `faces` triangles whose one chart fills the atlas."""
    rng = np.random.default_rng(0)
    n = max(int(np.sqrt(faces / 2)), 4)
    v, u = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), indexing="ij")
    polar, around = np.pi * np.clip(v, 1e-3, 1 - 1e-3), 2 * np.pi * u
    radius = 0.8 + 0.05 * np.sin(8 * polar) * np.cos(6 * around)
    points = radius[..., None] * np.stack(
        [np.sin(polar) * np.sin(around), np.cos(polar), np.sin(polar) * np.cos(around)], axis=-1
    )
    index = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    quads = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    wrapped = (np.arange(n + 1) % n)[None] + (n + 1) * np.arange(n + 1)[:, None]
    normal = np.concatenate([rng.normal(0, 0.05, (size, size, 2)), np.ones((size, size, 1))], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    shade = np.linspace(0.2, 0.6, size)[:, None, None] * np.array([1, 0.8, 0.6])
    return Asset(
        vertices=points.reshape(-1, 3).astype(np.float32),
        faces=wrapped.reshape(-1)[quads].astype(np.int32),
        uvs=np.stack([0.01 + 0.98 * u, 0.99 - 0.98 * v], axis=-1).reshape(-1, 2).astype(np.float32),
        uv_faces=quads.astype(np.int32),
        texture=np.zeros((2, 2, 3), np.float32),
        base_color=np.clip(shade + rng.normal(0, 0.02, (size, size, 3)), 0, 1).astype(np.float32),
        roughness=np.clip(0.5 + rng.normal(0, 0.02, (size, size)), 0, 1).astype(np.float32),
        seen=np.zeros((size, size), bool),
        environment=np.ones((256, 512, 3), np.float32),
        normal=normal.astype(np.float32),
    )


if __name__ == "__main__":
    main()
