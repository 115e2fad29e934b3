"""Views that do not fit are found by name and by what is wrong with them; good ones are left alone."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from exmesh_nodes import stage1

from exmesh_graph.stage1.diagnose import diagnose, phase_shift, residuals
from exmesh_graph.stage1.refine import refine
from exmesh_graph.stage1.render import surface_of
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.targets import prepare_targets
from exmesh_graph.testing import FakeContext
from tests.stage1.stage1_scenes import ball, fresh_state, photographs

SIZE = 64


def look(views, carrier=None, **options):
    return diagnose(surface_of(carrier or ball()), prepare_targets(views), **options)


def scene(count=10, **options):
    return photographs(ball(), count, SIZE, **options)


def turned(views, index, degrees, axis=1):
    poses = views.camera_to_world.copy()
    angle = math.radians(degrees)
    turn = np.eye(3)
    i, j = [k for k in range(3) if k != axis]
    turn[[i, j], [i, j]] = math.cos(angle)
    turn[i, j], turn[j, i] = -math.sin(angle), math.sin(angle)
    poses[index, :3, :3] = poses[index, :3, :3] @ turn
    return replace(views, camera_to_world=poses)


def unmasked(views, indices, ground=0.3):
    """Some views without their masks, over a patterned ground."""
    images, alpha = views.images.copy(), views.alpha.copy()
    pattern = ground * (0.5 + 0.5 * np.sin(np.arange(SIZE * SIZE * 3).reshape(SIZE, SIZE, 3) * 0.7))
    for i in indices:
        images[i] += (1 - alpha[i])[..., None] * pattern.astype(np.float32)
        alpha[i] = 1.0
    return replace(views, images=images, alpha=alpha)


def test_good_views_are_not_suspect():
    assert look(scene()) == {"suspects": {}, "dark": []}


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("bare", [False, True])
def test_a_camera_wrong_by_two_degrees(axis, bare):
    views = turned(scene(), 4, 2.0, axis)
    if bare:
        views = unmasked(views, [4])
    got = look(views)["suspects"]
    assert list(got) == ["v4"]
    assert "camera" in got["v4"]
    if not bare:
        degrees = float(got["v4"].split("turned by ")[1].split()[0])
        assert 1.5 < degrees < 2.6


def test_one_exposure_and_steps_of_exposure():
    got = look(scene(exposure=[1, 1, 1, 0.6, 1, 1, 1, 1, 1, 1]))["suspects"]
    assert list(got) == ["v3"]
    assert "0.60 times as bright" in got["v3"]
    assert "gains" in got["v3"]
    steps = look(scene(exposure=[0.5, 1.0] * 5))["suspects"]
    assert set(steps) == {f"v{i}" for i in range(0, 10, 2)} or set(steps) == {f"v{i}" for i in range(1, 10, 2)}
    assert look(scene(exposure=[0.5, 1.0] * 5), gains=True)["suspects"] == {}


def test_a_mask_that_leaves_out_a_part():
    views = scene()
    alpha, images = views.alpha.copy(), views.images.copy()
    alpha[7, 20:28, 20:44] = 0
    images[7, 20:28, 20:44] = 0
    got = look(replace(views, alpha=alpha, images=images))["suspects"]
    assert list(got) == ["v7"]
    assert "leaves out parts" in got["v7"]


def test_a_picture_of_something_else():
    views = scene()
    images = views.images.copy()
    images[2] = np.roll(images[2], 1, axis=2) * np.linspace(0.5, 1.5, SIZE, dtype=np.float32)[:, None]
    got = look(replace(views, images=images))["suspects"]
    assert list(got) == ["v2"]
    assert "colours differ" in got["v2"]


def test_a_camera_that_looks_away():
    got = look(turned(scene(), 1, 170.0))["suspects"]
    assert list(got) == ["v1"]
    assert "does not see the object" in got["v1"]


def test_black_views_are_named():
    views = scene()
    images = views.images.copy()
    images[[0, 5]] *= 1e-4
    assert look(replace(views, images=images))["dark"] == ["v0", "v5"]


def test_two_or_three_views_have_no_majority():
    assert look(turned(scene(3), 1, 5.0))["suspects"] == {}


@pytest.mark.parametrize("shift", [(3, -2), (-7, 11), (0, 0)])
def test_phase_shift(shift):
    rng = np.random.default_rng(0)
    spectrum = np.fft.rfft2(rng.normal(size=(48, 40)))
    smooth = spectrum * np.exp(-40 * (np.fft.fftfreq(48)[:, None] ** 2 + np.fft.rfftfreq(40)[None] ** 2))
    one = torch.from_numpy(np.fft.irfft2(smooth, s=(48, 40)))
    got = phase_shift(one, torch.roll(one, (shift[1], shift[0]), (0, 1)))
    np.testing.assert_allclose(got, shift, atol=0.2)
    assert phase_shift(torch.zeros(8, 8), one[:8, :8]).isnan().all()


def test_residuals_of_a_rendering_are_nearly_none():
    found = residuals(surface_of(ball()), prepare_targets(scene()))
    assert found.mask.max() < 1e-3
    assert found.colour.max() < 0.02
    assert found.stops.abs().max() < 0.05
    assert found.shift.norm(dim=1).max() < 0.2


@pytest.mark.thorough
def test_refine_with_a_part_of_the_masks_missing_and_the_warnings_of_its_node():
    """The outline of masked views is kept, the ground of the others is not painted onto the object."""
    true, bare = ball(0.6), [2, 7]
    views = unmasked(scene(), bare)
    assert list(np.flatnonzero(~views.masked)) == bare
    settings = RefineSettings(iterations=150)
    new, history = refine(fresh_state(ball(0.57), 0.5), views, settings)
    assert history["suspects"] == {}
    radius = np.linalg.norm(new.vertices, axis=1)
    assert abs(radius.mean() - 0.6) < 0.006
    whole, _ = refine(fresh_state(ball(0.57), 0.5), scene(), settings)
    gap = np.linalg.norm(new.vertices - whole.vertices, axis=1).mean()
    assert gap < 0.02
    assert len(true.vertices) == len(new.vertices)
    context = FakeContext()
    stage1.refine(
        context, fresh_state(ball()), turned(views, 4, 2.0), p=stage1.RefineParams(iterations=10, device="cpu")
    )
    assert "2 of 10 views have no mask" in context.warnings[0]
    assert "v2, v7" in context.warnings[0]
    assert any(w.startswith("view 'v4'") and "camera" in w for w in context.warnings)


def test_a_diagnosis_comes_with_the_last_round_only():
    views = scene(4)
    for total, there in ((0, True), (40, False), (4, True)):
        _, history = refine(fresh_state(ball()), views, RefineSettings(iterations=4, total_iterations=total))
        assert ("suspects" in history) == there
