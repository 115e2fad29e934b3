"""Rows of visibility: which face is seen, and where."""

from __future__ import annotations

import torch

from benchmarks.stability.scenes import camera, icosphere, soup
from benchmarks.stability.table import Reached, row
from exmesh_graph.raster import Fragments, project, rasterize, rasterize_projected
from tests.raster.raster_reference import rasterize_reference

SQUARE = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
QUAD = torch.tensor([[0, 1, 2], [0, 2, 3]])


@row("raster", "one triangle over the whole screen, corners far outside", "uncovered pixels", high=0)
def whole_screen() -> Reached:
    vertices = torch.tensor([[-900.0, -900, 5], [900, -900, 5], [0, 1800, 5]])
    return _both(vertices, torch.tensor([[0, 1, 2]]), *camera(256, 192), 192, 256)


@row("raster", "camera inside a closed surface", "uncovered pixels", high=0)
def inside() -> Reached:
    vertices, faces = icosphere(2)
    return _both(vertices.float(), faces, *camera(80, 60, distance=0.3, focal=40.0), 60, 80)


@row("raster", "shared edges through pixel centres: a fan over the screen", "uncovered pixels", high=0)
def fan() -> Reached:
    n = 60
    angle = torch.arange(n) * (2 * torch.pi / n)
    ring = torch.stack([2 * angle.cos(), 2 * angle.sin(), torch.zeros(n)], dim=1)
    i = torch.arange(n)
    faces = torch.stack([torch.zeros_like(i), 1 + i, 1 + (i + 1) % n], dim=1)
    return _both(torch.cat([torch.zeros(1, 3), ring]), faces, *camera(64, 64), 64, 64)


@row("raster", "a floor from behind the camera and a soup, cut by the near plane", "pixels of another face", high=0)
def near_plane() -> Reached:
    floor = torch.tensor([[-3.0, 0.5, -9], [3, 0.5, -9], [0, 0.5, 60]])
    vertices, faces = soup(40, 1.0, seed=9)
    faces = torch.cat([torch.tensor([[0, 1, 2]]), faces + 3])
    intrinsics, pose = camera(64, 64, focal=50.0)
    wrong = [
        _disagreement(torch.cat([floor, vertices]), faces, intrinsics, pose, 64, 64, near=n) for n in (1e-3, 0.5, 3.4)
    ]
    return Reached(float(sum(wrong)))


@row("raster", "slivers, a thousandth as wide as long", "pixels of another face than in float64", high=0)
def slivers() -> Reached:
    g = torch.Generator().manual_seed(1)
    base, along = torch.rand(30, 3, generator=g) * 2 - 1, torch.randn(30, 3, generator=g)
    tip = base + 0.5 * along + 1e-3 * torch.randn(30, 3, generator=g)
    faces = torch.arange(90).reshape(3, 30).T.contiguous()
    return Reached(_disagreement(torch.cat([base, base + along, tip]), faces, *camera(128, 128), 128, 128))


@row("raster", "faces without area, and with vertices that are not finite", "pixels they own or spoil", high=0)
def broken_faces() -> Reached:
    vertices, faces = soup(30, 0.5, seed=5)
    intrinsics, pose = camera(64, 64)
    want = rasterize(vertices, faces, intrinsics, pose, 64, 64)
    lines = torch.stack([faces[:, 0], faces[:, 1], faces[:, 0]], dim=1)
    broken = torch.cat([vertices, torch.tensor([[torch.nan, 0, 0], [0, torch.inf, 0]])])
    bad = torch.stack([torch.full_like(faces[:, 0], 90), faces[:, 1], torch.full_like(faces[:, 0], 91)], dim=1)
    got = rasterize(broken, torch.cat([lines, bad, faces]), intrinsics, pose, 64, 64)
    same = got.face_id == torch.where(want.face_id >= 0, want.face_id + 60, -1)
    finite = torch.isfinite(got.bary).all(-1) & torch.isfinite(got.depth)
    return Reached(float((~(same & finite)).sum()))


@row("raster", "duplicated faces: of equal depths the lowest index wins", "pixels of a copy", high=0)
def ties() -> Reached:
    vertices, faces = icosphere(3)
    got = rasterize(vertices.float(), torch.cat([faces] * 3), *camera(128, 128), 128, 128)
    return Reached(float((got.face_id >= len(faces)).sum()))


