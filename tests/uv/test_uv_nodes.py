"""The nodes of the atlas and of topology: every state they hand on is valid and complete."""

from __future__ import annotations

import numpy as np
import pytest
from exmesh_nodes import topology, uv

from benchmarks.meshes import torus
from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import Mesh, Stage1State, Views
from exmesh_graph.uv.maintain import check_atlas


def state_of(mesh, size=128):
    vertices, faces = mesh
    carrier = uv.unwrap(FakeContext(), Mesh(vertices, faces), p=uv.UnwrapParams(texture_size=size)).carrier
    rng = np.random.default_rng(0)
    plane = rng.random((size, size, 3)).astype(np.float32)
    return Stage1State(
        vertices=vertices,
        faces=faces,
        uvs=carrier.uvs,
        uv_faces=carrier.uv_faces,
        texture=plane,
        vertex_m=rng.normal(size=vertices.shape).astype(np.float32),
        vertex_v=rng.random(len(vertices)).astype(np.float32),
        texture_m=plane - np.float32(0.5),
        texture_v=plane**2,
        gradient_ema=rng.random(len(vertices)).astype(np.float32),
        iteration=500,
        vertex_steps=400,
        texture_steps=300,
    )


def check_state(state):
    """All shapes and types as types.Stage1State promises, everything finite, the atlas sound."""
    v, r = len(state.vertices), state.texture.shape[0]
    shapes = {
        "vertices": (v, 3),
        "vertex_m": (v, 3),
        "vertex_v": (v,),
        "gradient_ema": (v,),
        "texture": (r, r, 3),
        "texture_m": (r, r, 3),
        "texture_v": (r, r, 3),
        "uvs": (len(state.uvs), 2),
    }
    for name, shape in shapes.items():
        array = getattr(state, name)
        assert array.shape == shape, name
        assert array.dtype == np.float32, name
        assert np.isfinite(array).all(), name
    assert state.faces.dtype == state.uv_faces.dtype == np.int32
    assert state.vertex_v.min() >= 0
    assert state.texture_v.min() >= 0
    report = check_atlas(state.vertices, state.faces, state.uvs, state.uv_faces, r)
    assert report.welded == report.flipped == 0
    assert (state.iteration, state.vertex_steps, state.texture_steps) == (500, 400, 300)


def ring_of_views(n=6, size=48):
    """Cameras around the Y axis looking at the origin, 2.5 units away."""
    poses = []
    for angle in 2 * np.pi * np.arange(n) / n:
        back = np.array([np.sin(angle), 0.0, np.cos(angle)])
        right, down = np.array([np.cos(angle), 0.0, -np.sin(angle)]), np.array([0.0, -1.0, 0.0])
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, down, -back], axis=1)
        pose[:3, 3] = 2.5 * back
        poses.append(pose)
    k = np.array([[40.0, 0, size / 2], [0, 40.0, size / 2], [0, 0, 1]])
    image = np.zeros((n, size, size, 3), np.float32)
    names = tuple(f"{i:03}" for i in range(n))
    return Views(names, image, image[..., 0], np.repeat(k[None], n, 0), np.array(poses), "train")


def test_unwrap_gives_a_grey_carrier():
    vertices, faces = torus(20, 10)
    got = uv.unwrap(FakeContext(), Mesh(vertices, faces), p=uv.UnwrapParams(texture_size=64)).carrier
    assert got.texture.shape == (64, 64, 3)
    assert (got.texture == 0.5).all()
    assert got.facets() == {"manifold": True, "closed": True, "uv": True, "units": "normalised"}
    assert check_atlas(got.vertices, got.faces, got.uvs, got.uv_faces, 64).flipped == 0


@pytest.mark.thorough
@pytest.mark.parametrize("method", ["score", "area", "random", "uniform"])
def test_split_reaches_its_target_and_keeps_the_state_whole(method):
    state = state_of(icosphere(2))
    params = topology.SplitParams(method=method, growth=2.0, max_faces=2000)
    got = topology.split(FakeContext(), state, p=params).state
    check_state(got)
    assert len(got.faces) == (4 * 320 if method == "uniform" else 640)
    assert got.facets() == {"manifold": True, "closed": True, "uv": True, "units": "normalised"}
    assert got.texture is state.texture
    capped = topology.split(FakeContext(), state, p=topology.SplitParams(method=method, max_faces=401)).state
    assert len(capped.faces) == (320 if method == "uniform" else 400)


