"""A metal and a dielectric side by side are told apart."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.init import logit
from exmesh_graph.stage2.metal import JOINED, Places, agree_on_metal, agreeing, metal_alone
from exmesh_graph.stage2.objective import plain_terms, weighted_terms
from exmesh_graph.stage2.render import render_transport, render_views
from exmesh_graph.stage2.settings import DecompositionSettings
from exmesh_graph.stage2.together import means_about
from exmesh_graph.testing import carrier as ball
from exmesh_graph.types import Views
from tests.stage2.conftest import SIZE

N = 28  # about one texel per pixel
SETTINGS = DecompositionSettings(
    texture_size=N, environment_height=16, iterations=200, material_rate=0.2, environment_rate=0.1, factor_rate=0.02,
    ssim_weight=0.0, material_weight=0.003, environment_weight=0.001, chroma_weight=0.0, indirect_ramp=10,
    corrections=3, correction_samples=8, metallic=True,
    metal_weight=0.1,
)  # fmt: skip


def _metal(size):
    """1 on one side of the ball, 0 on the other and on the slab."""
    u = np.broadcast_to((np.arange(size) + 0.5) / size, (size, size))
    return np.where((u > 0.06) & (u < 0.3), 1.0, 0.0).astype(np.float32)


@pytest.mark.thorough
def test_metal_and_dielectric_side_by_side(true_asset, cameras, carrier, transport):
    """Light, colour and roughness unknown, one colour for both: eight of ten texels are told right where each decides
    alone, nine of ten where a colour's texels agree; what is no metal comes back."""
    intrinsics, poses = cameras
    true = dataclasses.replace(
        true_asset,
        base_color=np.broadcast_to(np.array([0.75, 0.5, 0.25], np.float32), (64, 64, 3)).copy(),
        roughness=np.full((64, 64), 0.3, np.float32),
        metallic=_metal(64),
    )
    shown = render_views(true, intrinsics, poses, SIZE, SIZE, transport=render_transport(true, 2, 256, 4000))
    views = Views(
        names=tuple(f"v{k}" for k in range(8)), images=shown.images[:8], alpha=shown.alpha[:8],
        intrinsics=intrinsics[:8], camera_to_world=poses[:8], split="train", clipped=False,
    )  # fmt: skip
    wanted = _metal(N) > 0.5
    border = np.zeros_like(wanted)
    border[:, 1:] = wanted[:, 1:] != wanted[:, :-1]
    border[:, :-1] |= border[:, 1:]
    for share, right, least, most in ((0.0, 0.8, 0.35, 0.05), (0.25, 0.9, 0.75, 0.07)):
        asset, curves = fit(carrier, views, transport, SETTINGS.replaced(metal_share=share), seed=1)
        assert asset.metallic is not None
        metal, other = (asset.metallic[asset.seen & ~border & where] for where in (wanted, ~wanted))
        assert np.concatenate([metal > 0.5, other < 0.5]).mean() > right
        assert metal.mean() > least
        assert other.mean() < most
    without, worse = fit(carrier, views, transport, SETTINGS.replaced(metallic=False), seed=1)
    assert without.metallic is None
    assert np.mean(curves["image"][-5:]) < 0.65 * np.mean(worse["image"][-5:])


def _gray_view(cameras):
    intrinsics, poses = cameras
    return Views(
        names=("v0",), images=np.full((1, SIZE, SIZE, 3), 0.3, np.float32), alpha=np.ones((1, SIZE, SIZE), np.float32),
        intrinsics=intrinsics[:1], camera_to_world=poses[:1], split="train", clipped=False,
    )  # fmt: skip


def _table(*rows):
    """Maps whose texels are count times (base colour, metallic), and how much pixels tell of each."""
    texels = sum(row[0] for row in rows)
    maps = SimpleNamespace(settings=SETTINGS, parameter=torch.zeros(texels, 5), size=1)
    color = np.concatenate([np.broadcast_to(np.float32(row[1]), (row[0], 3)) for row in rows])
    metallic = np.concatenate([np.full(row[0], row[2], np.float32) for row in rows])
    maps.parameter[:, :3] = logit(torch.from_numpy(color))
    maps.parameter[:, 4] = logit(torch.from_numpy(metallic))
    maps.values = lambda: torch.sigmoid(maps.parameter)
    weight = np.concatenate([np.full(row[0], row[3], np.float32) for row in rows])
    return maps, torch.from_numpy(weight)