@row("raster", "radius 0.9 at 1000 units, of size 1e-3, of size 1e3", "share of pixels that change", high=0.01)
def places_and_sizes() -> Reached:
    vertices, faces = icosphere(3)
    intrinsics, pose = camera(96, 96, turn=0.3)
    want = rasterize(0.9 * vertices, faces, intrinsics, pose, 96, 96).face_id
    worst = 0.0
    for scale, place in ((1.0, (1e3, -400.0, 700.0)), (1e-3, (0, 0, 0)), (1e3, (0, 0, 0)), (1e-3, (1e-1, 0, 0))):
        there = torch.tensor(place, dtype=torch.float64)
        moved = pose.clone()
        moved[:3, 3] = scale * pose[:3, 3] - pose[:3, :3] @ there
        at = (0.9 * scale * vertices + there).float()
        got = rasterize(at, faces, intrinsics, moved, 96, 96, near=1e-3 * scale).face_id
        worst = max(worst, float((got != want).float().mean()))
    return Reached(worst)


@row("raster", "large faces split into tiles; a batch of views", "pixels that differ from one by one", high=0)
def tiles_and_batches() -> Reached:
    vertices, faces = soup(60, 30.0, seed=3)
    cameras = [camera(75, 50, turn=t, shift=(7.0, -4.0)) for t in (0.0, 0.4, 1.2)]
    projected = torch.stack([project(vertices, *c) for c in cameras])
    together = rasterize_projected(projected, faces, 50, 75, large_face=100)
    wrong = 0
    for k in range(3):
        alone = rasterize_projected(projected[k], faces, 50, 75)
        wrong += sum(int((a[k] != b).sum()) for a, b in zip(together, alone, strict=True))
    return Reached(float(wrong))


@row("raster", "a crop: principal point outside the picture, other aspect ratio", "pixels that differ", high=0)
def crop() -> Reached:
    vertices, faces = icosphere(3)
    intrinsics, pose = camera(128, 96, turn=0.2)
    whole = rasterize(vertices.float(), faces, intrinsics, pose, 96, 128).face_id
    cut = intrinsics.clone()
    cut[0, 2] -= 75
    cut[1, 2] -= 13
    part = rasterize(vertices.float(), faces, cut, pose, 80, 53).face_id
    covered_edges = part != whole[13:93, 75:128]
    # a centre within rounding of an edge may go to the face next to it, never to the background or back
    return Reached(float((covered_edges & ((part < 0) != (whole[13:93, 75:128] < 0))).sum()))


@row("raster", "1.3 million sub-pixel triangles (a closed ball)", "holes inside the outline", high=0, slow=True)
def million() -> Reached:
    vertices, faces = icosphere(8)
    intrinsics, pose = camera(256, 256)
    got = rasterize(0.9 * vertices, faces, intrinsics, pose, 256, 256)
    y, x = torch.meshgrid(torch.arange(256) + 0.5, torch.arange(256) + 0.5, indexing="ij")
    focal = torch.stack([intrinsics[0, 0], intrinsics[1, 1]])
    off = ((x - 128) / focal[0]).square() + ((y - 128) / focal[1]).square()
    inner = off < (0.995 * 0.9) ** 2 / (3.7**2 - 0.9**2)
    return Reached(float(((got.face_id < 0) & inner).sum()))


def _both(
    vertices: torch.Tensor, faces: torch.Tensor, intrinsics: torch.Tensor, pose: torch.Tensor, height: int, width: int
) -> Reached:
    """Uncovered pixels in float32, and by brute force in float64."""
    got = rasterize(vertices, faces, intrinsics, pose, height, width)
    want = rasterize_reference(vertices.double(), faces, intrinsics, pose, height, width)
    return Reached(float((got.face_id < 0).sum()), float((want.face_id < 0).sum()))


def _disagreement(
    vertices: torch.Tensor,
    faces: torch.Tensor,
    intrinsics: torch.Tensor,
    pose: torch.Tensor,
    height: int,
    width: int,
    near: float = 1e-3,
) -> float:
    """Pixels whose face is not that of the float64 reference, but for ties of depth and centres on an edge."""
    got = rasterize(vertices, faces, intrinsics, pose, height, width, near=near)
    want = rasterize_reference(vertices.double(), faces, intrinsics, pose, height, width, near=near)
    tie = (got.depth - want.depth).abs() < 1e-5 * want.depth
    return float(((got.face_id != want.face_id) & ~_on_edge(got) & ~_on_edge(want) & ~tie).sum())


def _on_edge(fragments: Fragments) -> torch.Tensor:
    return (fragments.face_id >= 0) & (fragments.bary.min(-1).values < 1e-3)
