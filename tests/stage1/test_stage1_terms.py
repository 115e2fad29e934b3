"""The terms of the loss (paper eq. 7 to 9): weights, gradients, what is not defined, no scale, and the region."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from stage1_scenes import ball, fresh_state, photographs

from exmesh_graph import losses
from exmesh_graph.errors import DataError
from exmesh_graph.raster import edge_table
from exmesh_graph.stage1.refine import refine
from exmesh_graph.stage1.regularise import deviation, smoother
from exmesh_graph.stage1.render import draw, surface_of
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.stage1.smoothness import Bilaplacian, Laplacian
from exmesh_graph.stage1.terms import Terms
from exmesh_graph.targets import prepare_targets
from exmesh_graph.types import DepthMaps

EVERYTHING = RefineSettings(depth_weight=1.0, deviation_weight=1.0, silhouette_weight=1.0)
PLAIN = Bilaplacian(weight=0.0)


@pytest.fixture(scope="module")
def views():
    return photographs(ball(), count=4)


def tilted(views) -> DepthMaps:
    rows, columns = np.indices(views.alpha.shape[1:])
    depth = np.broadcast_to(3 + 0.02 * columns + 0.03 * rows, views.alpha.shape).astype(np.float32)
    return DepthMaps(views.names, depth)


def terms_of(views, settings, depths=None, region=None, scale=1.0, view=1, smoothness=None):
    """(terms by name, gradient of each in the vertices) of one view of a ball that is slightly too small."""
    carrier = ball(radius=0.57)
    rng = np.random.default_rng(0)
    carrier = replace(carrier, vertices=carrier.vertices + rng.normal(0, 0.01, carrier.vertices.shape).astype("f"))
    poses = views.camera_to_world.copy()
    poses[:, :3, 3] *= scale
    scaled = replace(views, camera_to_world=poses)
    surface = surface_of(replace(carrier, vertices=(scale * carrier.vertices).astype(np.float32)))
    surface.vertices.requires_grad_()
    targets = prepare_targets(scaled, depths=depths, region=region)
    made = Terms(surface, targets, settings, smoothness or Laplacian(weight=1.0))
    if made.reference is not None:
        made.reference += scale * 0.01 * torch.from_numpy(rng.normal(0, 1, carrier.vertices.shape).astype("f"))
    picture = draw(surface, targets.intrinsics[view], targets.world_to_camera[view], targets.height, targets.width)
    terms, _ = made.of(view, picture, surface.vertices)
    gradients = {
        name: torch.autograd.grad(term, surface.vertices, retain_graph=True)[0]
        for name, term in terms.items()
        if term.requires_grad
    }
    return {name: float(term.detach()) for name, term in terms.items()}, gradients


def test_no_term_depends_on_the_scenes_scale(views):
    depths = tilted(views)
    base, slopes = terms_of(views, EVERYTHING, depths)
    assert set(base) == {"l1", "d_ssim", "silhouette", "depth", "smoothness", "deviation"}
    for scale in (1e-3, 1e3):
        terms, gradients = terms_of(views, EVERYTHING, depths, scale=scale)
        assert terms == pytest.approx(base, rel=2e-3)
        for name, slope in slopes.items():
            assert float(slope.abs().max()) > 0, name
            away = (scale * gradients[name] - slope).norm() / slope.norm()
            assert float(away) < 0.02, name


def test_weights_multiply_their_terms(views):
    depths = tilted(views)
    base, _ = terms_of(views, EVERYTHING, depths)
    twice = EVERYTHING.replaced(depth_weight=2, deviation_weight=2, silhouette_weight=2)
    terms, _ = terms_of(views, twice, depths, smoothness=Laplacian(weight=2.0))
    for name in ("silhouette", "depth", "smoothness", "deviation"):
        assert terms[name] == pytest.approx(2 * base[name], rel=1e-5)
    half, _ = terms_of(views, EVERYTHING.replaced(ssim_weight=0.4), depths)
    assert half["l1"] == pytest.approx(0.75 * base["l1"], rel=1e-5)
    assert half["d_ssim"] == pytest.approx(2 * base["d_ssim"], rel=1e-5)
    none = EVERYTHING.replaced(ssim_weight=0, depth_weight=0, deviation_weight=0, silhouette_weight=0)
    assert set(terms_of(views, none, depths, smoothness=PLAIN)[0]) == {"l1"}


def test_gradients_in_float64():
    state = fresh_state(ball())
    v = torch.from_numpy(state.vertices).double()
    of = smoother(v, edge_table(torch.from_numpy(state.faces)).edges)
    moved = (v + 0.02 * torch.randn(v.shape, generator=torch.Generator().manual_seed(0), dtype=v.dtype))[:40]
    some = smoother(v[:40], of.edges[(of.edges < 40).all(1)])
    assert torch.autograd.gradcheck(lambda x: deviation(x, v[:40], some), moved.clone().requires_grad_())
    rng = torch.Generator().manual_seed(1)
    alpha = (0.05 + 0.9 * torch.rand(5, 6, generator=rng, dtype=torch.float64)).requires_grad_()
    mask = torch.rand(5, 6, generator=rng, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda a: losses.silhouette_bce(a, mask), alpha)
    assert torch.autograd.gradcheck(lambda a: losses.l1(a, mask), alpha)
    by_hand = -(mask * alpha.log() + (1 - mask) * (1 - alpha).log()).mean()
    assert float(losses.silhouette_bce(alpha, mask).detach()) == pytest.approx(float(by_hand.detach()))


@pytest.mark.parametrize("case", ["constant prior", "no prior", "empty mask"])
def test_a_depth_term_that_is_not_defined_is_nothing(views, case):
    """No correlation without variation: value and gradient are zero, and finite."""
    depths = tilted(views)
    if case == "constant prior":
        depths = replace(depths, depth=np.full_like(depths.depth, 2.5))
    elif case == "no prior":
        depths = replace(depths, depth=np.zeros_like(depths.depth))
    else:
        views = replace(views, alpha=np.where(views.alpha > 0, np.float32(0.3), np.float32(0)))
    terms, gradients = terms_of(views, EVERYTHING, depths)
    assert terms["depth"] == 0
    assert "depth" not in gradients  # it does not depend on the vertices
    assert set(gradients) == {"l1", "d_ssim", "silhouette", "smoothness", "deviation"}
    assert all(bool(torch.isfinite(g).all()) for g in gradients.values())


# --- views without masks: the region


def unmasked(views, wall=0.4):
    images = views.images + (1 - views.alpha[..., None]) * np.float32(wall)
    return replace(views, images=images, alpha=np.ones_like(views.alpha), has_masks=False)


def test_outside_the_region_nothing_counts(views):
    plain = unmasked(views)
    region = ball(radius=0.4)
    inside = prepare_targets(plain, region=region).inside
    assert 0.1 < float(inside.float().mean()) < 0.4
    settings = RefineSettings(coverage_weight=0.0)
    base, _ = terms_of(plain, settings, region=region, smoothness=PLAIN)
    noisy = plain.images.copy()
    # SSIM windows reach five pixels into the region, so it is left out here
    noisy[~inside.numpy()] = 0.9
    settings = settings.replaced(ssim_weight=0.0)
    base, slopes = terms_of(plain, settings, region=region, smoothness=PLAIN)
    terms, gradients = terms_of(replace(plain, images=noisy), settings, region=region, smoothness=PLAIN)
    assert terms["l1"] == pytest.approx(base["l1"], rel=1e-5)
    assert torch.allclose(gradients["l1"], slopes["l1"], atol=1e-7)


def test_coverage_pulls_the_surface_over_the_region(views):
    settings = RefineSettings(coverage_weight=2.0, ssim_weight=0)
    region = ball(radius=0.7)
    terms, gradients = terms_of(unmasked(views), settings, region=region, smoothness=PLAIN)
    targets = prepare_targets(unmasked(views), region=region)
    small, _ = terms_of(unmasked(views), settings.replaced(coverage_weight=0.0), region=region, smoothness=PLAIN)
    assert "coverage" not in small
    ring = 0.7**2 - 0.57**2  # of the two discs, to the order of perspective
    share = float(targets.inside[1].float().mean()) * ring / 0.7**2
    assert terms["coverage"] == pytest.approx(2 * share, rel=0.15)
    outward = -(gradients["coverage"] * torch.from_numpy(ball().vertices)).sum()
    assert float(outward) > 0
    covered, _ = terms_of(unmasked(views), settings, region=ball(radius=0.4), smoothness=PLAIN)
    assert covered["coverage"] == pytest.approx(0, abs=1e-4)


@pytest.mark.thorough
def test_a_ball_without_masks_keeps_its_size_only_with_a_region():
    """A grey ball before a grey wall: by colour alone it may as well vanish."""
    views = unmasked(photographs(ball(), count=6), wall=0.2)
    start = fresh_state(ball(radius=0.6), fill=0.2)
    settings = RefineSettings(iterations=60, vertex_lr=0.03, texture_lr=0.0)
    smoothness = Bilaplacian(weight=0.05)
    kept, _ = refine(start, views, settings, smoothness=smoothness, region=ball(radius=0.6))
    lost, _ = refine(start, views, settings, smoothness=smoothness)
    sizes = [np.linalg.norm(state.vertices, axis=1).mean() for state in (kept, lost)]
    assert sizes[0] > 0.585
    assert sizes[1] < sizes[0] - 0.02


def test_a_region_beside_masks_is_refused(views):
    with pytest.raises(DataError, match="views that have masks"):
        refine(fresh_state(ball()), views, RefineSettings(iterations=1), region=ball())
