"""What the rasteriser costs: against Embree, backward against forward, and an iteration of Stage I part by part.

    python benchmarks/raster.py [--json raster.json]
    python benchmarks/raster.py --quick
    python benchmarks/raster.py --only figures        # or: parts

CPU milliseconds of one torch thread on a sphere that covers a quarter of the image. Compare columns and ratios, not
milliseconds between machines. Figures are the best of interleaved runs: each is a ratio within one run.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from exmesh_graph import losses
from exmesh_graph.optim import adam_step
from exmesh_graph.raster import (
    antialias,
    edge_table,
    find_silhouette,
    mip_pyramid,
    project,
    rasterize,
    rasterize_projected,
    sample_mipmap,
    sample_texture,
    shade,
)
from exmesh_graph.raster.interpolate import shade_reference
from exmesh_graph.stage1.regularise import smoother, smoothness

Work = Callable[[], object]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=256, help="pixels along a side, for the parts")
    parser.add_argument("--faces", type=int, nargs="+", default=[5120, 20480, 81920])
    parser.add_argument("--texels", type=int, default=512)
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--only", choices=["figures", "parts"])
    parser.add_argument("--quick", action="store_true", help="one mesh, few repeats")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.quick:
        options.faces, options.repeats = options.faces[:1], 3
    torch.set_num_threads(1)
    result: dict[str, object] = {}
    if options.only != "parts":
        result["figures"] = figures(options.repeats)
    if options.only != "figures":
        columns = {count: measure(count, options.size, options.texels, options.repeats) for count in options.faces}
        print(f"{options.size} x {options.size} pixels, {options.texels}^2 texels; median CPU ms")
        print(f"{'faces':36s}" + "".join(f"{count:>10d}" for count in columns))
        for name in next(iter(columns.values())):
            print(f"{name:36s}" + "".join(f"{column[name]:10.2f}" for column in columns.values()))
        result["parts"] = {str(count): column for count, column in columns.items()}
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


def figures(repeats: int) -> list[dict[str, object]]:
    """The ratios that the rasteriser answers for, and some that a choice rests on."""
    rows: list[dict[str, object]] = []

    def compare(name: str, first: Work, second: Work, expected: str = "") -> None:
        """Print and keep the ratio second / first of the least CPU times; three of each in turns."""
        seconds: tuple[list[float], list[float]] = ([], [])
        for _ in range(repeats):
            for work, kept in zip((first, second), seconds, strict=True):
                for _ in range(3):
                    began = time.process_time()
                    work()
                    kept.append(time.process_time() - began)
        a, b = (1000 * min(kept) for kept in seconds)
        rows.append({"figure": name, "ms": [a, b], "ratio": b / a, "expected": expected})
        print(f"{name}: {a:.2f} ms and {b:.2f} ms, ratio {b / a:.2f}{f' (expected {expected})' if expected else ''}")

    size, texels = 512, 512
    vertices, faces, uvs = sphere(81920)
    intrinsics = torch.tensor([[1.37 * size, 0, size / 2], [0, 1.37 * size, size / 2], [0, 0, 1]])
    pose = torch.eye(4)
    pose[2, 3] = 3.7
    table = edge_table(faces)
    texture = torch.rand(texels, texels, 3, generator=torch.Generator().manual_seed(0)).requires_grad_()
    weight = torch.randn(size, size, 4, generator=torch.Generator().manual_seed(1))

    def picture(backward: bool) -> None:
        v = vertices.clone().requires_grad_()
        projected = project(v, intrinsics, pose)
        fragments = rasterize_projected(projected, faces, size, size)
        colour = shade(projected, faces, uvs, faces, texture, fragments.face_id)
        layers = torch.cat([colour, (fragments.face_id >= 0).float()[..., None]], dim=-1)
        image = antialias(layers, projected, find_silhouette(projected, table, fragments))
        if backward:
            torch.autograd.grad(image, (v, texture), weight)

    compare(
        f"rasterise {len(faces)} faces at {size}^2; Embree build and primary rays",
        lambda: rasterize(vertices, faces, intrinsics, pose, size, size),
        embree_work(vertices, faces, intrinsics, size),
        ">= 8",
    )
    compare(
        "colour with antialiasing, forward; forward and backward",
        lambda: picture(False),
        lambda: picture(True),
        "<= 4",
    )

    big = torch.tensor([[-900.0, -900, 5], [900, -900, 5], [0, 1800, 5]])
    one, wide = torch.tensor([[0, 1, 2]]), 1600
    projected = project(big, intrinsics, pose)
    compare(
        f"one triangle over {wide}^2; the same in tiles",
        lambda: rasterize_projected(projected, one, wide, wide, large_face=0),
        lambda: rasterize_projected(projected, one, wide, wide, large_face=256),
    )
    large = torch.rand(2048, 2048, 3).requires_grad_()
    uv = torch.rand(60_000, 2, generator=torch.Generator().manual_seed(2)) * 0.25
    ones = torch.ones(len(uv), 3)
    dense, sparse = (sample_texture(large, uv, sparse=s) for s in (False, True))
    compare(
        "texel gradients of 60 K lookups in a 16th of 2048^2 texels, sparse; dense",
        lambda: torch.autograd.grad(sparse, large, ones, retain_graph=True),
        lambda: torch.autograd.grad(dense, large, ones, retain_graph=True),
    )
    pyramid = [level.detach() for level in mip_pyramid(large)]
    level = torch.rand(len(uv), generator=torch.Generator().manual_seed(3)) * 3
    compare(
        "60 K bilinear lookups; trilinear over levels 0 to 3",
        lambda: sample_texture(pyramid[0], uv),
        lambda: sample_mipmap(pyramid, uv, level),
    )
    print()
    return rows


def embree_work(vertices: torch.Tensor, faces: torch.Tensor, intrinsics: torch.Tensor, size: int) -> Work:
    """Embree's build of the mesh and one ray through each pixel centre; the rays are made beforehand."""
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    y, x = np.meshgrid(np.arange(size) + 0.5, np.arange(size) + 0.5, indexing="ij")
    k = np.linalg.inv(intrinsics.numpy().astype(np.float64))
    rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3) @ k.T
    rays = np.ascontiguousarray(rays / np.linalg.norm(rays, axis=1, keepdims=True), np.float32)
    origins = np.ascontiguousarray(np.broadcast_to(np.float32([0, 0, -3.7]), rays.shape))
    points, triangles = vertices.numpy(), faces.numpy()

    def work() -> object:
        scene = EmbreeScene()
        TriangleMesh(scene, points, triangles)
        return scene.run(origins, rays)

    return work


