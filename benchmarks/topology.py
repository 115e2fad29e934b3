"""Topology and atlas operations: seconds, and what they do to the mesh.

    python benchmarks/topology.py                                  # spot of the sample scene, subdivided to size
    python benchmarks/topology.py --faces 20000 80000 --atlas 512 1024 --json topology.json

Prints one line per operation: CPU seconds (best of --repeats, one process), faces before and after, and a figure of
error or quality. Each figure can be measured again with the same command; ratios matter more than absolute times.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.mesh_quality import mesh_quality
from exmesh_graph.geometry.adjacency import without_unused
from exmesh_graph.geometry.flip import flip
from exmesh_graph.geometry.merge import merge
from exmesh_graph.geometry.relax import relax
from exmesh_graph.geometry.settings import FlipSettings, MergeSettings, SplitSettings
from exmesh_graph.geometry.split import plan_splits, split, subdivide
from exmesh_graph.geometry.topology import Topology
from exmesh_graph.raster import edge_table
from exmesh_graph.stage1.regularise import smoother, smoothness
from exmesh_graph.uv.maintain import check_atlas, refill
from exmesh_graph.uv.raster import rasterize_atlas
from exmesh_graph.uv.settings import DiscSettings
from exmesh_graph.uv.transfer import sample_bilinear, transfer_texture
from exmesh_graph.uv.unwrap import unwrap

SAMPLE = Path(__file__).parent.parent / "graphs" / "samples" / "spot" / "mesh" / "mesh.obj"
Result = list[dict[str, Any]]
FIGURES = ("edge_cv", "min_angle_mean", "min_angle_p1", "slivers", "degree_max", "degree_std")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mesh", type=Path, default=SAMPLE, help="an OBJ file")
    parser.add_argument("--faces", type=int, nargs="+", default=[20_000, 80_000, 200_000])
    parser.add_argument("--atlas", type=int, nargs="+", default=[512, 2048], help="texture sizes")
    parser.add_argument("--atlas-faces", type=int, nargs="*", default=[5_856, 20_000, 30_000])
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--texels", type=int, default=1024, help="texture that a round dilates")
    parser.add_argument("--quick", action="store_true", help="20 000 faces, one repeat, no atlas, no texture")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()

    if args.quick:
        args.faces, args.atlas_faces, args.repeats = [20_000], [], 1
    rows: Result = []
    vertices, faces = load_obj(args.mesh)
    start = (vertices, faces, *unwrap(vertices, faces, 1024))
    for settings in variants():
        split_quality(rows, start, settings)
    flip_quality(rows, start)
    for n in args.faces:
        rounds(rows, start, n, args.repeats, args.texels)
    for n in args.atlas_faces:
        mesh = to_size(start, n)
        for size in args.atlas:
            atlas(rows, mesh[:2], size, args.repeats)
    if not args.quick:
        transfer(rows, start[:2])
        merged_texture(rows, start)
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def variants() -> list[SplitSettings]:
    return [
        SplitSettings(),
        SplitSettings(edge_degrees="endpoints"),
        SplitSettings(max_degree=99),
        SplitSettings(edge_degrees="endpoints", max_degree=99),
        SplitSettings(position="midpoint"),
        SplitSettings(position="random"),
        SplitSettings(area_quantile=0.25),
        SplitSettings(area_quantile=0.75),
    ]


def split_quality(rows: Result, mesh: tuple, settings: SplitSettings) -> None:
    """What choices of edge and position do to the triangles, from the sample's faces to 20 000."""
    gradient = np.random.default_rng(0).random(len(mesh[0])).astype(np.float32)
    done = split(*mesh, gradient, 20_000, settings)
    quality = mesh_quality(done.vertices, done.faces)
    name = f"split to 20K, degrees {settings.edge_degrees}, at {settings.position}, degree < {settings.max_degree}"
    name += "" if settings.area_quantile == 0.5 else f", larger than {settings.area_quantile:.0%}"
    report(rows, name, None, len(mesh[1]), len(done.faces), **{k: round(quality[k], 4) for k in FIGURES})


