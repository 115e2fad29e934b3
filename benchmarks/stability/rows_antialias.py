"""Rows of silhouette antialiasing and its gradients."""

from __future__ import annotations

from functools import cache

import torch

from benchmarks.stability.rows_raster import QUAD, SQUARE
from benchmarks.stability.scenes import (
    at_scale,
    camera,
    coverage,
    cube_with_a_chart_per_face,
    derivatives,
    disc,
    icosphere,
    random_bodies,
    random_layers,
    smooth_image,
    soup,
)
from benchmarks.stability.table import Reached, elsewhere, row
from exmesh_graph.raster import (
    antialias,
    edge_table,
    find_silhouette,
    project,
    rasterize_projected,
    shade,
)

elsewhere("antialias", "inter-penetrating faces: their line of intersection is no edge", "gradient", "known limit")


@row("antialias", "dA/dr of a disc, 100 to 0.4 pixels a face", "worst relative error", high=0.01)
def disc_area() -> Reached:
    return _area_slope([disc(n) for n in (5, 10, 20, 40, 80)])


@row("antialias", "dA/dr of a sphere, 94 to 1.5 pixels a face", "worst relative error", high=0.01)
def sphere_area() -> Reached:
    return _area_slope([icosphere(n) for n in (2, 3, 4, 5)])


@row("antialias", "the same, 0.4 and 0.02 pixels a face (1.3 million)", "worst relative error", high=0.01, slow=True)
def sphere_area_fine() -> Reached:
    return _area_slope([icosphere(n) for n in (6, 8)])


@row(
    "antialias",
    "bodies that hide each other, against fine sampling",
    "error of coverage derivatives",
    high=0.05,
    slow=True,
)
def bodies() -> Reached:
    return Reached(None, _random("bodies")[0])


@row("antialias", "the same", "error of colour derivatives", high=0.10)
def bodies_colour() -> Reached:
    return Reached(None, _random("bodies")[1])


@row("antialias", "triangles that hide each other", "error of coverage derivatives", high=0.05)
def layers() -> Reached:
    return Reached(None, _random("triangles")[0])


@row("antialias", "the same, colours", "error of colour derivatives", high=0.10)
def layers_colour() -> Reached:
    return Reached(None, _random("triangles")[1])


@row("antialias", "a cube with a chart per side (seams at every edge)", "gradient against the seamless", high=1e-3)
def seams() -> Reached:
    vertices, faces, uvs, uv_faces, texture, colours = cube_with_a_chart_per_face()
    intrinsics, pose = camera(96, 96, turn=0.5)
    weight = smooth_image(96, 96, 4, 3)
    reached = []
    for dtype in (torch.float32, torch.float64):
        start = vertices.to(dtype).requires_grad_()
        projected = project(start, intrinsics, pose)
        fragments = rasterize_projected(projected, faces, 96, 96)
        colour = shade(projected, faces, uvs.to(dtype), uv_faces, texture.to(dtype), fragments.face_id)
        layers = torch.cat([(fragments.face_id >= 0).to(dtype)[..., None], colour], dim=-1)
        image = antialias(layers, projected, find_silhouette(projected, edge_table(faces), fragments))
        (got,) = torch.autograd.grad((image * weight).sum(), start)
        exact = vertices.clone().requires_grad_()
        by_vertex = coverage(exact, faces, intrinsics, pose, 96, 96, colours)
        (want,) = torch.autograd.grad((by_vertex * weight).sum(), exact)
        reached.append(float((got - want).norm() / want.norm()))
    return Reached(*reached)


@row("antialias", "duplicated faces", "difference from single ones, picture and gradient", high=1e-3)
def duplicated() -> Reached:
    return _doubled(lambda v, f: (v, torch.cat([f, f])))


@row("antialias", "coincident sheets", "difference from a single one, picture and gradient", high=1e-3)
def sheets() -> Reached:
    return _doubled(lambda v, f: (torch.cat([v, v]), torch.cat([f, f + len(v)])))


