"""Solvers and renderers on a device that is not the CPU: nothing is left behind, and values are the CPU's."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
import torch
from elsewhere import DEVICE, Elsewhere, elsewhere
from torch.utils._pytree import tree_map

from exmesh_graph import device_check, testing
from exmesh_graph.gpu.cores import split
from exmesh_graph.raster.runtime import kernels
from exmesh_graph.shading.transport import trace_transport, with_bounces
from exmesh_graph.splat.pgsr import pgsr
from exmesh_graph.splat.settings import PgsrSettings
from exmesh_graph.stage1 import terms
from exmesh_graph.stage1.init import initial_state
from exmesh_graph.stage1.refine import refine
from exmesh_graph.stage1.render import render_carrier
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.stage2 import palette
from exmesh_graph.stage2.alike import Alike
from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.init import neutral_asset
from exmesh_graph.stage2.light import sparse
from exmesh_graph.stage2.render import render_views
from exmesh_graph.stage2.settings import DecompositionSettings, StartSettings

Arrays = dict[str, np.ndarray]
Task = Callable[[torch.device | str], Arrays]
CLOSE = 2e-3
"""Of the mean magnitude, as in `device_check`."""


def _stage1(device: torch.device | str) -> Arrays:
    views = testing.views(count=3, size=32)
    start = initial_state(testing.carrier(), views, device=device)
    settings = RefineSettings(iterations=2, depth_weight=0.1, deviation_weight=0.1, gains=True)
    depths = testing.depth_maps(testing.mesh(), views)
    state, _ = refine(start, views, settings, depths=depths, device=device)
    return {"vertices": state.vertices, "texture": state.texture}


def _stage2(device: torch.device | str) -> Arrays:
    carrier = testing.carrier()
    light = with_bounces(trace_transport(carrier.vertices, carrier.faces, 32, 1), 1)
    settings = DecompositionSettings(
        iterations=2, environment_height=8, corrections=1, correction_samples=4, metallic=True, exposure=True
    )
    asset, _ = fit(carrier, testing.views(count=3, size=32), light, settings, device=str(device))
    return {"base colour": asset.base_color, "roughness": asset.roughness, "environment": asset.environment}


def _stage2_of_the_graphs(device: torch.device | str) -> Arrays:
    """As the shipped graphs fit: a tinted start, the light first, colours that gather, a prior; cut off on the way."""
    carrier, views = testing.carrier(), testing.views(count=3, size=32)
    light = with_bounces(trace_transport(carrier.vertices, carrier.faces, 32, 1), 1)
    settings = DecompositionSettings(
        iterations=4, environment_height=8, corrections=2, correction_samples=4, light_first=0.5, gloss_weight=8,
        palette_width=0.1,
    )  # fmt: skip
    start = neutral_asset(carrier, StartSettings(base_color="tint"))
    options: dict[str, Any] = {"device": str(device), "start": start, "prior": Alike()}
    kept: dict[int, Any] = {}

    def checkpoint(step: int, state: dict[str, Any]) -> None:
        kept[step] = tree_map(lambda v: v.cpu().clone() if isinstance(v, torch.Tensor) else deepcopy(v), state)

    with patch.object(palette, "REACH", 0.0):  # four steps
        fit(carrier, views, light, settings, checkpoint=checkpoint, **options)
        asset, _ = fit(carrier, views, light, settings, resumed=(2, kept[2]), **options)
    return {"base colour": asset.base_color, "roughness": asset.roughness, "environment": asset.environment}


def _stage2_of_large_views(device: torch.device | str) -> Arrays:
    with patch.object(sparse, "CROSSINGS", 60):
        return _stage2(device)


def _gaussians(device: torch.device | str) -> Arrays:
    settings = PgsrSettings(iterations=4, count=200, downscale=1, geometry_from=0.5)
    found = pgsr(testing.views(count=3, size=32), settings, device=device)[0]
    return {"means": found.means, "opacities": found.opacities}


def _carrier_picture(device: torch.device | str) -> Arrays:
    colour, alpha = render_carrier(testing.carrier(), testing.views(count=2, size=32), device)
    return {"colour": colour, "alpha": alpha}


def _asset_picture(device: torch.device | str) -> Arrays:
    intrinsics, poses = testing.cameras(2, 24)
    options = {"supersampling": 1, "specular_samples": 2, "bounces": 1}
    shown = render_views(testing.asset(), intrinsics, poses, 24, 24, device=str(device), **options)
    return {"image": shown.images, "alpha": shown.alpha}


TASKS: dict[str, Task] = {
    "Stage I": _stage1,
    "Stage II": _stage2,
    "Stage II of the graphs": _stage2_of_the_graphs,
    "Stage II of large views": _stage2_of_large_views,
    "Gaussians": _gaussians,
    "carrier": _carrier_picture,
    "asset": _asset_picture,
}


@pytest.mark.thorough
@pytest.mark.parametrize("name", TASKS)
def test_nothing_is_left_on_the_cpu(name: str) -> None:
    here = TASKS[name]("cpu")
    with elsewhere() as device:
        there = TASKS[name](device)
    for what, values in here.items():
        assert values.shape == there[what].shape, what
        error = float(np.abs(values - there[what]).mean())
        assert error <= CLOSE * float(np.abs(values).mean()), f"{what} is off by {error}"


@pytest.mark.thorough
def test_every_accelerated_operation_is_the_cpu_s() -> None:
    with elsewhere() as device:
        results = {name: trial(device) for name, trial in device_check.TRIALS.items()}
        found = {name: {k: v.detach().cpu() for k, v in values.items()} for name, values in results.items()}
    for name, trial in device_check.TRIALS.items():
        assert device_check.difference(trial(torch.device("cpu")), found[name]) == "", name


@pytest.fixture
def forgetful(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stage I's L1 with one tensor that was made without `device=`."""
    l1 = terms.losses.l1
    monkeypatch.setattr(terms.losses, "l1", lambda image, target: l1(image * torch.ones(image.shape[-1]), target))


@pytest.mark.usefixtures("forgetful")
def test_one_tensor_that_was_made_without_a_device_is_found() -> None:
    assert _stage1("cpu")  # nothing shows where all is the CPU
    with elsewhere() as device, pytest.raises(RuntimeError, match=r"mul.*all tensors must lie on one device"):
        _stage1(device)


def test_what_a_gpu_refuses_is_refused() -> None:
    with elsewhere() as device:
        there = torch.arange(6.0, device=device).reshape(2, 3).requires_grad_()
        assert there.device == DEVICE
        assert isinstance(there.detach()[:, [0, 2]], Elsewhere)
        assert (there * torch.tensor(2.0)).sum().item() == 30  # single numbers may come from the CPU
        with pytest.raises(RuntimeError, match="one device"):
            there + torch.ones(3)
        with pytest.raises((TypeError, RuntimeError)):
            there.detach().numpy()
        with pytest.raises(RuntimeError, match="generator"):
            torch.rand(3, generator=torch.Generator(), device=device)
        there.square().sum().backward()
        assert there.grad is not None
        assert there.grad.cpu().tolist() == [[0, 2, 4], [6, 8, 10]]


def test_a_launch_of_tensors_from_both_sides_is_refused() -> None:
    k = kernels("silhouette")
    with elsewhere() as device, pytest.raises(RuntimeError, match=r"launch of .*mark_silhouette.*one device"):
        split(k.mark_silhouette, 1, torch.zeros(1, 3, device=device), torch.zeros(1, 2, dtype=torch.int32), grain=1)