def flip_quality(rows: Result, mesh: tuple) -> None:
    """What flips and gliding make of the triangles that splits to 20 000 faces leave, and of even subdivision."""
    done = split(*mesh, np.random.default_rng(0).random(len(mesh[0])).astype(np.float32), 20_000)
    start = (done.vertices, done.faces, done.uvs, done.uv_faces)

    def told(name: str, points: np.ndarray, faces: np.ndarray, **more: Any) -> None:
        kept = {k: round(v, 4) for k, v in mesh_quality(points, faces).items() if k in FIGURES}
        bent = round(unevenness(points, faces), 4)
        report(rows, name, None, len(mesh[1]), len(faces), bilaplacian=bent, **kept, **more)

    told("the mesh itself", *mesh[:2])
    told("split to 20K", *start[:2])
    for criterion in ("valence", "delaunay"):
        flipped = flip(*start, FlipSettings(method=criterion))
        for steps in (0, 1, 2, 4, 8):
            points, *_ = relax(flipped.vertices, flipped.faces, flipped.uvs, flipped.uv_faces, steps=steps)
            told(f"flip, {criterion}, then {steps} steps of gliding", points, flipped.faces, flips=flipped.count)
    four = subdivide(*mesh)
    points, *_ = relax(four.vertices, four.faces, four.uvs, four.uv_faces, steps=2)
    told("subdivided", four.vertices, four.faces)
    told("subdivided, then 2 steps of gliding", points, four.faces)


def unevenness(vertices: np.ndarray, faces: np.ndarray) -> float:
    """The scale-free bi-Laplacian with equal weights, which takes uneven edges and degrees for curvature."""
    points = torch.from_numpy(vertices.astype(np.float64))
    return float(smoothness(points, smoother(points, edge_table(torch.from_numpy(faces)).edges), "bilaplacian"))


def rounds(rows: Result, mesh: tuple, n: int, repeats: int, texels: int) -> None:
    """One split round, a call that grows by half, one merge with a fifth of the faces unseen, flips, gliding, upkeep of
    the atlas; their sum; one subdivision."""
    mesh = to_size(mesh, n)
    vertices, faces, *_ = mesh
    rng = np.random.default_rng(0)
    gradient = rng.random(len(vertices)).astype(np.float32)
    rendered = (rng.random(len(faces)) > 0.2).astype(np.int64)
    settings = SplitSettings()
    seconds, plan = best(lambda: plan_splits(vertices, faces, gradient, 4 * n, settings), repeats)
    report(rows, "split: plan of one round", seconds, len(faces), len(faces) + 2 * len(plan[0]))
    seconds, done = best(lambda: split(*mesh, gradient, 4 * n, settings, max_rounds=1), repeats)
    report(rows, "split: one round", seconds, len(faces), len(done.faces))
    sums = [seconds]
    seconds, done = best(lambda: split(*mesh, gradient, int(1.5 * n), settings), repeats)
    report(rows, "split: growth 1.5", seconds, len(faces), len(done.faces), rounds=len(done.map.steps))
    seconds, done = best(lambda: merge(*mesh, rendered, MergeSettings(min_faces=4), max_rounds=1), repeats)
    report(rows, "merge: one round", seconds, len(faces), len(done.faces))
    seconds, done = best(lambda: merge(*mesh, rendered, MergeSettings(min_faces=4)), repeats)
    report(rows, "merge: up to 4 rounds", seconds, len(faces), len(done.faces))
    sums.append(seconds)
    after = (done.vertices, done.faces, done.uvs, done.uv_faces)
    seconds, _ = best(lambda: (check_atlas(*after, texels), without_unused(*after[2:])), repeats)
    report(rows, "uv: check and compact", seconds, len(done.faces), len(done.faces))
    sums.append(seconds)
    report(rows, "TOPOLOGY ROUND: score, split, merge (up to 4 rounds), uv", sum(sums), len(faces), len(done.faces))
    texture = np.zeros((texels, texels, 3), np.float32)
    seconds, _ = best(lambda: refill(texture, *after[2:], 8.0), repeats)
    report(rows, f"uv: spread a texture of {texels} beyond its charts", seconds, len(done.faces), len(done.faces))
    for criterion in ("delaunay", "valence"):
        seconds, flipped = best(lambda: flip(*after, FlipSettings(method=criterion)), repeats)  # noqa: B023
        report(rows, f"flip: {criterion}", seconds, len(done.faces), len(done.faces), flips=flipped.count)
    seconds, _ = best(lambda: relax(*after, steps=2), repeats)
    report(rows, "glide: 2 steps", seconds, len(done.faces), len(done.faces))
    seconds, four = best(lambda: subdivide(*mesh), repeats)
    report(rows, "subdivide", seconds, len(faces), len(four.faces))