def _lattice(count):
    """Positions [count, 3], ten units apart."""
    side = int(np.ceil(count ** (1 / 3)))
    return np.stack(np.unravel_index(np.arange(count), (side,) * 3), axis=1) * 10.0


def test_texels_of_a_colour_agree_on_metal():
    steel, red, dull = (0.6, 0.58, 0.55), (0.6, 0.1, 0.08), (0.3, 0.4, 0.15)
    maps, weight = _table(
        (300, steel, 0.98, 1.0), (700, steel, 0.02, 1.0),  # a third found: all are metal
        (1000, red, 0.02, 1.0), (20, red, 0.98, 1.0),  # a few: nothing moves
        (500, dull, 0.02, 1.0), (2000, dull, 0.98, 0.0),  # only by texels that no pixel sees: nothing moves
        (50, (0.05, 0.05, 0.04), 0.9, 1.0), (10, (0.05, 0.05, 0.04), 0.02, 1.0),  # black: none is metal
    )  # fmt: skip
    before = maps.parameter.clone()
    # in any order, so that none has its like on all sides; and none is far away
    order = np.random.default_rng(0).permutation(len(weight))
    places = Places(_lattice(len(weight))[order], size=1e6, spacing=1e-3)
    assert agree_on_metal(maps, weight, 0.25, places) == 700 + 50
    metallic = maps.values()[:, 4]
    torch.testing.assert_close(metallic[:300], torch.full((300,), 0.98))  # nothing that was surer
    torch.testing.assert_close(metallic[300:1000], torch.full((700,), JOINED))
    assert torch.equal(maps.parameter[1000:4520], before[1000:4520])
    torch.testing.assert_close(metallic[4520:4570], torch.full((50,), 1 - JOINED))
    assert torch.equal(maps.parameter[4570:], before[4570:])
    assert torch.equal(maps.parameter[:, :4], before[:, :4])
    assert agree_on_metal(maps, weight, 0.25, places) == agree_on_metal(maps, weight, 0.25) == 0


def test_steel_far_away_says_nothing_of_paint_of_its_colour():
    gray = (0.6, 0.58, 0.55)
    maps, weight = _table((500, gray, 0.98, 1.0), (500, gray, 0.02, 1.0))
    apart = _lattice(1000)
    apart[500:, 0] += 1000.0
    before = maps.parameter.clone()
    assert agree_on_metal(maps, weight, 0.25, Places(apart, size=600.0, spacing=1e-3)) == 0
    assert torch.equal(maps.parameter, before)
    assert agree_on_metal(maps, weight, 0.25, Places(apart, size=1e6, spacing=1e-3)) == 500  # a larger object's part


def test_what_lies_among_metal_is_metal_whatever_its_colour():
    """A sheet of 40 x 40 texels: a black spot of 3 x 3 within metal joins, whichever time it is asked; a black spot of
    metal within paint does not spread, and is lowered the first time."""
    row, column = (axis.reshape(-1) for axis in np.mgrid[:40, :40])
    metal = column < 20
    spot = (abs(row - 20) < 2) & ((abs(column - 10) < 2) | (abs(column - 30) < 2))
    colours = np.where(spot[:, None], 0.05, np.where(metal[:, None], (0.6, 0.3, 0.1), (0.1, 0.3, 0.6)))
    maps, weight = _table(*((1, c, m, 1.0) for c, m in zip(colours, np.where(metal != spot, 0.98, 0.02), strict=True)))
    places = Places(np.stack([row, column, 0 * row], axis=1).astype(float), size=28.0, spacing=1.0)
    assert float(maps.values()[spot & metal, 4].max()) < 0.1
    before = maps.parameter.clone()
    assert agree_on_metal(maps, weight, 0.25, places, again=True) == 9
    torch.testing.assert_close(maps.values()[spot & metal, 4], torch.full((9,), JOINED))
    assert torch.equal(maps.parameter[~spot | ~metal], before[~spot | ~metal])
    maps.parameter.copy_(before)
    assert agree_on_metal(maps, weight, 0.25, places) == 18  # the black spot of metal within paint is lowered
    assert not (maps.values()[~metal, 4] > 0.5).any()


