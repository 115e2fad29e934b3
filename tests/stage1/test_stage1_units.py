"""Settings in world units say the same as settings in mean edge lengths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from exmesh_nodes import stage1
from exmesh_nodes.regulariser import Laplacian
from stage1_scenes import ball, fresh_state, photographs

from exmesh_graph.errors import DataError
from exmesh_graph.stage1.refine import refine
from exmesh_graph.stage1.regularise import mean_edge, smoother, smoothness
from exmesh_graph.stage1.render import surface_of
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.stage1.units import in_edge_lengths
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import Mesh


def _edge(state) -> float:
    surface = surface_of(state)
    return mean_edge(surface.vertices, surface.edges.edges)


def test_world_units_are_turned_into_edges_of_the_mesh():
    state = fresh_state(ball())
    length = _edge(state)
    said = RefineSettings(vertex_lr=5e-4, deviation_weight=1000.0)
    meant = in_edge_lengths(said, state)
    assert meant.vertex_lr == pytest.approx(5e-4 / length, rel=1e-4)
    assert meant.deviation_weight == pytest.approx(1000 * length**2, rel=1e-4)
    assert in_edge_lengths(said, state, step=False).vertex_lr == 5e-4
    assert in_edge_lengths(said, state, deviation=False).deviation_weight == 1000
    # the same numbers on a mesh of half the size: twice the edges a step, a quarter of the weight
    half = in_edge_lengths(said, replace(state, vertices=0.5 * state.vertices))
    assert half.vertex_lr == pytest.approx(2 * meant.vertex_lr, rel=1e-4)
    assert half.deviation_weight == pytest.approx(meant.deviation_weight / 4, rel=1e-4)


def test_a_step_is_an_edge_at_most():
    assert in_edge_lengths(RefineSettings(vertex_lr=1.0), fresh_state(ball())).vertex_lr == 1.0


def test_the_node_moves_vertices_alike_in_either_unit():
    state, views = fresh_state(ball(radius=0.57)), photographs(ball(), count=4)
    length = _edge(state)
    common = {"iterations": 3, "texture_lr": 0.0, "deviation_weight": 40.0, "vertex_lr": 0.02}
    edges = stage1.refine(FakeContext(), state, views, p=stage1.RefineParams(**common)).state
    units = {"vertex_units": "world", "deviation_units": "world"}
    world = common | units | {"deviation_weight": 40 / length**2, "vertex_lr": 0.02 * length}
    same = stage1.refine(FakeContext(), state, views, p=stage1.RefineParams(**world)).state
    assert np.abs(edges.vertices - state.vertices).max() > 1e-3
    np.testing.assert_allclose(same.vertices, edges.vertices, atol=1e-6)


def test_laplacian_in_world_units_is_the_mean_squared_difference():
    """Against the definition: 1000 / V times the sum over vertices of |mean of its neighbours - v|^2."""
    state = fresh_state(ball())
    surface = surface_of(state)
    vertices, edges = surface.vertices.detach(), surface.edges.edges
    near: dict[int, set[int]] = {}
    for a, b in edges.tolist():
        near.setdefault(a, set()).add(b)
        near.setdefault(b, set()).add(a)
    points = vertices.double().numpy()
    rows = [points[list(ring)].mean(axis=0) - points[v] for v, ring in near.items()]
    expected = 1000 * float(np.square(np.array(rows)).sum()) / len(points)
    prepared = Laplacian(weight=1000.0, units="world").prepare(vertices, surface.edges, 2.0)
    assert prepared is not None
    assert prepared.loss is not None
    assert float(prepared.loss(vertices)) == pytest.approx(expected, rel=1e-4)
    scale_free = float(smoothness(vertices, smoother(vertices, edges), "laplacian"))
    assert float(prepared.loss(vertices)) == pytest.approx(1000 * scale_free * _edge(state) ** 2, rel=1e-4)
    assert torch.isfinite(prepared.loss(2 * vertices))


def test_a_region_beside_masks_changes_nothing_and_is_told():
    """One graph serves photographs with masks and without: its wire to `region` must not stop those with masks."""
    state, views = fresh_state(ball(radius=0.57)), photographs(ball(), count=4)
    context, p = FakeContext(), stage1.RefineParams(iterations=3)
    region = Mesh(state.vertices, state.faces)
    wired = stage1.refine(context, state, views, region=region, p=p).state
    bare = stage1.refine(FakeContext(), state, views, p=p).state
    assert wired.vertices.tobytes() == bare.vertices.tobytes()
    assert any("the region that is wired in is not used" in line for line in context.lines)
    with pytest.raises(DataError, match="a region was given for views that have masks"):
        refine(state, views, RefineSettings(iterations=1), region=region)
