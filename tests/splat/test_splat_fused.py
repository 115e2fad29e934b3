"""The native passes of Gaussians on a CPU, against the kernels in float64, and against themselves on other cores."""

import numpy as np
import pytest
import torch

from exmesh_graph.gpu.cores import cores
from exmesh_graph.splat.fused.draw import Camera, Drawing, Memory, numbers
from exmesh_graph.splat.gaussians import Gaussians
from exmesh_graph.splat.render import NEAR, PAIRS, Render, render
from tests.splat.splat_scenes import camera, cloud


def planes(drawing: Render) -> torch.Tensor:
    return torch.cat([drawing.colour, drawing.normal, drawing.distance[..., None], drawing.alpha[..., None]], dim=-1)


def drawn(gaussians, view, height, width, dtype, **options):
    """Planes, what is said of each Gaussian, and gradients of a random mixture of the planes."""
    leaves = gaussians.map(lambda t: t.to(dtype).requires_grad_())
    drawing = render(leaves, *view, height, width, **options)
    image = planes(drawing)
    weight = torch.randn(image.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64).to(dtype)
    gradients = torch.autograd.grad((image * weight).sum(), list(leaves.tensors().values()))
    named = dict(zip(leaves.tensors(), gradients, strict=True))
    return {"planes": image.detach(), "weight": drawing.drawn.weight, "screen": drawing.drawn.gradient, **named}


def turned(gaussians: Gaussians, angle: float) -> Gaussians:
    """Sheets whose normals make `angle` radians with the camera's axis."""
    half = torch.tensor([np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0])
    return Gaussians(**{**gaussians.tensors(), "rotations": half.double().expand(len(gaussians), 4).clone(),
                        "scales": gaussians.scales.sort(dim=1, descending=True).values})  # fmt: skip


def with_opacities(gaussians: Gaussians, *logits: float) -> Gaussians:
    cycle = torch.tensor(logits).double().repeat(len(gaussians))[: len(gaussians)]
    return Gaussians(**{**gaussians.tensors(), "opacities": cycle})


CASES = {
    "many": (cloud(600, size=0.1), camera(70, 50), 50, 70),
    "an odd picture, skew, an eye off the middle": (cloud(80), camera(61, 47, skew=2.0, shift=(9, -4)), 47, 61),
    "larger than the picture": (cloud(40, size=5.0), camera(40, 66), 66, 40),
    "smaller than a pixel": (cloud(900, size=2e-3, opacity=4.0), camera(50, 40), 40, 50),
    "edge on": (turned(cloud(60, flat=1e-3), np.pi / 2 - 0.05), camera(64, 48, turn=0.0), 48, 64),
    "without colour beyond degree 0": (cloud(50, degree=0), camera(40, 30), 30, 40),
    "degree 1": (cloud(50, degree=1), camera(40, 30), 30, 40),
    "degree 2": (cloud(50, degree=2), camera(40, 30), 30, 40),
    "opacities from 0 to 1": (with_opacities(cloud(300), -30.0, 30.0, 0.0, 6.0, -5.0), camera(40, 30), 30, 40),
    "opaque sheets behind one another": (with_opacities(cloud(900, size=0.5), 30.0), camera(72, 40), 40, 72),
    "one pixel": (cloud(30), camera(1, 1), 1, 1),
    "one Gaussian": (cloud(1, spread=0.0), camera(33, 33), 33, 33),
    "a row": (cloud(60), camera(100, 1), 1, 100),
}


@pytest.mark.parametrize("case", CASES)
def test_it_draws_and_differentiates_as_float64_does(case):
    gaussians, view, height, width = CASES[case]
    exact, fused = (drawn(gaussians, view, height, width, dtype) for dtype in (torch.float64, torch.float32))
    for name, value in exact.items():
        assert fused[name].dtype == torch.float32
        assert float((value - fused[name]).abs().mean()) <= 3e-5 * float(value.abs().mean()) + 1e-9, name


def test_degrees_below_the_stored_one():
    gaussians, view = cloud(60), camera(40, 30)
    for degree in range(3):
        exact, fused = (drawn(gaussians, view, 30, 40, d, degree=degree) for d in (torch.float64, torch.float32))
        used = (degree + 1) ** 2
        assert float((exact["sh"] - fused["sh"]).abs().mean()) < 1e-5 * float(exact["sh"].abs().mean())
        assert float(fused["sh"][:, used:].abs().sum()) == 0
        assert float((exact["means"] - fused["means"]).abs().mean()) < 1e-5 * float(exact["means"].abs().mean())


