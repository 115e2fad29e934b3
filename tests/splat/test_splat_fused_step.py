"""Iterations by native passes against iterations in plain operations."""

from pathlib import Path

import pytest
import torch

from exmesh_graph.gpu.cores import cores
from exmesh_graph.io.blender import load_blender
from exmesh_graph.io.settings import BlenderOptions
from exmesh_graph.splat.density import Density
from exmesh_graph.splat.fused.step import FusedStep
from exmesh_graph.splat.optimiser import GaussianAdam
from exmesh_graph.splat.pgsr import pgsr, started
from exmesh_graph.splat.pictures import Pictures
from exmesh_graph.splat.plain import PlainStep
from exmesh_graph.splat.settings import PgsrSettings
from exmesh_graph.targets import prepare_targets

SAMPLE = Path(__file__).parents[2] / "graphs" / "samples" / "spot"
RATES = {"means": 1e-3, "scales": 5e-3, "rotations": 2e-3, "opacities": 5e-2, "sh": 5e-3, "sh_rest": 5e-4}


@pytest.fixture(scope="module")
def views():
    return load_blender(SAMPLE, BlenderOptions(downscale=4, max_views=12)).train


def begun(views, settings, way):
    """A fit's parts: solid Gaussians, so that depths exist."""
    targets = prepare_targets(views)
    gaussians = started(views, targets, settings, None, 0, lambda message: None, "test")
    gaussians.opacities[:] = 1.0
    adam = GaussianAdam(gaussians)
    pictures = Pictures(targets, settings, 0)
    return way(pictures, adam), adam, Density(len(gaussians), gaussians.means)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "changes",
    [{}, {"gains": True}, {"ssim_weight": 0.0}, {"geometric_weight": 0.0, "photometric_weight": 0.0}, {"degree": 0}],
)
@pytest.mark.parametrize("k", [3, 70])
def test_losses_gradients_and_what_is_kept_of_a_gaussian(views, changes, k):
    settings = PgsrSettings(iterations=100, count=1500, samples=500, **changes)
    found = []
    for way in (PlainStep, FusedStep):
        step, adam, density = begun(views, settings, way)
        values = step.loss(2, k)
        step.update(density, RATES)
        found.append((values, adam, density))
    (plain, plain_adam, plain_density), (fused, fused_adam, fused_density) = found
    assert fused == pytest.approx(plain, rel=1e-4)
    for part in ("m", "v"):  # after one step: the gradient, and its square
        for name, value in getattr(plain_adam, part).tensors().items():
            other = getattr(fused_adam, part).tensors()[name]
            assert float((value - other).abs().mean()) < 5e-3 * float(value.abs().mean()), (part, name)
    for name, value in plain_adam.gaussians.tensors().items():  # steps of a gradient of next to nothing have any sign
        gradient = plain_adam.m.tensors()[name].abs()
        clear = gradient > 0.01 * gradient.mean()
        apart = (value - fused_adam.gaussians.tensors()[name]).abs()
        assert int(clear.sum()) > 300
        assert float(apart[clear].mean()) < 0.01 * RATES[name], name
    assert torch.equal(plain_adam.steps, fused_adam.steps)
    for name, value in plain_density.state().items():
        assert torch.allclose(value, fused_density.state()[name], rtol=1e-2, atol=1e-3 * float(value.max())), name


def test_what_is_not_seen_stands_still(views):
    step, adam, density = begun(views, PgsrSettings(iterations=100, count=1500, samples=500), FusedStep)
    before = adam.gaussians.map(torch.clone)
    step.loss(2, 70)
    step.update(density, RATES)
    unseen = density.views == 0
    assert 0 < int(unseen.sum()) < len(unseen)
    for name, value in adam.gaussians.tensors().items():
        assert torch.equal(value[unseen], before.tensors()[name][unseen])
        assert not torch.equal(value[~unseen], before.tensors()[name][~unseen])
        assert float(adam.m.tensors()[name][unseen].abs().sum()) == 0
    assert float(adam.steps[unseen].sum()) == 0


def test_any_number_of_cores_fits_the_same_bytes(views):
    settings = PgsrSettings(iterations=12, count=1000, max_gaussians=2000, densify_rounds=2, samples=500)
    fits = []
    for count in (1, 2, 3):
        with cores(count):
            fits.append(pgsr(views, settings)[0])
    for other in fits[1:]:
        for name in ("means", "scales", "rotations", "opacities", "sh"):
            assert (getattr(other, name) == getattr(fits[0], name)).all()
