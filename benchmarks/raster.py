"""What an iteration of Stage I costs, part by part: median CPU milliseconds, one thread.

    python benchmarks/raster.py [--size 256] [--faces 5120 20480 81920] [--texels 512]

A textured sphere that covers a quarter of the image. Compare columns and ratios, not milliseconds between machines.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Callable

import numpy as np
import torch

from exmesh_graph import losses
from exmesh_graph.raster import (
    antialias,
    edge_table,
    find_silhouette,
    project,
    rasterize_projected,
    shade,
)
from exmesh_graph.raster.interpolate import shade_reference
from exmesh_graph.stage1.optimiser import texture_step, vertex_step
from exmesh_graph.stage1.regularise import smoother, smoothness


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--faces", type=int, nargs="+", default=[5120, 20480, 81920])
    parser.add_argument("--texels", type=int, default=512)
    parser.add_argument("--repeats", type=int, default=15)
    options = parser.parse_args()
    torch.set_num_threads(1)
    columns = {count: measure(count, options.size, options.texels, options.repeats) for count in options.faces}
    print(f"{options.size} x {options.size} pixels, {options.texels}^2 texels; median CPU ms")
    print(f"{'faces':36s}" + "".join(f"{count:>10d}" for count in columns))
    for name in next(iter(columns.values())):
        print(f"{name:36s}" + "".join(f"{column[name]:10.2f}" for column in columns.values()))


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
        lambda: vertex_step(vertices.detach().clone(), vertices.detach(), moments[0], moments[1], 1, 1e-3), repeats
    )
    out["Adam, texture"] = clock(lambda: texture_step(step, step, moments[2], moments[3], 1, 1e-3), repeats)
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
