"""The atlas at large meshes: the built-in charts against one call of xatlas, packing included.

    python benchmarks/atlas.py             # 20 K, 80 K and 200 K faces, rough; xatlas takes minutes at the last
    python benchmarks/atlas.py --quick     # 5 K and 20 K faces
    python benchmarks/atlas.py --mesh FILE # an OBJ or PLY file beside them
    python benchmarks/atlas.py --quick --bend 0.3    # charts that bend less

Processor seconds (xatlas runs in a process of its own, whose time is counted). Both sets of charts are packed by the
same packer; `use` is the part of the square under charts. Stretch: L2 and
L-inf of Sander et al. 2001, 1 for an isometric atlas; `L2 95 %` is the L2 stretch that 95 % of the
area stay below.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from pathlib import Path

import numpy as np

from benchmarks.meshes import torus
from exmesh_graph.geometry.adjacency import components, face_areas
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.uv.flatten import flat_corners, stretches
from exmesh_graph.uv.settings import DiscSettings, XatlasSettings
from exmesh_graph.uv.unwrap import unwrap

NOISE = 0.15  # standard deviation, in mean edge lengths, of every coordinate


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="5 K and 20 K faces only")
    parser.add_argument("--size", type=int, default=1024, help="texels along the atlas's side")
    parser.add_argument("--noise", type=float, default=NOISE, help="roughness, in mean edge lengths")
    parser.add_argument("--bend", type=float, default=0.45, help="how far a built-in chart may bend")
    parser.add_argument("--mesh", type=Path, help="another mesh to measure")
    parser.add_argument("--json", type=Path, help="write the figures here too")
    options = parser.parse_args()
    unwrap(*icosphere(1), 64)  # loads and compiles the packer's kernel
    rows = []
    print(
        f"{'mesh':<22}{'charts by':<11}{'s':>8}{'charts':>8}{'use':>7}{'L2':>8}{'L2 95 %':>9}{'L-inf':>9}{'ratio':>8}"
    )
    for name, (vertices, faces) in meshes(options).items():
        one = row(name, "xatlas", vertices, faces, options)
        own = row(name, "discs", vertices, faces, options)
        own["ratio"] = one["seconds"] / own["seconds"]
        for figures in (one, own):
            ratio = f"{figures['ratio']:8.1f}" if "ratio" in figures else ""
            print(
                f"{name:<22}{figures['method']:<11}{figures['seconds']:8.2f}{figures['charts']:8d}{figures['use']:7.3f}"
                f"{figures['l2']:8.4f}{figures['l2_95']:9.4f}{figures['linf']:9.2f}{ratio}",
                flush=True,
            )
        rows += [one, own]
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


def meshes(options: argparse.Namespace) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    found = {}
    if options.mesh:
        from exmesh_graph.io.meshes import read_mesh

        found[options.mesh.name] = read_mesh(options.mesh)
    for level in (4, 5) if options.quick else (5, 6):
        found[f"bumpy ball {20 * 4**level}"] = rough(*bumpy(*icosphere(level)), options.noise)
    if not options.quick:
        found["bumpy torus 200000"] = rough(*bumpy(*torus(500, 200)), options.noise)
    return found


def bumpy(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The shape with soft hills and valleys."""
    return vertices * (1 + 0.15 * np.sin(5 * vertices[:, :1]) * np.cos(4 * vertices[:, 1:2])), faces


def rough(vertices: np.ndarray, faces: np.ndarray, noise: float) -> tuple[np.ndarray, np.ndarray]:
    edge = np.linalg.norm(vertices[faces[:, 0]] - vertices[faces[:, 1]], axis=1).mean()
    return (vertices + np.random.default_rng(0).normal(size=vertices.shape) * noise * edge).astype(np.float32), faces


def row(name: str, method: str, vertices: np.ndarray, faces: np.ndarray, options: argparse.Namespace) -> dict:
    def spent() -> float:
        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        return time.process_time() + children.ru_utime + children.ru_stime

    def refuse(message: str) -> None:
        raise SystemExit(message)

    begun = spent()
    settings = XatlasSettings(max_seconds=3600) if method == "xatlas" else DiscSettings(bend=options.bend)
    uvs, uv_faces = unwrap(vertices, faces, options.size, settings, warn=refuse)
    seconds = spent() - begun
    area = face_areas(vertices, faces)
    real = area > 1e-7 * area.mean()
    flat = uvs[:, 0].astype(float) + 1j * uvs[:, 1]
    low, high = stretches(flat_corners(vertices, faces), uv_faces, flat)
    low, high, area = np.maximum(low[real], 1e-9), high[real], area[real]
    scale = np.sqrt((area * low * high).sum() / area.sum())
    # Sander's stretch measures from the texture to the surface: the inverse of these factors
    square = 0.5 * ((scale / low) ** 2 + (scale / high) ** 2)
    order = np.argsort(square)
    below = order[np.searchsorted(np.cumsum(area[order]), 0.95 * area.sum())]
    return {
        "mesh": name,
        "faces": len(faces),
        "method": method,
        "seconds": seconds,
        "charts": int(components(uv_faces).max()) + 1,
        "use": float((area * low * high).sum()),
        "l2": float(np.sqrt((area * square).sum() / area.sum())),
        "l2_95": float(np.sqrt(square[below])),
        "linf": float((scale / low).max()),
    }


if __name__ == "__main__":
    main()
