"""Each rule of the loop by itself: a sign or a term left out must show here."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from stage1_scenes import ball, fresh_state, photographs

from exmesh_graph import losses
from exmesh_graph.geometry.split import subdivide
from exmesh_graph.optim import adam_step
from exmesh_graph.stage1.init import initial_state
from exmesh_graph.stage1.refine import refine
from exmesh_graph.stage1.render import draw, surface_of
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.stage1.smoothness import Bilaplacian
from exmesh_graph.targets import GAIN_LIMITS, fit_gain, prepare_targets
from exmesh_graph.types import DepthMaps

STILL = RefineSettings(
    iterations=1, vertex_lr=0.0, texture_lr=0.0, ssim_weight=0.0, silhouette_weight=0.0, fill_unseen=False
)

PLAIN = Bilaplacian(weight=0.0)


@pytest.fixture(scope="module")
def views():
    return photographs(ball())


def pick(views, index):
    """One view alone."""
    part = slice(index, index + 1)
    return replace(
        views, names=views.names[part], images=views.images[part], alpha=views.alpha[part],
        intrinsics=views.intrinsics[part], camera_to_world=views.camera_to_world[part],
    )  # fmt: skip


def test_a_run_cut_in_two_is_the_same_run(views):
    """Order of the views, decay, step counts and moments go on where the first part stopped."""
    settings = RefineSettings(
        iterations=22,
        total_iterations=30,
        texture_decay=0.01,
        vertex_lr=0.0,
        fill_unseen=False,
    )
    start = fresh_state(ball(), fill=0.5)
    whole, _ = refine(start, views, settings, smoothness=PLAIN, seed=3)
    half, _ = refine(start, views, settings.replaced(iterations=11), smoothness=PLAIN, seed=3)
    both, _ = refine(half, views, settings.replaced(iterations=11), smoothness=PLAIN, seed=3)
    assert np.array_equal(both.texture, whole.texture)
    assert np.array_equal(both.gradient_ema, whole.gradient_ema)
    assert (both.iteration, both.texture_steps) == (22, 22)
    # vertices: areas and mean edge are taken anew with each call, so nearly the same
    moving = settings.replaced(vertex_lr=0.01, vertex_decay=0.00625, vertex_hold=0.0, texture_lr=0.0)
    start = fresh_state(ball(radius=0.57))
    whole, _ = refine(start, views, moving, seed=3)
    half, _ = refine(start, views, moving.replaced(iterations=11), seed=3)
    both, _ = refine(half, views, moving.replaced(iterations=11), seed=3)
    moved = np.abs(whole.vertices - half.vertices).max()
    assert moved > 1e-4
    assert np.abs(both.vertices - whole.vertices).max() < 0.1 * moved


def test_a_step_that_is_held_is_longer_than_one_that_decays_at_once(views):
    """Adam's first step is as long as the rate, whatever the gradient."""
    start = fresh_state(ball(radius=0.57))
    start = replace(start, iteration=20)  # of 100: a fifth of the schedule
    moved = {}
    for hold in (0.0, 0.2):
        settings = RefineSettings(
            iterations=1, total_iterations=100, vertex_lr=0.01, vertex_decay=0.01, vertex_hold=hold, texture_lr=0.0,
            silhouette_weight=1.0,
        )  # fmt: skip
        end, _ = refine(start, views, settings, seed=3)
        moved[hold] = np.linalg.norm(end.vertices - start.vertices, axis=1).max()
    assert moved[0.0] == pytest.approx(0.01**0.2 * moved[0.2], rel=1e-3)


def test_gradient_average_is_equation_1(views):
    """G <- beta G + (1 - beta) |g|: from G = 1 and from 0, with two betas."""
    start = fresh_state(ball(radius=0.57))
    result = {}
    for before in (0.0, 1.0):
        for beta in (0.95, 0.5):
            state = replace(start, gradient_ema=np.full_like(start.gradient_ema, before))
            out, _ = refine(state, views, STILL.replaced(silhouette_weight=5.0, gradient_decay=beta), smoothness=PLAIN)
            result[before, beta] = out.gradient_ema
    norm = result[0.0, 0.5] / 0.5
    assert norm.max() > 0
    assert result[0.0, 0.95] == pytest.approx(0.05 * norm, rel=1e-4, abs=1e-12)
    assert result[1.0, 0.95] == pytest.approx(0.95 + 0.05 * norm, rel=1e-5)


