"""The topology nodes: what they carry along, and what they tell the user."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from exmesh_nodes import topology

from exmesh_graph.errors import DataError
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import Stage1State
from exmesh_graph.uv.unwrap import unwrap


@pytest.fixture(scope="module")
def state():
    vertices, faces = icosphere(2, 0.5)
    uvs, uv_faces = unwrap(vertices, faces, 128)
    rng, n = np.random.default_rng(0), len(vertices)
    texture = np.full((128, 128, 3), 0.5, np.float32)
    return Stage1State(
        vertices, faces, uvs, uv_faces, texture,
        vertex_m=vertices.copy(), vertex_v=np.ones(n, np.float32), texture_m=0 * texture, texture_v=0 * texture,
        gradient_ema=rng.random(n).astype(np.float32), iteration=7, vertex_steps=7, texture_steps=5,
    )  # fmt: skip


def run(node, state, params, *more):
    ctx = FakeContext()
    return node(ctx, state, *more, p=params).state, ctx


@pytest.mark.parametrize("method", ["score", "area", "random", "uniform"])
def test_split_reaches_its_cap_and_carries_the_optimiser(state, method):
    new, _ = run(topology.split, state, topology.SplitParams(method=method, target_faces=500, max_faces=1280))
    assert len(new.faces) == (1280 if method == "uniform" else 500)
    assert len(new.vertex_m) == len(new.vertex_v) == len(new.gradient_ema) == len(new.vertices)
    np.testing.assert_allclose(new.vertex_m, new.vertices, atol=1e-6)  # it was the positions, and is carried like them
    assert new.texture is state.texture
    assert (new.iteration, new.vertex_steps, new.texture_steps) == (7, 7, 5)


def test_split_says_when_it_cannot_grow(state):
    _, ctx = run(topology.split, state, topology.SplitParams(method="uniform", max_faces=1000))
    assert any("max_faces" in text for text in ctx.warnings)


def test_split_stops_at_the_edges_that_photographs_show(state):
    """A sphere of area a, pixels 1 / 20 wide at its middle: a / (sqrt(3) / 4 (2 / 20)^2) faces have edges of two."""
    views = _view_from(2.0)
    corners = state.vertices[state.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    expected = area / (3**0.5 / 4 * (2 / 20) ** 2)
    assert len(state.faces) < expected < 4 * len(state.faces)
    params = topology.SplitParams(min_edge=2, growth=4)
    new, _ = run(topology.split, state, params, views)
    assert len(new.faces) == pytest.approx(expected, abs=3)
    again, ctx = run(topology.split, new, topology.SplitParams(min_edge=2.1), views)
    assert again is new
    assert any("edges of 2.1 pixels are reached" in line for line in ctx.lines)
    coarser, _ = run(topology.split, state, topology.SplitParams(min_edge=2, growth=4, max_faces=350), views)
    assert len(coarser.faces) == 350
    _, ctx = run(topology.split, state, topology.SplitParams(method="uniform", min_edge=2), views)
    assert any("min_edge = 2" in text for text in ctx.warnings)
    with pytest.raises(DataError, match=r"(?s)none are wired in.*views"):
        run(topology.split, state, params)


def _view_from(distance):
    from exmesh_graph.types import Views

    pose = np.eye(4)
    pose[2, 3] = -distance  # one camera, in front: half of the sphere is unseen
    return Views(
        ("a",), np.zeros((1, 32, 32, 3), np.float32), np.ones((1, 32, 32), np.float32),
        np.array([[[40, 0, 16], [0, 40, 16], [0, 0, 1.0]]]), pose[None], "train",
    )  # fmt: skip


def test_merge_removes_faces_that_no_view_shows(state):
    views = _view_from(2.0)
    params = topology.MergeParams(area_quantile=1.0, min_faces=20)
    new, _ = run(topology.merge, state, params, views)
    gone = len(state.faces) - len(new.faces)
    assert gone > 30
    front = (state.vertices[:, 2] < -0.3).sum()
    assert (new.vertices[:, 2] < -0.3).sum() == front
    assert len(new.vertex_m) == len(new.vertices)
    assert len(run(topology.merge, state, params, None)[0].faces) == len(state.faces)


@pytest.mark.parametrize("relax", [0, 2])
def test_flip_evens_out_and_keeps_sizes(state, relax):
    grown, _ = run(topology.split, state, topology.SplitParams(growth=2))
    new, ctx = run(topology.flip, grown, topology.FlipParams(relax=relax))
    assert new.faces.shape == grown.faces.shape
    assert (new.faces != grown.faces).any()
    assert (new.vertices != grown.vertices).any() == (relax > 0)
    assert any("flipped" in text for text in ctx.lines)


@pytest.mark.parametrize("kind", ["per_vertex", "per_face"])
def test_colours_follow_their_vertices_and_faces(state, kind):
    places = state.vertices if kind == "per_vertex" else state.vertices[state.faces].mean(axis=1)
    painted = replace(state, appearance=kind, model={"values": places.astype(np.float32)})
    new, _ = run(topology.split, painted, topology.SplitParams(target_faces=500))
    new, _ = run(topology.flip, new, topology.FlipParams())
    now = new.vertices if kind == "per_vertex" else new.vertices[new.faces].mean(axis=1)
    assert new.model["values"].shape == now.shape
    limit = 0.02 if kind == "per_vertex" else 0.1  # a split face keeps the colour of the whole
    assert np.abs(new.model["values"] - now).max() < limit