def test_one_gaussian_has_its_opacity_to_the_last_digits():
    """From the middle to where it is no longer drawn: 2^x by its series is within 3e-7."""
    one = Gaussians(torch.zeros(1, 3), torch.tensor([[0.4, 0.3, 0.01]]).log(), torch.tensor([[0.9, 0.1, 0.2, 0.3]]),
                    torch.tensor([2.0]), torch.zeros(1, 1, 3))  # fmt: skip
    view = camera(200, 150)
    fine = render(one.map(lambda t: t.double()), *view, 150, 200).alpha
    fused = render(one, *view, 150, 200).alpha.double()
    both = (fine > 0) & (fused > 0)
    assert int((fine > 0).sum()) > 5000
    assert int(((fine > 0) != (fused > 0)).sum()) < 20
    assert float((fine - fused)[both].abs().max()) < 2e-6  # also of the projection in float32


def test_any_number_of_cores_gives_the_same_bytes():
    gaussians, view = cloud(3000, size=0.1), camera(150, 100)
    runs = []
    for count in (1, 1, 2, 3):
        with cores(count):
            runs.append(drawn(gaussians, view, 100, 150, torch.float32))
    for run in runs[1:]:
        assert all(torch.equal(run[name], value) for name, value in runs[0].items())


def test_tiles_grow_where_pairs_would_be_too_many(monkeypatch):
    """Also beyond a block: values stay, and a Gaussian's slots hold the sums of all blocks of a tile."""
    gaussians, view = cloud(60, size=3.0), camera(150, 100)
    whole = drawn(gaussians, view, 100, 150, torch.float32)
    monkeypatch.setitem(render.__globals__, "PAIRS", 60)
    one_tile = drawn(gaussians, view, 100, 150, torch.float32)
    assert torch.equal(one_tile["planes"], whole["planes"])
    for name, value in whole.items():
        assert torch.allclose(one_tile[name], value, rtol=1e-4, atol=1e-4 * float(value.abs().max())), name


def test_kept_memory_changes_no_byte():
    """Pictures of other sizes and numbers in between, and none: what was drawn before does not show."""
    kept, sizes = Memory(), ((300, 50, 70), (40, 20, 33), (0, 20, 33), (500, 64, 64), (40, 0, 33), (40, 20, 33))
    for count, height, width in sizes:
        gaussians = cloud(count, dtype=torch.float32)
        view = Camera(numbers(*camera(width, max(height, 1))).float(), height, width, NEAR, 3, 32)
        ours, fresh = (Drawing(gaussians, view, PAIRS, memory) for memory in (kept, None))
        assert all(torch.equal(a, b) for a, b in zip(ours.planes, fresh.planes, strict=True))
        assert torch.equal(ours.seen.weight, fresh.seen.weight)
        assert torch.equal(ours.seen.box, fresh.seen.box)
        assert torch.equal(ours.seen.middle, fresh.seen.middle)


def test_nothing_to_draw():
    for gaussians, height, width in ((cloud(0), 18, 24), (cloud(3), 0, 24), (with_opacities(cloud(5), -30.0), 18, 24)):
        found = drawn(gaussians, camera(), height, width, torch.float32)
        assert found["planes"].shape == (height, width, 8)
        assert all(float(value.abs().sum()) == 0 for value in found.values())


def test_what_is_not_finite_is_left_out():
    gaussians = cloud(20)
    gaussians.means[0, 1] = torch.nan
    gaussians.scales[1, 2] = torch.inf
    gaussians.scales[2] = 800.0
    gaussians.rotations[3] = 0
    gaussians.rotations[4, 0] = torch.nan
    gaussians.opacities[5] = torch.nan
    gaussians.means[6] = torch.tensor([0, 0, -50.0])
    found = drawn(gaussians, camera(), 18, 24, torch.float32)
    assert (found["weight"][:7] == 0).all()
    assert float(found["weight"][7:].sum()) > 0
    for name in ("means", "scales", "rotations", "opacities", "sh"):
        assert torch.isfinite(found[name]).all()
        assert (found[name][:7] == 0).all()