def test_after_a_split_vertices_move_on_as_before():
    """Moments per area and steps per edge length: four faces for one change neither pace nor loss."""
    views = photographs(ball(), size=96)
    settings = RefineSettings(
        iterations=40, total_iterations=4000, vertex_lr=0.01, texture_lr=0.0, uv_gradient=False, ssim_weight=0.0,
        fill_unseen=False,
    )  # fmt: skip
    state, history = refine(fresh_state(ball(radius=0.5)), views, settings, smoothness=PLAIN)
    done = subdivide(state.vertices, state.faces, state.uvs, state.uv_faces)
    finer = replace(
        state, vertices=done.vertices, faces=done.faces, uvs=done.uvs, uv_faces=done.uv_faces,
        vertex_m=done.map.carry(state.vertex_m), vertex_v=done.map.carry(state.vertex_v),
        gradient_ema=done.map.carry(state.gradient_ema),
    )  # fmt: skip
    old = len(state.vertices)
    steps = []
    for start in (state, finer):
        after, more = refine(start, views, settings.replaced(iterations=16), smoothness=PLAIN)
        steps.append(np.linalg.norm(after.vertices[:old] - start.vertices[:old], axis=1))
        assert more["loss"][0] < 1.1 * history["loss"][-1]
    ratio = np.median(steps[1]) / np.median(steps[0])
    # edges are half as long, and steps are counted in edges; moments of raw gradients fall out of this band
    assert 0.4 < ratio < 0.75


def test_scaling_the_scene_scales_the_result(views):
    settings = RefineSettings(iterations=24, vertex_lr=0.02, ssim_weight=0.0, deviation_weight=0.1)
    results = []
    for scale in (1.0, 10.0):
        poses = views.camera_to_world.copy()
        poses[:, :3, 3] *= scale
        start = fresh_state(ball(radius=0.55), fill=0.5)
        start = replace(start, vertices=(scale * start.vertices).astype(np.float32))
        results.append(refine(start, replace(views, camera_to_world=poses), settings)[0].vertices / scale)
    moved = np.abs(results[0] - ball(radius=0.55).vertices).max()
    assert np.abs(results[1] - results[0]).max() < 0.05 * moved


def test_d_ssim_counts_for_the_whole_image(views):
    one = pick(views, 2)
    start = fresh_state(ball(radius=0.57))
    _, history = refine(start, one, STILL.replaced(ssim_weight=1.0), smoothness=PLAIN)
    targets = prepare_targets(one)
    with torch.no_grad():
        picture = draw(surface_of(start), targets.intrinsics[0], targets.world_to_camera[0], one.height, one.width)
        want = float(losses.d_ssim(picture.colour, targets.images[0]))
    assert want > 0.01
    assert history["loss"][0] == pytest.approx(want, rel=1e-3)


def test_without_masks_the_photographs_own_background_counts_for_nothing(views):
    wall = views.images + (1 - views.alpha[..., None]) * np.float32(0.4)
    unmasked = replace(views, images=wall, alpha=np.ones_like(views.alpha), has_masks=False)
    _, history = refine(fresh_state(ball()), unmasked, STILL)
    assert history["loss"][0] < 0.005


