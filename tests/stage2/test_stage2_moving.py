"""Fits and renders under light that moves with the camera, and what tells of it."""

import dataclasses

import numpy as np
import pytest
import torch
from exmesh_nodes import stage2 as nodes

from exmesh_graph.errors import DataError
from exmesh_graph.shading.moving import light_turns, turned
from exmesh_graph.shading.settings import MonteCarloSettings
from exmesh_graph.shading.transport import with_bounces
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.init import neutral_asset
from exmesh_graph.stage2.moving import axis_for, tell
from exmesh_graph.stage2.objective import plain_terms, weighted_terms
from exmesh_graph.stage2.render import render_transport, render_views
from exmesh_graph.stage2.settings import DecompositionSettings, StartSettings
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import Views

UP, FLASH = np.array([0, 1.0, 0], np.float32), np.zeros(3, np.float32)
SETTINGS = DecompositionSettings(
    texture_size=48, environment_height=16, iterations=160, material_rate=0.3, environment_rate=0.6, rate_decay=0.1,
    ssim_weight=0.0, material_weight=0.01, environment_weight=0.002, chroma_weight=0.02, corrections=1,
    correction_samples=8,
)  # fmt: skip


def _photographed(truth, cameras, axis):
    """The eight training views of `truth` under its own light, which moves as `axis` says."""
    size = 48
    moving = dataclasses.replace(truth, light_axis=axis)
    light = render_transport(truth, 2, directions=256, points=3000)
    shown = render_views(moving, *cameras, size, size, transport=light)
    intrinsics, poses = cameras
    return Views(
        names=tuple(f"v{k}" for k in range(8)), images=shown.images[:8], alpha=shown.alpha[:8],
        intrinsics=intrinsics[:8], camera_to_world=poses[:8], split="train", clipped=False,
    )  # fmt: skip


@pytest.fixture(scope="module")
def small_cameras(cameras):
    intrinsics = cameras[0].copy()
    intrinsics[:, :2] *= 48 / (2 * intrinsics[0, 0, 2])
    return intrinsics, cameras[1]


@pytest.fixture(scope="module", params=[UP, FLASH], ids=["turntable", "camera"])
def axis(request):
    return request.param


@pytest.fixture(scope="module")
def views(true_asset, small_cameras, axis):
    return _photographed(true_asset, small_cameras, axis)


def test_a_view_is_drawn_under_the_environment_as_it_stands_for_it(true_asset, small_cameras, views, axis):
    light = render_transport(true_asset, 2, directions=256, points=3000)
    turn = light_turns(axis, small_cameras[1])[5]
    sky = turned(torch.from_numpy(true_asset.environment), turn).numpy()
    shown = render_views(true_asset, *small_cameras, 48, 48, transport=light, environment=sky)
    np.testing.assert_allclose(views.images[5], shown.images[5], atol=1e-5)
    still = render_views(true_asset, *small_cameras, 48, 48, transport=light)
    assert np.abs(still.images[5] - shown.images[5]).max() > 0.05


@pytest.mark.parametrize("bounces", [0, 1])
def test_fused_and_plain_terms_agree(carrier, transport, views, axis, bounces):
    light = with_bounces(transport, bounces) if bounces else transport
    model = Decomposition(carrier, views, light, SETTINGS, "cpu", start=neutral_asset(carrier, axis=axis))
    model.start()
    for number in (1, 6):
        found, expected = (terms(model, model.buffers[number], 50)[0] for terms in (weighted_terms, plain_terms))
        assert set(found) == set(expected)
        for name, value in expected.items():
            torch.testing.assert_close(found[name], value, rtol=2e-4, atol=1e-6)
        gradients = []
        for terms in (found, expected):
            model.environment.grad = None
            torch.stack(list(terms.values())).sum().backward()
            gradients.append(model.environment.grad.clone())
        torch.testing.assert_close(*gradients, rtol=5e-3, atol=1e-6)