@row("antialias", "edges that cross the near plane: a road from behind the camera", "error of dA/dwidth", high=0.02)
def road() -> Reached:
    size = 96
    intrinsics, pose = camera(size, size, distance=0.0, turn=0.2, focal=60.0)

    def area(width: torch.Tensor, scale: int, near: float) -> torch.Tensor:
        corners = torch.tensor([[-1.0, 0.5, -6], [1, 0.5, -6], [1, 0.5, 30], [-1, 0.5, 30]], dtype=width.dtype)
        projected = project(corners * torch.stack([width, width.new_ones(()), width.new_ones(())]),
                            at_scale(intrinsics, scale), pose)  # fmt: skip
        fragments = rasterize_projected(projected, QUAD, scale * size, scale * size, near=near)
        covered = (fragments.face_id >= 0).to(width.dtype)[..., None]
        silhouette = find_silhouette(projected, edge_table(QUAD), fragments, near=near)
        return antialias(covered, projected, silhouette).sum() / scale**2

    worst = [0.0, 0.0]
    for near in (0.05, 1e-6):  # the nearer the plane, the farther outside the picture it cuts the edge: 2e7 pixels
        wide, narrow = (float(area(torch.tensor(0.31 + s, dtype=torch.float64), 8, near)) for s in (0.02, -0.02))
        for k, dtype in enumerate((torch.float32, torch.float64)):
            width = torch.tensor(0.31, dtype=dtype, requires_grad=True)
            (slope,) = torch.autograd.grad(area(width, 1, near), width)
            worst[k] = max(worst[k], abs(float(slope) / ((wide - narrow) / 0.04) - 1))
    return Reached(*worst)


@row("antialias", "an inner silhouette 1000 diameters away, long lens", "error of dA/dscale", high=0.02)
def long_lens() -> Reached:
    distance, faces = 1000.0, torch.cat([QUAD, QUAD + 4])
    intrinsics, pose = camera(96, 96, distance=distance, focal=1.37 * 96 * distance / 3.7)
    exact = 8 * 0.4 * float(intrinsics[0, 0] * intrinsics[1, 1]) / (distance - 0.1) ** 2
    reached = []
    for dtype in (torch.float32, torch.float64):
        scale = torch.tensor(0.4, dtype=dtype, requires_grad=True)
        step = torch.tensor([0, 0, 0.1], dtype=dtype)
        vertices = torch.cat([SQUARE.to(dtype) + step, SQUARE.to(dtype) * scale - step])
        projected = project(vertices, intrinsics, pose)
        fragments = rasterize_projected(projected, faces, 96, 96)
        found = find_silhouette(projected, edge_table(faces), fragments, extent=2.8)
        area = antialias((fragments.face_id >= 2).to(dtype)[..., None], projected, found).sum()
        reached.append(abs(float(torch.autograd.grad(area, scale)[0]) / exact - 1))
    return Reached(*reached)


@row("antialias", "from inside a closed surface, and a patch on a plane", "blended pairs of covered pixels", high=0)
def no_silhouette() -> Reached:
    unit, faces = icosphere(2)
    patch = torch.cat([0.37 * SQUARE, SQUARE])
    scenes = (
        (unit.float(), faces, camera(40, 30, distance=0.3, focal=20.0), 30, 40),
        (patch, torch.cat([QUAD, QUAD + 4]), camera(96, 96, turn=0.03), 96, 96),
    )
    wrong = 0
    for vertices, f, (intrinsics, pose), height, width in scenes:
        projected = project(vertices, intrinsics, pose)
        fragments = rasterize_projected(projected, f, height, width)
        found = find_silhouette(projected, edge_table(f), fragments)
        covered = fragments.face_id.view(-1) >= 0
        wrong += int((covered[found.first] & covered[found.second]).sum())
    return Reached(float(wrong))


@row("antialias", "slivers seen edge-on", "gradients that are not finite", high=0)
def slivers() -> Reached:
    g = torch.Generator().manual_seed(2)
    base, along = torch.rand(40, 3, generator=g) * 2 - 1, torch.randn(40, 3, generator=g)
    tip = base + 0.5 * along + 1e-3 * torch.randn(40, 3, generator=g)
    faces = torch.arange(120).reshape(3, 40).T.contiguous()
    reached = []
    for dtype in (torch.float32, torch.float64):
        start = torch.cat([base, base + along, tip]).to(dtype).requires_grad_()
        image = coverage(start, faces, *camera(64, 64), 64, 64)
        (gradient,) = torch.autograd.grad(image.sum(), start)
        reached.append(float((~torch.isfinite(gradient)).sum() + (~torch.isfinite(image)).sum()))
    return Reached(*reached)


@row("antialias", "triangles of a pixel and less: a pixel in several pairs", "coverage beyond [0, 1]", high=0.5)
def out_of_range() -> Reached:
    worst = [0.0, 0.0]
    for seed in range(4):
        vertices, faces = soup(400, 0.01 * (1 + seed), seed)
        for k, dtype in enumerate((torch.float32, torch.float64)):
            image = coverage(vertices.to(dtype), faces, *camera(96, 96), 96, 96)
            worst[k] = max(worst[k], float((image - 1).max()), float(-image.min()))
    return Reached(*worst)