def atlas(rows: Result, mesh: tuple, size: int, repeats: int) -> None:
    vertices, faces = mesh
    seconds, (uvs, uv_faces) = best(lambda: unwrap(vertices, faces, size), repeats)
    figures = check_atlas(vertices, faces, uvs, uv_faces, size)
    told = {"charts": figures.charts, "covered": round(figures.covered, 3), "stretch": round(figures.stretch, 3)}
    report(rows, f"unwrap {size}", seconds, len(faces), len(faces), **told, flipped=figures.flipped)
    for margin in (0.0, 1.5):
        seconds, (face_id, _) = best(lambda: rasterize_atlas(uvs, uv_faces, size, margin=margin), repeats)  # noqa: B023
        told = {"covered": round(float((face_id >= 0).mean()), 3)}
        report(rows, f"rasterize {size}, margin {margin}", seconds, len(faces), len(faces), **told)


def transfer(rows: Result, mesh: tuple, size: int = 512) -> None:
    """PSNR at surface points after one to four changes of atlas, of a checkerboard with edges two texels wide."""
    vertices, faces = mesh
    atlases = [unwrap(vertices, faces, size, DiscSettings(bend=bend)) for bend in (0.45, 0.3)]
    assert len(atlases[0][0]) != len(atlases[1][0]), "one atlas twice: nothing is transferred"
    rng = np.random.default_rng(0)
    face, bary = rng.integers(0, len(faces), 100_000), rng.dirichlet([1, 1, 1], 100_000)
    texture = checkerboard(vertices, faces, *atlases[0], size)

    def seen(picture: np.ndarray, uvs: np.ndarray, uv_faces: np.ndarray) -> np.ndarray:
        return sample_bilinear(picture, np.einsum("nk,nkc->nc", bary, uvs[uv_faces[face]].astype(np.float64)))

    want = seen(texture, *atlases[0])
    for sharpen in (0, 1, 2):
        moved, figures = texture, []
        seconds = 0.0
        for turn in range(4):
            source, target = atlases[turn % 2], atlases[(turn + 1) % 2]
            begin = time.process_time()
            moved = transfer_texture({"t": moved}, *source, *target, size, sharpen=sharpen, bounds=(0, 1))[0]["t"]
            seconds += (time.process_time() - begin) / 4
            figures.append(round(float(-10 * np.log10(np.mean((seen(moved, *target) - want) ** 2))), 1))
        report(rows, f"transfer {size}, {sharpen} corrections", seconds, len(faces), len(faces), psnr=figures)


