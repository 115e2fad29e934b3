"""Large steps: both solvers against a dense one, and what the preconditioner does to motions and noise."""

import numpy as np
import pytest
import torch
from exmesh_nodes import regulariser
from hypothesis import given, settings
from hypothesis import strategies as st
from stage1_scenes import ball, fresh_state, photographs

from exmesh_graph.errors import NumericsError
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.optim import adam_step
from exmesh_graph.raster import edge_table
from exmesh_graph.stage1 import large_steps
from exmesh_graph.stage1.large_steps import implicit_filter
from exmesh_graph.stage1.refine import refine
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.stage1.smoothness import Bilaplacian


def dense(count, edges, strength):
    """(I + strength L)^-1 by the definition, each undirected edge once."""
    matrix = np.eye(count)
    for i, j in {tuple(sorted(edge)) for edge in edges.tolist()}:
        matrix[i, i] += strength
        matrix[j, j] += strength
        matrix[i, j] -= strength
        matrix[j, i] -= strength
    return np.linalg.inv(matrix)


@settings(max_examples=25, deadline=None)
@given(st.data())
def test_both_solvers_equal_the_dense_one(data):
    """Random graphs: isolated vertices, repeated and reversed edges, several parts."""
    count = data.draw(st.integers(1, 12))
    pairs = st.tuples(st.integers(0, count - 1), st.integers(0, count - 1)).filter(lambda p: p[0] != p[1])
    edges = torch.tensor(data.draw(st.lists(pairs, max_size=30)) if count > 1 else [], dtype=torch.long).view(-1, 2)
    strength = data.draw(st.floats(0, 200))
    x = torch.from_numpy(np.random.default_rng(count).normal(size=(count, 3)))
    expected = dense(count, edges, strength) @ x.numpy()
    assert np.allclose(implicit_filter(count, edges, strength)(x), expected, atol=1e-9)
    kept = torch.unique(edges.sort(dim=1).values, dim=0)
    found = large_steps._conjugate_gradients(count, kept, strength)(x)
    assert np.allclose(found, expected, atol=1e-4 * np.abs(x.numpy()).max())


def test_it_says_when_conjugate_gradients_do_not_arrive(monkeypatch):
    monkeypatch.setattr(large_steps, "_MOST_STEPS", 2)
    vertices, faces = icosphere(2)
    edges = torch.from_numpy(faces[:, :2].astype(np.int64))
    with pytest.raises(NumericsError, match="lower `strength`"):
        large_steps._conjugate_gradients(len(vertices), edges, 50.0)(torch.from_numpy(vertices))


def test_uniform_adam_divides_by_the_largest_moment():
    """The first step is the gradient's own direction and proportions; the largest one is `rate` long."""
    gradient = torch.tensor([[3.0, 0.0, 4.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    x, first, second = torch.zeros(3, 3), torch.zeros(3, 3), torch.zeros(3)
    adam_step(x, gradient, first, second, 1, 0.1, uniform=True)
    assert torch.allclose(x, -0.1 * gradient / 5, atol=1e-7)


def test_motions_pass_and_noise_does_not():
    """A translation passes unchanged; alternating noise falls by about 1 / (1 + 2 strength degree)."""
    vertices, faces = icosphere(3)
    edges = torch.from_numpy(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64))
    smooth = implicit_filter(len(vertices), edges, 19.0)
    together = torch.ones(len(vertices), 3)
    assert torch.allclose(smooth(together), together, atol=1e-5)
    noise = torch.from_numpy(np.random.default_rng(0).normal(size=vertices.shape)).float()
    assert smooth(noise).norm() < 0.1 * noise.norm()


@pytest.mark.thorough
def test_in_the_loop_it_recovers_a_ball_and_keeps_it_smooth():
    """From a radius 4 % too small: nearer to the truth, and smoother than plain steps without any smoothness."""
    views = photographs(ball(), count=4)
    start = fresh_state(ball(radius=0.576))
    roughness, error = {}, {}
    for name, smoothness in (("large", regulariser.LargeSteps()), ("plain", Bilaplacian(weight=0.0))):
        settings = RefineSettings(iterations=60, vertex_lr=0.1, hold_unseen=False)
        state, _ = refine(start, views, settings, smoothness=smoothness)
        radius = np.linalg.norm(state.vertices, axis=1)
        roughness[name], error[name] = radius.std(), abs(radius.mean() - 0.6)
    assert error["large"] < 0.4 * 0.024
    assert roughness["large"] < 0.5 * roughness["plain"]


def test_the_component_makes_the_filter():
    table = edge_table(torch.tensor([[0, 1, 2]]))
    prepared = regulariser.LargeSteps(strength=3.0).prepare(torch.zeros(3, 3), table, 2.0)
    assert prepared.loss is None
    assert prepared.uniform
