"""The loop: it recovers a known shape and texture, repeats its bytes, and says what broke."""

from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from stage1_scenes import ball, fresh_state, photographs

from exmesh_graph.errors import DataError, GeometryError, NumericsError
from exmesh_graph.stage1.refine import refine
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.stage1.smoothness import Bilaplacian, Laplacian
from exmesh_graph.targets import prepare_targets
from exmesh_graph.types import DepthMaps

SHORT = RefineSettings(iterations=6)


@pytest.fixture(scope="module")
def views():
    return photographs(ball())


def arrays(state) -> dict[str, np.ndarray]:
    return {f.name: getattr(state, f.name) for f in fields(state) if isinstance(getattr(state, f.name), np.ndarray)}


@pytest.mark.thorough
def test_radius_and_texture_of_a_ball_are_recovered(views):
    start = fresh_state(ball(radius=0.52), fill=0.5)
    settings = RefineSettings(iterations=260, vertex_lr=0.03)
    state, history = refine(start, views, settings, seed=1)
    radius = np.linalg.norm(state.vertices, axis=1)
    assert radius.mean() == pytest.approx(0.6, abs=0.006)
    assert history["psnr"][-1] > history["psnr"][0] + 12
    assert history["psnr"][-1] > 30
    assert history["iteration"][-1] == state.iteration == state.vertex_steps == 260


def test_silhouette_alone_finds_the_radius(views):
    """Colour is given no say: a grey texture that must stay grey, and no gradient through the uv."""
    start = fresh_state(ball(radius=0.52), fill=0.5)
    settings = RefineSettings(
        iterations=160,
        vertex_lr=0.03,
        vertex_decay=0.05,
        texture_lr=0.0,
        uv_gradient=False,
        ssim_weight=0.0,
        fill_unseen=False,
    )
    black = replace(views, images=views.alpha[..., None] * np.float32(0.2140411) * np.ones(3, np.float32))
    state, _ = refine(start, black, settings)
    assert np.linalg.norm(state.vertices, axis=1).mean() == pytest.approx(0.6, abs=0.008)
    assert np.array_equal(state.texture, start.texture)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "change",
    [
        {},
        {"silhouette": "bce", "silhouette_weight": 0.005},
        {"smoothness": Laplacian(weight=0.1), "deviation_weight": 1.0},
        {"gains": True, "downscale": 2, "ssim_weight": 0.0},
        {"depth_weight": 0.1},
    ],
)
def test_every_option_runs_and_repeats_its_bytes(views, change):
    depth = np.where(views.alpha > 0.5, 2.0 + 0.1 * views.alpha, 0).astype(np.float32)
    depth[:, ::2] *= np.where(depth[:, ::2] > 0, 1.05, 1)
    depths = DepthMaps(tuple(reversed(views.names)), depth)
    start = fresh_state(ball(radius=0.55), fill=0.5)
    change = dict(change)
    smoothness = change.pop("smoothness", None)
    settings = SHORT.replaced(**change)
    first, history = refine(start, views, settings, smoothness=smoothness, seed=5, depths=depths)
    second, _ = refine(start, views, settings, smoothness=smoothness, seed=5, depths=depths)
    for name, array in arrays(first).items():
        assert np.array_equal(array, arrays(second)[name]), name
        assert np.isfinite(array).all()
    assert not np.array_equal(first.vertices, start.vertices)
    assert (first.gradient_ema > 0).any()
    assert ("gains" in history) == bool(change.get("gains"))


def test_the_seed_changes_the_order_of_views_only(views):
    start = fresh_state(ball(radius=0.55), fill=0.5)
    a, _ = refine(start, views, SHORT, seed=1)
    b, _ = refine(start, views, SHORT, seed=2)
    assert not np.array_equal(a.vertices, b.vertices)


def test_inputs_are_left_alone_and_zero_iterations_change_nothing(views):
    start = fresh_state(ball())
    before = {name: array.copy() for name, array in arrays(start).items()}
    refine(start, views, SHORT)
    same, history = refine(start, views, SHORT.replaced(iterations=0))
    for name, array in before.items():
        assert np.array_equal(array, arrays(start)[name])
        assert np.array_equal(array, arrays(same)[name])
    assert history["loss"] == []


