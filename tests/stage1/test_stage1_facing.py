"""L_f: which pixels show a closed surface from behind, and that they push its two sides apart again."""

import numpy as np
import pytest
import torch

from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.raster import project, rasterize_projected
from exmesh_graph.stage1.facing import behind
from exmesh_graph.testing import views

SIZE = 48


def seen(vertices, faces, view=0):
    made = views(count=4, size=SIZE)
    k, pose = torch.from_numpy(np.array(made.intrinsics[view])), torch.from_numpy(np.array(made.world_to_camera[view]))
    projected = project(vertices, k.to(vertices), pose.to(vertices))
    return projected, rasterize_projected(projected, faces, SIZE, SIZE), k, pose


def ball(radius=0.6, inside_out=False, levels=2):
    vertices, faces = icosphere(levels, radius)
    faces = faces[:, ::-1].copy() if inside_out else faces
    return torch.from_numpy(vertices).double(), torch.from_numpy(faces).long()


def term(vertices, faces, view=0):
    projected, fragments, k, _ = seen(vertices, faces, view)
    return behind(vertices, faces, projected, fragments, k)


@pytest.mark.parametrize("view", range(4))
def test_a_whole_surface_shows_no_back(view):
    assert term(*ball(), view) is None
    nothing = ball()[0] + 100.0
    assert term(nothing, ball()[1], view) is None


def test_a_surface_that_was_turned_inside_out_shows_its_back_wherever_it_is_seen():
    vertices, faces = ball(inside_out=True)
    covered = (seen(vertices, faces)[1].face_id >= 0).double().mean()
    assert float(term(vertices, faces)) == pytest.approx(float(covered))


@pytest.mark.parametrize("seed", range(4))
def test_value_and_gradient_are_those_of_a_loop_over_pixels(seed):
    """Random triangles, half of them seen from behind."""
    generator = torch.Generator().manual_seed(seed)
    vertices = (0.4 * torch.randn(45, 3, generator=generator, dtype=torch.float64)).requires_grad_()
    faces = torch.arange(45).reshape(15, 3)
    projected, fragments, k, pose = seen(vertices, faces, seed)
    value = behind(vertices, faces, projected, fragments, k)
    assert value is not None
    (gradient,) = torch.autograd.grad(value, vertices)

    wanted, pushes = 0, torch.zeros_like(vertices)
    eye = -pose[:3, :3].T @ pose[:3, 3]
    points = vertices.detach()
    for face in fragments.face_id.reshape(-1).tolist():
        if face < 0:
            continue
        a, b, c = points[faces[face]]
        normal = torch.linalg.cross(b - a, c - a)
        if normal @ (eye - a) < 0:
            wanted += 1
            depth = (pose[:3, :3] @ torch.stack([a, b, c]).T + pose[:3, 3:])[2].mean()
            pushes[faces[face]] -= normal / normal.norm() * float(k[0, 0]) / depth / 3
    assert float(value.detach()) == pytest.approx(wanted / SIZE**2)
    torch.testing.assert_close(gradient, pushes / SIZE**2, rtol=1e-5, atol=1e-9)


@pytest.mark.thorough
def test_sides_that_changed_places_change_back():
    """Two square sheets joined at their rim, the upper one under the lower one: a pillow turned inside out."""
    count = 9
    grid = np.linspace(-0.5, 0.5, count)
    x, y = np.meshgrid(grid, grid, indexing="ij")
    swell = 0.04 * (1 - (2 * x) ** 2) * (1 - (2 * y) ** 2)
    rim = (np.abs(x) == 0.5) | (np.abs(y) == 0.5)
    upper = np.arange(count * count).reshape(count, count)
    lower = np.where(rim, upper, upper + count * count)
    points = np.concatenate([np.stack([x, -swell, y], -1), np.stack([x, swell, y], -1)]).reshape(-1, 3)

    def sheet(index):
        a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
        return np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([a, d, c], -1).reshape(-1, 3)])

    faces = torch.from_numpy(np.concatenate([sheet(upper), sheet(lower)[:, ::-1]]).copy()).long()
    vertices = torch.from_numpy(points).requires_grad_()

    def total():
        return [value for value in (term(vertices, faces, view) for view in range(4)) if value is not None]

    assert sum(map(float, total())) > 0.1
    for _ in range(100):
        found = total()
        if not found:
            break
        (gradient,) = torch.autograd.grad(sum(found), vertices)
        with torch.no_grad():
            vertices -= 0.02 * gradient / gradient.norm(dim=1).max()
    assert not total()
