"""Ray origins on the smooth surface, and shading normals that face the viewer."""

import math

import numpy as np
import pytest
import torch

from exmesh_graph.geometry.adjacency import face_normals
from exmesh_graph.rays import make_ray_tracer, offset_origins
from exmesh_graph.shading.terminator import bend_normals, smooth_origins


def _ball(rings):
    """A coarse latitude-longitude ball of radius 1 without its poles' zero faces."""
    lat, lon = np.meshgrid(
        np.linspace(-np.pi / 2, np.pi / 2, rings + 1),
        np.linspace(-np.pi, np.pi, 2 * rings, endpoint=False),
        indexing="ij",
    )
    points = np.stack([np.cos(lat) * np.sin(lon), np.sin(lat), np.cos(lat) * np.cos(lon)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(rings), np.arange(2 * rings), indexing="ij")
    k = (j + 1) % (2 * rings)
    a, b, c, d = (row * 2 * rings + column for row, column in ((i, j), (i, k), (i + 1, k), (i + 1, j)))
    return points, np.concatenate(
        [np.stack([a, b, c], -1)[1:].reshape(-1, 3), np.stack([a, c, d], -1)[:-1].reshape(-1, 3)]
    )


def _samples(points, faces, count=20_000):
    rng = np.random.default_rng(0)
    face = rng.integers(0, len(faces), count)
    bary = rng.dirichlet([1, 1, 1], count)
    corners = points[faces[face]]
    return face, torch.from_numpy(bary), torch.from_numpy(corners), (corners * bary[..., None]).sum(axis=1)


@pytest.mark.parametrize("rings", [6, 12])
def test_a_grazing_sun_leaves_no_steps_on_a_coarse_ball(rings):
    """Lambert's cosine under a sun, everywhere: rays from the flat faces cut off up to a third of the light."""
    points, faces = _ball(rings)
    face, bary, corners, flat = _samples(points, faces)
    normal = flat / np.linalg.norm(flat, axis=1, keepdims=True)
    sun = np.array([0.9, 0.3, 0.3]) / np.linalg.norm([0.9, 0.3, 0.3])
    expected = np.maximum(normal @ sun, 0)
    under = face_normals(points, faces)[face]
    tracer = make_ray_tracer(points, faces)
    directions = np.broadcast_to(sun, flat.shape)

    def lit(origin):
        return np.where(tracer.any_hit(offset_origins(origin, under, tracer.radius), directions), 0, expected)

    smooth = smooth_origins(torch.from_numpy(flat), bary, corners, corners).numpy()
    assert np.abs(lit(smooth) - expected).max() == 0
    steps = np.where(under @ sun > 0, lit(flat), 0) - expected
    assert np.abs(steps).max() > 1 / rings
    # and the origin stays close: within the ball, above the face
    assert (np.linalg.norm(smooth, axis=1) >= np.linalg.norm(flat, axis=1) - 1e-12).all()
    assert np.linalg.norm(smooth, axis=1).max() < 1 + (math.pi / rings) ** 2


def test_origins_stay_at_corners_on_planes_and_in_hollows():
    points, faces = _ball(8)
    face, bary, corners, flat = _samples(points, faces, 500)
    at_corner = torch.eye(3, dtype=torch.float64)[torch.arange(500) % 3]
    corner = corners[torch.arange(500), torch.arange(500) % 3]
    torch.testing.assert_close(smooth_origins(corner, at_corner, corners, corners), corner)
    under = torch.from_numpy(face_normals(points, faces)[face])[:, None].expand(-1, 3, -1)
    start = torch.from_numpy(flat)
    torch.testing.assert_close(smooth_origins(start, bary, corners, under), start)
    torch.testing.assert_close(smooth_origins(start, bary, corners, -corners), start)  # seen from inside: hollow
    # scale-free
    moved = smooth_origins(start * 1e3 + 7, bary, corners * 1e3 + 7, corners)
    torch.testing.assert_close(moved, smooth_origins(start, bary, corners, corners) * 1e3 + 7)


def test_a_normal_map_tilted_by_60_degrees_does_not_turn_black_in_steps():
    """Sweep the view over a plane: the bent normal moves continuously and never looks away from the viewer."""
    angle = torch.linspace(-math.radians(89.5), math.radians(89.5), 4001, dtype=torch.float64)
    view = torch.stack([angle.sin(), torch.zeros_like(angle), angle.cos()], dim=1)
    flat = torch.tensor([[0.0, 0, 1]], dtype=torch.float64).expand_as(view)
    tilt = math.radians(60)
    tilted = torch.tensor([[math.sin(tilt), 0, math.cos(tilt)]], dtype=torch.float64).expand_as(view)
    assert float((tilted * view).sum(-1).min()) < 0  # as it is, the viewer would see it from behind
    bent = bend_normals(tilted, flat, view)
    torch.testing.assert_close(bent.norm(dim=1), torch.ones_like(angle))
    assert float((bent * view).sum(-1).min()) > 0
    assert float((bent[1:] - bent[:-1]).norm(dim=1).max()) < 0.05
    facing = (tilted * view).sum(-1) > 0.1
    torch.testing.assert_close(bent[facing], tilted[facing])
    away = (tilted * view).sum(-1) < 0
    torch.testing.assert_close(bent[away], flat[away])


def test_bent_normals_carry_gradients():
    generator = torch.Generator().manual_seed(0)
    shading, geometric, view = torch.nn.functional.normalize(
        torch.randn(3, 20, 3, generator=generator, dtype=torch.float64), dim=-1
    )
    geometric = geometric * torch.sign((geometric * view).sum(-1, keepdim=True))
    assert torch.autograd.gradcheck(lambda n: bend_normals(n, geometric, view), shading.requires_grad_())
