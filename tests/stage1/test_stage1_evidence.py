"""Where photographs are silent vertices take shorter steps: a ball without masks, half of it blown out."""

import functools
from dataclasses import replace

import numpy as np
import pytest
import torch
from stage1_scenes import ball, fresh_state, photographs, texture

from exmesh_graph.optim import adam_step
from exmesh_graph.stage1.refine import refine
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.stage1.smoothness import Bilaplacian
from exmesh_graph.types import Carrier, Mesh, Views

SETTINGS = RefineSettings(iterations=40, total_iterations=40)


@functools.cache
def half_white() -> Carrier:
    painted = texture(32)
    painted[:16] = 1.0
    return replace(ball(), texture=painted.astype(np.float32))


def white() -> np.ndarray:
    """Which vertices are in the white half, away from its rim: bool [V]."""
    carrier = half_white()
    place = np.zeros(len(carrier.vertices))
    place[carrier.faces.reshape(-1)] = carrier.uvs[carrier.uv_faces.reshape(-1), 1]  # rows from the top: v = 1
    return place > 0.6


@functools.cache
def bare() -> Views:
    seen = photographs(half_white())
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 0.004, seen.images.shape).astype(np.float32)
    return replace(seen, images=(seen.images + noise).clip(0, 1), alpha=np.ones_like(seen.alpha), has_masks=False)


def moved(views: Views, evidence: float) -> np.ndarray:
    start = fresh_state(half_white())
    region = None if views.has_masks else Mesh(start.vertices, start.faces)
    settings = SETTINGS.replaced(evidence=evidence)
    state, _ = refine(start, views, settings, smoothness=Bilaplacian(weight=0), region=region, seed=3)
    return np.linalg.norm(state.vertices - start.vertices, axis=1)


@pytest.mark.thorough
def test_without_masks_the_silent_half_moves_less():
    full, held = moved(bare(), 0.0), moved(bare(), 1.0)
    assert held[white()].mean() < 0.75 * full[white()].mean()
    assert moved(bare(), 3.0)[white()].mean() < held[white()].mean()


@pytest.mark.thorough
def test_with_masks_nothing_changes():
    seen = photographs(half_white())
    np.testing.assert_array_equal(moved(seen, 1.0), moved(seen, 0.0))


def test_a_step_of_a_gradient_far_below_the_threshold_is_in_proportion():
    values, first, second = torch.zeros(2, 3), torch.zeros(2, 3), torch.zeros(2)
    gradient = torch.tensor([[1e-3, 0, 0], [1.0, 0, 0]])
    adam_step(values, gradient, first, second, 1, 0.1, epsilon=1.0)
    assert abs(float(values[0, 0] / values[1, 0]) - 2e-3) < 1e-4