def test_depth_is_compared_inside_the_mask_where_it_is_known(views):
    """The surface's own depth, scaled and shifted, correlates fully, whatever stands outside the mask or is missing."""
    one = pick(views, 1)
    targets = prepare_targets(one)
    start = fresh_state(ball())
    with torch.no_grad():
        picture = draw(surface_of(start), targets.intrinsics[0], targets.world_to_camera[0], one.height, one.width)
    seen = picture.fragments.depth.numpy()
    rng = np.random.default_rng(0)
    prior = np.where(seen > 0, 3 * seen + 1, 0)
    half_masked = one.alpha.copy()
    half_masked[:, :, : one.width // 2] = 0
    prior[:, : one.width // 2] = rng.uniform(1, 9, prior[:, : one.width // 2].shape)
    prior[rng.random(prior.shape) < 0.3] = 0
    flat = replace(one, images=one.images * (half_masked > 0)[..., None], alpha=half_masked)
    depths = DepthMaps(one.names, prior[None].astype(np.float32))
    _, without = refine(start, flat, STILL, smoothness=PLAIN)
    _, history = refine(start, flat, STILL.replaced(depth_weight=10.0), smoothness=PLAIN, depths=depths)
    assert history["loss"][0] == pytest.approx(without["loss"][0], abs=1e-3)
    wrong = DepthMaps(one.names, (7 - prior[None]).astype(np.float32))
    _, against = refine(start, flat, STILL.replaced(depth_weight=10.0), smoothness=PLAIN, depths=wrong)
    assert against["loss"][0] > without["loss"][0] + 1


def test_smaller_targets_take_the_depth_at_the_middle_of_their_pixels(views):
    ramp = np.broadcast_to(np.arange(48, dtype=np.float32) + 0.5, (8, 48, 48))
    small = prepare_targets(views, downscale=3, depths=DepthMaps(views.names, ramp)).depth
    assert small[0, 0].tolist() == [3 * i + 1.5 for i in range(16)]


def test_gains_together_cannot_brighten_the_texture():
    """All photographs equally dark: no factor is left that would explain it."""
    dark = photographs(ball(), exposure=[0.7] * 8)
    settings = STILL.replaced(iterations=16)
    _, plain = refine(fresh_state(ball()), dark, settings, smoothness=PLAIN)
    _, gained = refine(fresh_state(ball()), dark, settings.replaced(gains=True), smoothness=PLAIN)
    assert gained["psnr"][-1] == pytest.approx(plain["psnr"][-1], abs=0.2)


def test_a_gain_is_approached_and_held_within_limits():
    image, mask = torch.full((4, 4, 3), 0.5), torch.ones(4, 4)
    mask[:2] = 0
    target = torch.full((4, 4, 3), 0.6)
    target[:2] = 0.0  # outside the mask
    one = torch.ones(3)
    assert fit_gain(image, target, mask, one, rate=0.3).tolist() == pytest.approx([1.06] * 3)
    assert fit_gain(image, 9 * target, mask, one, rate=1.0).tolist() == pytest.approx([GAIN_LIMITS[1]] * 3)
    assert fit_gain(0 * image, target, mask, 0.8 * one, rate=1.0).tolist() == pytest.approx([0.8] * 3)


def test_a_grazed_texel_hardly_moves():
    moved = []
    for gradient in (1e-4, 1e-8):
        t, m, v = (torch.full((1, 1, 1), x) for x in (0.5, 0.0, 0.0))
        adam_step(t, torch.full((1, 1, 1), gradient), m, v, 1, 0.02, epsilon=1e-6)
        moved.append(0.5 - float(t))
    assert moved[0] == pytest.approx(0.02, rel=0.02)
    assert moved[1] == pytest.approx(0.02 * 1e-8 / 1e-6, rel=0.02)


def test_an_empty_silhouette_among_the_views_does_no_harm(views):
    images, alpha = views.images.copy(), views.alpha.copy()
    images[2], alpha[2] = 0, 0
    settings = RefineSettings(iterations=16)
    state, history = refine(fresh_state(ball(radius=0.55)), replace(views, images=images, alpha=alpha), settings)
    assert np.isfinite(history["loss"]).all()
    assert np.isfinite(state.vertices).all()


def test_a_texture_of_one_texel_and_a_camera_inside(views):
    carrier = replace(ball(), texture=np.full((1, 1, 3), 0.5, np.float32))
    state = initial_state(carrier, views)
    assert state.texture.shape == (1, 1, 3)
    poses = views.camera_to_world.copy()
    poses[0, :3, 3] *= 0.1  # within the ball
    out, _ = refine(state, replace(views, camera_to_world=poses), RefineSettings(iterations=8))
    assert np.isfinite(out.vertices).all()
    assert np.isfinite(out.texture).all()