def test_measured_rays_are_those_of_a_view_under_its_own_environment(carrier, transport, views, axis):
    """As in a fit whose light stands, of that view alone and with the environment turned for it."""
    settings = SETTINGS.replaced(environment_height=32)
    start = neutral_asset(carrier)
    sky = np.random.default_rng(0).random((32, 64, 3)).astype(np.float32) + 0.2
    moving = Decomposition(
        carrier, views, transport, settings, "cpu",
        start=dataclasses.replace(start, environment=sky, light_axis=axis),
    )  # fmt: skip
    turn = light_turns(axis, views.camera_to_world)[3]
    here = turned(torch.from_numpy(sky), turn).numpy()
    still = Decomposition(
        carrier, views, transport, settings, "cpu", start=dataclasses.replace(start, environment=here)
    )
    shown = []
    for model in (moving, still):
        model.start()
        buffer = model.buffers[3]
        environment, values = (here if model is still else sky), model.maps.values()
        assert environment.shape == (32, 64, 3)
        model.light.find_suns = lambda environment, buffers: None
        model.light.measure(
            model.prepare(1.0, 0).appearance, [buffer], torch.Generator().manual_seed(3)
        )  # fmt: skip
        assert values.shape[1] == 4
        shown.append((buffer.light.specular_scale, model.shade(buffer, model.prepare(1.0, 0))[0]))
    for found, expected in zip(*shown, strict=True):
        torch.testing.assert_close(found, expected, rtol=2e-3, atol=2e-4)


def test_sampled_light_with_kept_rays_turns_as_well(carrier, views, axis):
    sky = np.random.default_rng(0).random((16, 32, 3)).astype(np.float32) + 0.2
    start = dataclasses.replace(neutral_asset(carrier), environment=sky)
    turn = light_turns(axis, views.camera_to_world)[3]
    here = dataclasses.replace(start, environment=turned(torch.from_numpy(sky), turn).numpy())
    shown = []
    for begun in (dataclasses.replace(start, light_axis=axis), here):
        light = MonteCarloSettings(samples=8, bounces=0, kept=2)
        model = Decomposition(carrier, views, light, SETTINGS, "cpu", start=begun)
        model.start()
        model.measure(0.0, torch.Generator().manual_seed(0))
        shown.append(model.shade(model.buffers[3], model.prepare(0.0, 0))[0])
    torch.testing.assert_close(*shown, rtol=2e-3, atol=2e-4)


@pytest.mark.thorough
def test_a_fit_under_light_that_moves_draws_a_view_that_it_was_not_given(
    true_asset, carrier, transport, small_cameras, views, axis
):
    light = render_transport(true_asset, 2, directions=256, points=3000)
    held = tuple(part[8:] for part in small_cameras)
    true = render_views(dataclasses.replace(true_asset, light_axis=axis), *held, 48, 48, transport=light).images[0]
    errors = {}
    for name, kind in (("moves", axis), ("stands", None)):
        start = neutral_asset(carrier, StartSettings(base_color="gray"), axis=kind)
        found, _ = fit(carrier, views, transport, SETTINGS, start=start)
        assert (found.light_axis is None) == (kind is None)
        errors[name] = np.abs(render_views(found, *held, 48, 48, transport=light).images[0] - true).mean()
    assert errors["moves"] < 0.7 * errors["stands"]


def test_colours_tell_whether_the_light_moves(true_asset, carrier, small_cameras, views, train_views, axis):
    assert tell(carrier, views).hint() < 0.7
    assert tell(carrier, train_views).hint() > 0.9
    dark = dataclasses.replace(views, alpha=np.zeros_like(views.alpha))
    assert tell(carrier, dark) is None


def test_the_axis_of_a_start(carrier, views, train_views):
    found = nodes.init(FakeContext(), carrier, None, None, views, p=StartSettings(light_moves="turntable"))
    np.testing.assert_allclose(found.asset.light_axis, UP, atol=1e-6)
    found = nodes.init(FakeContext(), carrier, p=StartSettings(light_moves="camera"))
    assert not found.asset.light_axis.any()
    assert nodes.init(FakeContext(), carrier, p=StartSettings()).asset.light_axis is None
    with pytest.raises(DataError, match="no cameras tell"):
        axis_for("turntable", None)
    with pytest.raises(DataError, match="light_moves: camera"):
        axis_for(
            "turntable", dataclasses.replace(train_views, camera_to_world=train_views.camera_to_world[:1].repeat(8, 0))
        )
