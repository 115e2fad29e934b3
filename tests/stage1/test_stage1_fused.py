"""A CPU's fused step against the same step in plain torch, and its bytes on any number of cores."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from stage1_scenes import ball, fresh_state, photographs

from exmesh_graph.gpu.cores import cores
from exmesh_graph.stage1 import refine as module
from exmesh_graph.stage1.appearance.state import directional
from exmesh_graph.stage1.image_terms import ImageTerms
from exmesh_graph.stage1.refine import refine
from exmesh_graph.stage1.render import draw, painter_of, surface_of
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.stage1.terms import Terms
from exmesh_graph.targets import prepare_targets

STEPS = RefineSettings(iterations=25, total_iterations=100)
USUAL = [
    STEPS,
    STEPS.replaced(ssim_weight=0.0),
    STEPS.replaced(uv_gradient=False, silhouette_weight=0.5),
    STEPS.replaced(gains=True),
    STEPS.replaced(silhouette="bce", silhouette_weight=0.01),
]


@pytest.fixture(scope="module")
def views():
    return photographs(ball(), size=61)


def plainly(monkeypatch, *arguments, **options):
    with monkeypatch.context() as patch:
        patch.setattr(module, "painter_of", lambda *_: None)
        return refine(*arguments, **options)


@pytest.mark.thorough
@pytest.mark.parametrize("settings", USUAL)
def test_25_steps_are_those_of_plain_torch(views, settings, monkeypatch):
    """A pixel at the very value of its photograph pushes one way or the other: what steps apart stays a small share."""
    start = fresh_state(ball(radius=0.56), fill=0.5)
    ours, history = refine(start, views, settings, seed=3)
    plain, said = plainly(monkeypatch, start, views, settings, seed=3)
    assert history["loss"] == pytest.approx(said["loss"], rel=1e-3)
    assert history["psnr"] == pytest.approx(said["psnr"], abs=0.01)
    for name in ("vertices", "texture", "gradient_ema"):
        before, a, b = (getattr(state, name).astype(float) for state in (start, ours, plain))
        moved = np.linalg.norm(b - before)
        assert moved > 0
        assert np.linalg.norm(a - b) < 0.01 * moved, name


@pytest.mark.thorough
def test_25_steps_with_a_directional_appearance_are_those_of_plain_torch(views, monkeypatch):
    start = directional(fresh_state(ball(radius=0.56), fill=0.5), order=2, shrinkage=0.1, rate=1.0)
    ours, history = refine(start, views, STEPS, seed=3)
    plain, said = plainly(monkeypatch, start, views, STEPS, seed=3)
    assert history["loss"] == pytest.approx(said["loss"], rel=1e-3)
    a, b = (state.model["values"].astype(float) for state in (ours, plain))
    assert np.abs(b).max() > 0.01
    assert np.linalg.norm(a - b) < 0.01 * np.linalg.norm(b)


@pytest.mark.thorough
def test_bytes_are_the_same_on_any_number_of_cores_and_on_repeat(views):
    start = fresh_state(ball(radius=0.56, rings=40, sectors=60, texels=96), fill=0.5)
    made = []
    for count in (1, 2, 3, 1):
        with cores(count):
            state, _ = refine(start, views, STEPS, seed=3)
        made.append([getattr(state, name) for name in ("vertices", "texture", "vertex_m", "texture_v", "gradient_ema")])
    assert all(np.array_equal(a, b) for other in made[1:] for a, b in zip(made[0], other, strict=True))


def pictures(views, view, settings):
    """Of one view: the fused terms with the gradient of their sum, and the plain ones."""
    surface = surface_of(ball(radius=0.55))
    targets = prepare_targets(views)
    drawn = draw(surface, targets.intrinsics[view], targets.world_to_camera[view], targets.height, targets.width)
    colour, alpha = (t.detach().clone().requires_grad_() for t in (drawn.colour, drawn.alpha))
    *ours, error = ImageTerms(targets, settings).of(view, colour, alpha)
    got = torch.autograd.grad(sum(ours), (colour, alpha), retain_graph=True)
    twice = torch.autograd.grad(2 * sum(ours), (colour, alpha))
    assert all(torch.equal(2 * a, b) for a, b in zip(got, twice, strict=True))
    plain = Terms(surface, targets, settings.replaced(depth_weight=0.0), module.Bilaplacian(weight=0.0))
    terms, plain_error = plain.of(view, drawn._replace(colour=colour, alpha=alpha), surface.vertices)
    return [float(t.detach()) for t in ours], error, got, terms, plain_error, colour, alpha


@pytest.mark.parametrize("size", [61, 24, 3])
@pytest.mark.parametrize("settings", [STEPS, STEPS.replaced(ssim_weight=0.0), STEPS.replaced(ssim_weight=1.0)])
def test_image_terms_and_their_gradient_are_the_plain_ones(settings, size):
    ours, error, got, terms, plain_error, colour, alpha = pictures(photographs(ball(), size=size), 2, settings)
    plain = [float(terms[name].detach()) if name in terms else 0.0 for name in ("l1", "d_ssim", "silhouette")]
    assert ours == pytest.approx(plain, rel=1e-5, abs=1e-9)
    assert error == pytest.approx(plain_error, rel=1e-5)
    want = torch.autograd.grad(sum(terms.values()), (colour, alpha))
    for a, b in zip(got, want, strict=True):
        assert torch.allclose(a, b, rtol=1e-4, atol=1e-6 * float(b.abs().max()))


def test_terms_weighed_apart_are_refused(views):
    targets = prepare_targets(views)
    colour, alpha = torch.rand(61, 61, 3).requires_grad_(), torch.rand(61, 61).requires_grad_()
    l1, d_ssim, silhouette, _ = ImageTerms(targets, STEPS).of(0, colour, alpha)
    with pytest.raises(ValueError, match="plain sum"):
        torch.autograd.grad(l1 + d_ssim + 2 * silhouette, colour)


def test_what_is_not_a_texture_on_a_cpu_is_drawn_plainly():
    surface = surface_of(ball())
    assert painter_of(surface, 8, 8) is not None
    assert painter_of(surface._replace(vertices=surface.vertices.double()), 8, 8) is None
    single = ball()
    assert painter_of(surface_of(replace(single, texture=single.texture[:1, :1])), 8, 8) is None