def test_places_of_texels():
    """Texels lie on the ball, a spacing apart; what is seen of the map decides which there are."""
    surface = ball(rings=20, sectors=32)
    size = 64
    maps = SimpleNamespace(texels=torch.arange(0, size * size, 3), size=size)
    places = Places.of(surface, maps)
    radius = np.linalg.norm(surface.vertices, axis=1).max()
    assert np.linalg.norm(places.position, axis=1) == pytest.approx(radius, rel=0.03)
    assert places.size == pytest.approx(np.sqrt(3) * radius, rel=0.05)
    assert places.spacing == pytest.approx(np.sqrt(4 * np.pi * radius**2 / len(maps.texels)), rel=0.05)


def test_means_about_a_place_are_those_of_a_gaussian():
    """Beside the sum over all pairs, in three and in six dimensions."""
    generator = np.random.default_rng(1)
    for axes, spread in ((3, 6.0), (6, 2.0)):
        place = generator.uniform(0, spread, (1500, axes))
        values, weight = np.sin(place[:, 0]), generator.uniform(0.1, 1, len(place))
        found = means_about(place, values, weight)
        # a cell's width is a Gaussian's, and a sixth of it more: nearest cell, then bilinear lookup
        square = ((place[:, None] - place[None]) ** 2).sum(-1)
        share = weight * np.exp(-0.5 * square / (1 + 1 / 12 + 1 / 6))
        assert np.abs(found - share @ values / share.sum(1)).max() < 0.06


def test_metal_moves_alone_while_texels_agree():
    """Base colour and roughness wait for a tenth of the steps; no settings but those of a metallic map do it."""
    settings = SETTINGS.replaced(metal_share=0.25)
    assert {step: time for step in range(200) if (time := agreeing(settings, step))} == {100: 1, 140: 2, 170: 3}
    assert [step for step in range(200) if metal_alone(settings, step)] == list(range(100, 120))
    for other in (SETTINGS, settings.replaced(metallic=False)):
        assert not any(agreeing(other, step) or metal_alone(other, step) for step in range(200))


def test_a_metallic_map_asks_for_smoother_maps(true_asset, cameras, carrier, transport):
    """`metal_variation` times the weight of the variation, in both forms of the step; nothing without the map."""
    views = _gray_view(cameras)
    found = {}
    for metallic in (True, False):
        for times in (1.0, 3.0):
            settings = SETTINGS.replaced(metallic=metallic, metal_variation=times)
            model = Decomposition(carrier, views, transport, settings, "cpu")
            generator = torch.Generator().manual_seed(0)
            with torch.no_grad():
                model.maps.parameter += torch.randn(model.maps.parameter.shape, generator=generator)
            model.start()
            for terms in (weighted_terms, plain_terms):
                found[metallic, times, terms] = float(terms(model, model.buffers[0], 0)[0]["material"].detach())
    for terms in (weighted_terms, plain_terms):
        assert found[True, 3.0, terms] == pytest.approx(3 * found[True, 1.0, terms], rel=1e-5)
        assert found[False, 3.0, terms] == found[False, 1.0, terms]


def test_each_texel_is_drawn_to_one_side_once_the_light_is_found(true_asset, cameras, carrier, transport):
    """The term is the weight's share of mean m (1 - m): none in the first half, all of it from seven tenths on."""
    views = _gray_view(cameras)
    model = Decomposition(carrier, views, transport, SETTINGS, "cpu")
    model.start()
    wanted = 0.1 * 0.2 * 0.8  # all texels stand where metallic starts
    for share, part in ((0.0, None), (0.5, None), (0.6, 0.5), (0.7, 1.0), (0.99, 1.0)):
        step = round(share * SETTINGS.iterations)
        for terms in (weighted_terms, plain_terms):
            found, _ = terms(model, model.buffers[0], step)
            assert ("metal" in found) == (part is not None)
            assert part is None or float(found["metal"].detach()) == pytest.approx(part * wanted, rel=1e-4)
    (slope,) = torch.autograd.grad(found["metal"], model.maps.parameter)
    assert (slope[:, 4] > 0).all()  # from 0.2 down: to no metal
    assert not slope[:, :4].any()