@pytest.mark.thorough
def test_gains_absorb_exposure_and_average_to_one():
    exposure = np.linspace(0.8, 1.2, 8)
    views = photographs(ball(), exposure=exposure)
    # from the texture's true pattern: out of a grey one, exposure and pattern cannot be told apart
    settings = RefineSettings(iterations=48, vertex_lr=0.0, gains=True, silhouette_weight=0.0)
    _, history = refine(fresh_state(ball()), views, settings)
    gains = np.array([history["gains"][name] for name in views.names])
    assert np.allclose(gains.mean(0), 1, atol=1e-3)
    assert np.allclose(gains, exposure[:, None], atol=0.05)
    _, without = refine(fresh_state(ball()), views, settings.replaced(gains=False))
    assert history["psnr"][-1] > without["psnr"][-1] + 3


def test_depth_moves_the_surface_towards_the_prior(views):
    """A ball before flat photographs of itself; the prior says it is stretched along one camera's axis."""
    start = fresh_state(ball())
    one = replace(
        views,
        names=views.names[:1],
        images=views.images[:1],
        alpha=views.alpha[:1],
        intrinsics=views.intrinsics[:1],
        camera_to_world=views.camera_to_world[:1],
    )
    rows, columns = np.meshgrid(np.arange(48), np.arange(48), indexing="ij")
    depth = (3 + 0.02 * columns + 0.03 * rows).astype(np.float32)[None]
    settings = RefineSettings(
        iterations=30, vertex_lr=0.02, texture_lr=0, ssim_weight=0, silhouette_weight=0.0,
        depth_weight=10.0, vertex_decay=1.0,
    )  # fmt: skip
    smoothness = Bilaplacian(weight=0.01)
    _, without = refine(start, one, settings.replaced(depth_weight=0.0), smoothness=smoothness)
    _, history = refine(start, one, settings, smoothness=smoothness, depths=DepthMaps(one.names, depth))
    assert history["loss"][-1] < 0.85 * history["loss"][0]
    assert without["loss"][-1] < 0.1


@pytest.mark.thorough
def test_progress_is_reported(views):
    calls = []
    refine(
        fresh_state(ball()),
        views,
        SHORT.replaced(iterations=120),
        progress=lambda step, total, **figures: calls.append((step, total, set(figures))),
    )
    assert calls[-1] == (120, 120, {"loss", "psnr"})
    assert len(calls) == 40


def test_what_is_not_finite_is_named(views):
    state = fresh_state(ball())
    broken = replace(views, images=views.images.copy())
    broken.images[3, 20, 20] = np.nan
    with pytest.raises(NumericsError, match=r"refine7, iteration \d, view 'v3'") as caught:
        refine(state, broken, SHORT.replaced(iterations=8), where="refine7")
    assert "l1" in str(caught.value)


def test_inputs_that_cannot_be_used(views):
    state = fresh_state(ball())
    with pytest.raises(GeometryError, match="no faces"):
        refine(replace(state, faces=state.faces[:0], uv_faces=state.uv_faces[:0]), views, SHORT)
    with pytest.raises(DataError, match="no depth map for view 'v1'"):
        refine(state, views, SHORT, depths=DepthMaps(("v0",), views.alpha[:1]))
    with pytest.raises(DataError, match="pixels"):
        refine(state, views, SHORT, depths=DepthMaps(views.names, views.alpha[:, :9]))
    with pytest.raises(DataError, match="leaves nothing"):
        prepare_targets(views, downscale=100)


def test_views_without_masks_refine_by_colour(views):
    unmasked = replace(views, alpha=np.ones_like(views.alpha), has_masks=False)
    state, history = refine(fresh_state(ball(), fill=0.5), unmasked, SHORT.replaced(iterations=40, vertex_lr=0.0))
    assert history["loss"][-1] < history["loss"][0]
    assert np.isfinite(state.texture).all()


def test_the_state_survives_a_face_without_area(views):
    carrier = ball()
    flat = np.concatenate([carrier.faces, [[0, 0, 1]]]).astype(np.int32)
    flat_uv = np.concatenate([carrier.uv_faces, [[0, 0, 1]]]).astype(np.int32)
    state = fresh_state(replace(carrier, faces=flat, uv_faces=flat_uv))
    new, _ = refine(state, views, SHORT)
    assert np.isfinite(new.vertices).all()


def test_threads_are_restored():
    from exmesh_graph.gpu.torch_setup import torch_threads

    before = torch.get_num_threads()
    with torch_threads(before + 1):
        assert torch.get_num_threads() == before + 1
    assert torch.get_num_threads() == before
    with pytest.raises(ZeroDivisionError), torch_threads(before + 1):
        _ = 1 / 0
    with torch_threads(0):
        assert torch.get_num_threads() == before
    assert torch.get_num_threads() == before