@row("antialias", "radius 0.9 at 1000 units from the origin, and of size 1e-3", "error of dA/dr", high=0.01)
def places_and_sizes() -> Reached:
    unit, faces = icosphere(3)
    intrinsics, pose = camera(200, 200, turn=0.3)
    exact = _exact_slope(unit, intrinsics, pose)
    worst = [0.0, 0.0]
    for scale, place in ((1.0, (1e3, -400.0, 700.0)), (1e-3, (0, 0, 0)), (1e3, (0, 0, 0))):
        there = torch.tensor(place, dtype=torch.float64)
        moved = pose.clone()
        moved[:3, 3] = scale * pose[:3, 3] - pose[:3, :3] @ there
        for k, dtype in enumerate((torch.float32, torch.float64)):
            # the rounding of positions is part of it: in float32, 6e-5 units at 1000
            start = (unit * 0.9 * scale + there).to(dtype).requires_grad_()
            area = coverage(start, faces, intrinsics, moved, 200, 200).sum()
            (gradient,) = torch.autograd.grad(area, start)
            slope = float((gradient.double() * unit).sum()) * scale
            worst[k] = max(worst[k], abs(slope / exact - 1))
    return Reached(*worst)


def _area_slope(meshes: list[tuple[torch.Tensor, torch.Tensor]]) -> Reached:
    """Worst error of dA/dr in float32 and float64 against the exact area of the convex outline."""
    intrinsics, pose = camera(200, 200)
    worst = [0.0, 0.0]
    for vertices, faces in meshes:
        exact = _exact_slope(vertices, intrinsics, pose)
        for k, dtype in enumerate((torch.float32, torch.float64)):
            radius = torch.tensor(0.9, dtype=dtype, requires_grad=True)
            area = coverage(vertices.to(dtype) * radius, faces, intrinsics, pose, 200, 200).sum()
            (slope,) = torch.autograd.grad(area, radius)
            worst[k] = max(worst[k], abs(float(slope) / exact - 1))
    return Reached(*worst)


def _exact_slope(vertices: torch.Tensor, intrinsics: torch.Tensor, pose: torch.Tensor) -> float:
    from scipy.spatial import ConvexHull

    areas = []
    for radius in (0.9 + 1e-4, 0.9 - 1e-4):
        projected = project(radius * vertices, intrinsics, pose)
        areas.append(ConvexHull((projected[:, :2] / projected[:, 2:]).numpy()).volume)
    return (areas[0] - areas[1]) / 2e-4


@cache
def _random(kind: str) -> tuple[float, float]:
    """Errors of derivatives in coverage and colour over five random scenes of 160^2 pixels, float64."""
    size, pairs = 160, []
    for seed in range(5):
        scene = random_bodies(seed, (1, 2, 4)[seed % 3]) if kind == "bodies" else random_layers(seed)
        vertices, faces, colours, owner = scene
        intrinsics, pose = camera(size, size, turn=0.2 * seed - 0.3, shift=(5.0, -3.0))

        def draw(v, scale, faces=faces, colours=colours, intrinsics=intrinsics, pose=pose):
            return coverage(v, faces, at_scale(intrinsics, scale), pose, scale * size, scale * size, colours)

        pairs.append(derivatives(draw, vertices, owner, seed, size))
    analytic, numeric = (torch.cat(side) for side in zip(*pairs, strict=True))
    of_coverage, of_colour = ((analytic - numeric).norm(dim=0) / numeric.norm(dim=0)).tolist()
    return of_coverage, of_colour


def _doubled(double) -> Reached:
    """Largest relative difference, in picture and summed gradient, of a doubled ball from a single one."""
    unit, faces = icosphere(3)
    intrinsics, pose = camera(96, 96, turn=0.3)
    weight = smooth_image(96, 96, 1, 0)
    reached = []
    for dtype in (torch.float32, torch.float64):
        results = []
        for make in (lambda v, f: (v, f), double):
            vertices, f = make((0.9 * unit).to(dtype), faces)
            start = vertices.requires_grad_()
            image = coverage(start, f, intrinsics, pose, 96, 96)
            (gradient,) = torch.autograd.grad((image * weight.to(dtype)).sum(), start)
            results.append((image.detach(), gradient.view(-1, len(unit), 3).sum(0)))
        (a, g), (b, h) = results
        reached.append(max(float((a - b).abs().max()), float((g - h).abs().max() / g.abs().max())))
    return Reached(*reached)