def merged_texture(rows: Result, mesh: tuple, size: int = 1024) -> None:
    """PSNR of the texture at surface points after merging, for three UVs that the deleted vertex's corners may take."""
    from scipy.spatial import cKDTree

    import exmesh_graph.geometry.merge as module

    vertices, faces, uvs, uv_faces = mesh
    texture = checkerboard(vertices, faces, uvs, uv_faces, size, cell=24.0)
    rendered = (np.random.default_rng(0).random(len(faces)) > 0.3).astype(np.int64)

    def samples(v: np.ndarray, f: np.ndarray, u: np.ndarray, uf: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
        rng = np.random.default_rng(1)
        p = v[f].astype(np.float64)
        area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
        face, bary = rng.choice(len(f), n, p=area / area.sum()), rng.dirichlet([1, 1, 1], n)
        uv = np.einsum("nk,nkc->nc", bary, u[uf[face]].astype(np.float64))
        return np.einsum("nk,nkc->nc", bary, p[face]), sample_bilinear(texture, uv)

    points, colours = samples(vertices, faces, uvs, uv_faces, 400_000)
    tree = cKDTree(points)
    moved, carry_out = module._moved_corners, module.apply_merges

    def half_way(state: Topology, plan: module.Collapses) -> Topology:
        """Every moved corner gets a coordinate of its own between its old one and the survivor's."""
        target = moved(state.faces, state.uv_faces, plan, len(state.vertices))
        where = target != state.uv_faces
        between = 0.5 * (state.uvs[target[where]] + state.uvs[state.uv_faces[where]])
        target[where] = len(state.uvs) + np.arange(int(where.sum()))
        module._moved_corners = lambda *_: target
        return carry_out(replace(state, uvs=np.concatenate([state.uvs, between])), plan)

    def kept(_: np.ndarray, corners: np.ndarray, *__: Any) -> np.ndarray:
        return corners

    ways = (("survivor's UV", moved, carry_out), ("own UV kept", kept, carry_out), ("half way", moved, half_way))
    for name, rule, operation in ways:
        module._moved_corners, module.apply_merges = rule, operation
        try:
            wide = MergeSettings(min_faces=4, area_quantile=0.6)
            done = merge(vertices, faces, uvs, uv_faces, rendered, wide, max_rounds=1)
        finally:
            module._moved_corners, module.apply_merges = moved, carry_out
        new_points, new_colours = samples(done.vertices, done.faces, done.uvs, done.uv_faces, 60_000)
        error = np.mean((new_colours - colours[tree.query(new_points)[1]]) ** 2)
        psnr = round(float(-10 * np.log10(error)), 1)
        report(rows, f"texture after merging, {name}", None, len(faces), len(done.faces), psnr=psnr)


def checkerboard(
    vertices: np.ndarray, faces: np.ndarray, uvs: np.ndarray, uv_faces: np.ndarray, size: int, cell: float = 16.0
) -> np.ndarray:
    face_id, bary = rasterize_atlas(uvs, uv_faces, size, margin=1.5)
    hit = face_id >= 0
    d = np.diff(uvs[uv_faces].astype(np.float64), axis=1)
    uv_area = 0.5 * np.abs(d[:, 0, 0] * d[:, 1, 1] - d[:, 0, 1] * d[:, 1, 0]).sum()
    p = vertices[faces].astype(np.float64)
    area = 0.5 * np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1).sum()
    w = np.pi / (cell * np.sqrt(area / uv_area) / size)
    points = np.einsum("nk,nkc->nc", bary[hit], p[face_id[hit]])
    texture = np.full((size, size, 1), 0.5, np.float32)
    texture[hit, 0] = 0.5 + 0.5 * np.prod(np.clip(np.sin(points * w) * cell * 0.32, -1, 1), axis=1)
    return texture


def to_size(mesh: tuple, n: int) -> tuple:
    """Split the mesh to n faces without using the function that is timed on it: uniform first, then the rest."""
    while 4 * len(mesh[1]) <= n:
        done = subdivide(*mesh)
        mesh = (done.vertices, done.faces, done.uvs, done.uv_faces)
    if len(mesh[1]) < n:
        done = split(*mesh, np.zeros(len(mesh[0])), n, SplitSettings(method="area"))
        mesh = (done.vertices, done.faces, done.uvs, done.uv_faces)
    return mesh


def load_obj(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Positions and triangles of an OBJ file, vertices at one place joined."""
    vertices, faces = [], []
    for line in path.read_text(encoding="utf-8").splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            vertices.append([float(x) for x in words[1:4]])
        elif words[:1] == ["f"]:
            ring = [int(word.split("/")[0]) - 1 for word in words[1:]]
            faces.extend([ring[0], ring[k], ring[k + 1]] for k in range(1, len(ring) - 1))
    joined, index = np.unique(np.array(vertices, np.float32), axis=0, return_inverse=True)
    return joined, index.reshape(-1)[np.array(faces)].astype(np.int32)


def best(function: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    times, result = [], None
    for _ in range(repeats):
        begin = time.process_time()
        result = function()
        times.append(time.process_time() - begin)
    return min(times), result


def report(rows: Result, name: str, seconds: float | None, before: int, after: int, **figures: Any) -> None:
    rows.append({"operation": name, "seconds": seconds, "faces_before": before, "faces_after": after, **figures})
    timing = "       " if seconds is None else f"{seconds:6.3f} s"
    print(
        f"{name:<72} {timing}  {before:>7} -> {after:<7} " + ", ".join(f"{k} {v}" for k, v in figures.items()),
        flush=True,
    )


if __name__ == "__main__":
    main()
