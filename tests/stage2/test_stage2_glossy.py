"""Steps that begin glossy: roughness begins again after them, and the light that was found stays."""

import dataclasses
import itertools

import numpy as np
import pytest
import torch

from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.init import neutral_asset
from exmesh_graph.stage2.maps import PAST_ONE
from exmesh_graph.stage2.probe.short import traced
from exmesh_graph.stage2.schedule import glossy_first
from exmesh_graph.stage2.settings import DecompositionSettings, StartSettings
from tests.stage2.probe_scenes import asset, ball, carrier_of, glazed_ball, photographed

QUICK = DecompositionSettings(
    environment_height=32, texture_size=48, iterations=240, material_rate=0.2, environment_rate=0.4, ssim_weight=0,
    material_weight=0.01, environment_weight=0.002, indirect_ramp=10, corrections=1, correction_samples=8,
)  # fmt: skip


def test_glossy_steps_begin_smooth_then_roughness_begins_again_and_the_light_waits(carrier, train_views, transport):
    start = neutral_asset(carrier, StartSettings(base_color="gray"))
    kept = {}

    def keep(step, state):
        kept[step] = [parameter.detach().clone() for parameter in state["optimiser"]["parameters"]]

    settings = QUICK.replaced(
        iterations=20, environment_height=8, glossy_first=0.25, corrections=0, material_rate=1e-9, metallic=True
    )
    fit(carrier, train_views, transport, settings, start=start, checkpoint=keep)
    maps, sky, _ = zip(*(kept[step] for step in range(1, 11)), strict=True)
    span = (1 - settings.roughness_min) * (1 + PAST_ONE)
    for step, roughness in enumerate([0.2] * 5 + [0.5] * 5):
        found = settings.roughness_min + span * torch.sigmoid(maps[step][:, 3])
        assert torch.allclose(found, torch.tensor(roughness), atol=1e-5)
    still = [torch.equal(before, after) for before, after in itertools.pairwise(sky)]
    assert still == [False] * 4 + [True] * 2 + [False] * 3
    assert glossy_first(settings) == 5
    assert glossy_first(settings.replaced(keep_light=True)) == 0
    assert glossy_first(settings.replaced(metallic=False)) == 0
    smooth = neutral_asset(carrier, StartSettings(base_color="gray", roughness=0.1))
    fit(carrier, train_views, transport, settings, start=smooth, checkpoint=keep)
    assert torch.allclose(kept[1][0][:, 3], kept[10][0][:, 3])  # what is smoother stays


@pytest.mark.thorough
def test_glossy_steps_find_the_light_that_smooth_metal_mirrors():
    """Windows in a dark room on a ball of metal: from roughness 0.5 their light stays a blur."""
    sky = glazed_ball().environment
    steel = dataclasses.replace(asset(ball(), roughness=0.12, metallic=1.0), environment=sky)
    found = []
    for share in (0.0, 0.25):
        settings = QUICK.replaced(glossy_first=share, metallic=True)
        start = neutral_asset(carrier_of(steel), StartSettings(base_color="gray"))
        made, _ = fit(carrier_of(steel), photographed(steel), traced(carrier_of(steel)), settings, start=start)
        wrong = ((made.roughness - 0.12) ** 2)[made.seen].mean()
        found.append((wrong, np.corrcoef(made.environment.ravel(), sky.ravel())[0, 1]))
    (blurred, far), (sharp, near) = found
    assert sharp < 0.75 * blurred
    assert near > far
