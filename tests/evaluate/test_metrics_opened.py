"""Photographs of a painted cup find its mouth, those of a painted drum of the same outside do not."""

from dataclasses import replace

import numpy as np
import pytest

from exmesh_graph.evaluate.metrics.opened import Gain, Judge, Surroundings, detailed, openings
from exmesh_graph.geometry.hull import surface
from exmesh_graph.geometry.lids import lids
from exmesh_graph.geometry.openings import Lidded, opened
from exmesh_graph.io.color import linear_to_srgb, srgb_to_linear
from exmesh_graph.raster import rasterize
from exmesh_graph.raster.camera import pixel_rays
from exmesh_graph.testing import cameras, look_at
from exmesh_graph.types import Views
from tests.geometry.test_openings import drum, grid_of
from tests.priors.prior_scenes import paint

WALL, DEPTH = 0.09, 0.75
CONTRAST = 0.6  # of what is painted, in a soft light


def photographs(vertices, faces, count=20, size=80):
    """Pictures of a painted surface, from above mostly."""
    import torch

    k, poses = cameras(count, size, 3.2)
    eyes = [[np.sin(2.4 * i) * 2.2, 0.8 + 1.6 * (i % 5) / 4, np.cos(2.4 * i) * 2.2] for i in range(count)]
    poses = np.stack([look_at(eye) for eye in eyes])
    mesh = torch.from_numpy(vertices), torch.from_numpy(faces)
    depth = rasterize(*mesh, torch.from_numpy(k), torch.from_numpy(np.linalg.inv(poses)), size, size).depth
    images = []
    for one, intrinsics, pose in zip(depth, k, poses, strict=True):
        rays = pixel_rays(torch.from_numpy(intrinsics), size, size, one).numpy()
        points = (one.numpy()[..., None] * rays) @ pose[:3, :3].T + pose[:3, 3]
        colour = np.stack([paint(points + shift, 1.0) for shift in (0, 0.3, 0.7)], axis=-1)
        images.append(np.where(one.numpy()[..., None] > 0, colour**2.2, 0))
    alpha = (depth.numpy() > 0).astype(np.float32)
    return Views(tuple(f"{i}" for i in range(count)), np.stack(images).astype(np.float32), alpha, k, poses, "train")


@pytest.fixture(scope="module")
def solid():
    grid = grid_of(48)
    return drum(grid), grid


@pytest.fixture(scope="module")
def cup(solid):
    values, grid = solid
    mesh = surface(values, grid)
    top = next(lid for lid in lids(values, grid, *mesh) if lid.normal[1] > 0.9)
    lidded = Lidded(values, grid, *mesh, top)
    return photographs(*opened(values, grid, [lidded.opening(WALL, DEPTH)])), mesh, top, lidded


def test_the_true_opening_gains_most_and_no_light_counts(cup):
    views, mesh, top, lidded = cup
    dimmed = Views(views.names, views.images * np.linspace(0.5, 1.2, len(views), dtype=np.float32)[:, None, None, None],
                   views.alpha, views.intrinsics, views.camera_to_world, "train")  # fmt: skip
    for pictures in (views, dimmed):
        judge = Judge(Surroundings(pictures, *mesh), top)
        assert judge.able
        gains = {size: judge.gain(lidded.opening(*size)) for size in [(WALL, DEPTH), (WALL, 0.3), (0.25, DEPTH)]}
        true = gains.pop((WALL, DEPTH))
        assert true.enough
        assert all(other.share < true.share - 0.05 for other in gains.values())


def test_a_lid_that_hardly_any_photograph_shows_is_not_judged(solid, cup):
    values, grid = solid
    views, mesh, _, _ = cup
    under = next(lid for lid in lids(values, grid, *mesh) if lid.normal[1] < -0.9)
    assert not Judge(Surroundings(views, *mesh), under).able


@pytest.mark.parametrize("low", ["share", "sigmas", "better"])
def test_each_figure_has_its_say(low):
    figures = {"share": 0.3, "sigmas": 8.0, "better": 1.0, "unseen": 0.0}
    assert Gain(**figures).enough
    assert not Gain(**{**figures, low: figures[low] / 10}).enough


def test_less_is_asked_where_every_photograph_gains():
    """Metal is foretold badly all over, and a mouth in it by less beyond chance."""
    assert Gain(share=0.25, sigmas=5.4, better=1.0, unseen=0.0).enough
    assert not Gain(share=0.25, sigmas=5.4, better=0.94, unseen=0.0).enough
    assert not Gain(share=0.25, sigmas=4.8, better=1.0, unseen=0.0).enough


@pytest.mark.thorough
def test_photographs_of_a_cup_find_its_mouth(solid, cup):
    found = openings(*solid, cup[0])
    assert len(found) == 1
    opening, gain = found[0]
    assert opening.lid.normal[1] > 0.99
    assert opening.wall == pytest.approx(WALL, abs=0.04)
    assert opening.depth == pytest.approx(DEPTH, abs=0.12)
    assert gain.share > 0.5
    assert openings(*solid, photographs(*cup[1])) == []


def test_detail_is_what_a_soft_light_leaves(cup):
    """A picture of one colour has none, and brightness that changes slowly is not in it."""
    views = cup[0]
    held = views.alpha > 0.5
    plain = detailed(replace(views, images=np.where(held[..., None], np.full(3, 0.3, np.float32), np.float32(0))))
    assert np.allclose(linear_to_srgb(plain.images[held]), 0.5, atol=1e-3)
    before, after = (linear_to_srgb(detailed(one).images[held]) - 0.5 for one in (views, soft(views)))
    assert np.abs(after - CONTRAST * before).mean() < 0.1 * np.abs(before).mean()


def soft(views, light=0.2):
    """The same in a light, some display values strong, that no two photographs share: what metal mirrors, say."""
    across = np.linspace(-1, 1, views.width)
    wave = np.stack([np.add.outer(across * np.cos(2.4 * i), across * np.sin(2.4 * i)) for i in range(len(views))])
    lit = linear_to_srgb(views.images) * CONTRAST + light * (1 + wave[..., None])
    return replace(views, images=np.where(views.alpha[..., None] > 0.5, srgb_to_linear(lit), 0).astype(np.float32))


@pytest.mark.thorough
def test_detail_says_how_deep_a_mouth_is_that_mirrors(solid, cup):
    found = openings(*solid, soft(cup[0]))
    assert len(found) == 1
    opening, gain = found[0]
    assert opening.depth == pytest.approx(DEPTH, abs=0.12)
    assert opening.wall == pytest.approx(WALL, abs=0.05)
    assert gain.detail > 0.1