def measure(count: int, size: int, texels: int, repeats: int) -> dict[str, float]:
    vertices, faces, uvs = sphere(count)
    intrinsics = torch.tensor([[1.37 * size, 0, size / 2], [0, 1.37 * size, size / 2], [0, 0, 1]])
    pose = torch.eye(4)
    pose[2, 3] = 3.7
    vertices.requires_grad_()
    texture = torch.rand(texels, texels, 3, generator=torch.Generator().manual_seed(0)).requires_grad_()
    table = edge_table(faces)
    target = torch.rand(size, size, 3, generator=torch.Generator().manual_seed(1))
    of = smoother(vertices.detach(), table.edges)
    moments = [
        torch.zeros_like(vertices),
        torch.zeros(len(vertices)),
        torch.zeros_like(texture),
        torch.zeros_like(texture),
    ]
    step = texture.detach().clone()
    out: dict[str, float] = {}

    def timed(name: str, forward: Callable[[], torch.Tensor], *inputs: torch.Tensor) -> torch.Tensor:
        value = forward()
        out[name] = clock(forward, repeats)
        if inputs:
            gradient = torch.randn(value.shape, generator=torch.Generator().manual_seed(2))
            back = lambda: torch.autograd.grad(value, inputs, gradient, retain_graph=True)  # noqa: E731
            out[name + ", backward"] = clock(back, repeats)
        return value

    projected = timed("project", lambda: project(vertices, intrinsics, pose), vertices).detach().requires_grad_()
    fragments = rasterize_projected(projected, faces, size, size)
    out["rasterize"] = clock(lambda: rasterize_projected(projected, faces, size, size), repeats)
    arguments = (projected, faces, uvs, faces, texture, fragments.face_id)
    plain = {}
    colour = timed("shade (uv, texture)", lambda: shade(*arguments), projected, texture)
    timed("the same in plain torch", lambda: shade_reference(*arguments), projected, texture)
    plain.update({k: out.pop(k) for k in list(out) if k.startswith("the same")})
    out["silhouette: find"] = clock(lambda: find_silhouette(projected, table, fragments).first, repeats)
    found = find_silhouette(projected, table, fragments)
    image = torch.cat([colour.detach(), (fragments.face_id >= 0).float()[..., None]], dim=-1).requires_grad_()
    timed("silhouette: blend", lambda: antialias(image, projected, found), image, projected)
    rgb = image.detach()[..., :3].requires_grad_()
    cached = losses.ssim_target(target)
    timed("L1", lambda: losses.l1(rgb, target), rgb)
    timed("D-SSIM, whole image, target cached", lambda: losses.d_ssim(rgb, cached), rgb)
    timed("bi-Laplacian", lambda: smoothness(vertices, of, "bilaplacian"), vertices)
    out["Adam, vertices"] = clock(
        lambda: adam_step(vertices.detach().clone(), vertices.detach(), moments[0], moments[1], 1, 1e-3), repeats
    )
    out["Adam, texture"] = clock(lambda: adam_step(step, step, moments[2], moments[3], 1, 1e-3), repeats)
    out["sum"] = sum(out.values())
    return out | {"(" + k + ")": v for k, v in plain.items()}


def clock(work: Callable[[], object], repeats: int) -> float:
    work()
    seconds = []
    for _ in range(repeats):
        began = time.process_time()
        work()
        seconds.append(time.process_time() - began)
    return 1000 * statistics.median(seconds)


def sphere(count: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """A latitude-longitude sphere of radius 0.9 and about `count` faces, with its uv (poles and seam stretched)."""
    rings = int(math.sqrt(count / 4))
    lat, lon = np.meshgrid(
        np.linspace(-np.pi / 2, np.pi / 2, rings + 1),
        np.linspace(-np.pi, np.pi, 2 * rings, endpoint=False),
        indexing="ij",
    )
    points = 0.9 * np.stack([np.cos(lat) * np.sin(lon), np.sin(lat), np.cos(lat) * np.cos(lon)], -1).reshape(-1, 3)
    uvs = np.stack([lon / (2 * np.pi) + 0.5, lat / np.pi + 0.5], -1).reshape(-1, 2)
    i, j = np.meshgrid(np.arange(rings), np.arange(2 * rings), indexing="ij")
    k = (j + 1) % (2 * rings)
    a, b, c, d = (row * 2 * rings + column for row, column in ((i, j), (i, k), (i + 1, k), (i + 1, j)))
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return (
        torch.tensor(points, dtype=torch.float32),
        torch.tensor(faces, dtype=torch.int32),
        torch.tensor(uvs, dtype=torch.float32),
    )


if __name__ == "__main__":
    main()