def test_split_warns_when_nothing_can_be_split():
    state = state_of(icosphere(1))
    context = FakeContext()
    topology.split(context, state, p=topology.SplitParams(target_faces=200_000, max_degree=6))
    assert "no further face" in context.warnings[0]
    context = FakeContext()
    topology.split(context, state, p=topology.SplitParams(method="uniform", max_faces=100))
    assert "max_faces" in context.warnings[0]


def test_merge_drops_what_no_view_shows():
    # a small sphere hidden inside a large one
    (big, f), (small, g) = icosphere(2), icosphere(2, radius=0.3)
    vertices = np.concatenate([big, small])
    faces = np.concatenate([f, g + len(big)]).astype(np.int32)
    state = state_of((vertices, faces))
    without = topology.merge(FakeContext(), state, None, p=topology.MergeParams()).state
    assert len(without.faces) == len(faces)
    got = topology.merge(FakeContext(), state, ring_of_views(), p=topology.MergeParams(area_quantile=0.4)).state
    check_state(got)
    inner = np.linalg.norm(got.vertices[got.faces].mean(axis=1), axis=1) < 0.5
    assert inner.sum() < 0.6 * len(g)
    assert (~inner).sum() >= 0.95 * len(f)  # the poles, which the ring of cameras sees at a flat angle, lose a few
    assert got.facets() == {"manifold": True, "closed": True, "uv": True, "units": "normalised"}


@pytest.mark.thorough
def test_rounds_of_all_nodes_stay_sound():
    state, views = state_of(torus(24, 12)), ring_of_views()
    rng = np.random.default_rng(1)
    for turn in range(4):
        context = FakeContext(seed=turn)
        state = topology.split(context, state, p=topology.SplitParams(max_faces=1500)).state
        state = topology.merge(context, state, views, p=topology.MergeParams()).state
        if turn % 2:
            state = uv.regenerate(context, state, p=uv.RegenerateParams()).state
        else:
            state = uv.maintain(context, state, p=uv.MaintainParams()).state
        check_state(state)
        assert len(state.faces) <= 1500
        noise = rng.normal(size=state.vertices.shape) * 2e-3
        object.__setattr__(state, "vertices", state.vertices + noise.astype(np.float32))
    assert state.facets() == {"manifold": True, "closed": True, "uv": True, "units": "normalised"}


def test_maintain_warns_of_folds_and_refuses_welds():
    state = state_of(icosphere(2))
    object.__setattr__(state, "uvs", state.uvs.copy())
    inner = np.bincount(state.uv_faces.reshape(-1)).argmax()
    state.uvs[inner] = 1.0 - state.uvs[inner]
    context = FakeContext()
    uv.maintain(context, state, p=uv.MaintainParams(max_flipped=0.001))
    assert any("folded over" in w for w in context.warnings)
    welded = state.uv_faces.copy()
    welded[0, 0] = welded[-1, 0]
    object.__setattr__(state, "uv_faces", welded)
    with pytest.raises(GeometryError, match="different vertices"):
        uv.maintain(context, state, p=uv.MaintainParams())


@pytest.mark.thorough
def test_maintain_keeps_texels_that_lookups_read():
    from exmesh_graph.uv.raster import rasterize_atlas

    state = state_of(icosphere(2))
    got = uv.maintain(FakeContext(), state, p=uv.MaintainParams(dilation=8)).state
    read = rasterize_atlas(state.uvs, state.uv_faces, 128, margin=1.4)[0] >= 0
    np.testing.assert_array_equal(got.texture[read], state.texture[read])
    assert (got.texture != state.texture).any()
    same = uv.maintain(FakeContext(), state, p=uv.MaintainParams(dilation=0)).state
    assert same.texture is state.texture
