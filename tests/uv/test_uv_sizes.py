"""The side of an atlas as fine as photographs show a surface."""

import numpy as np
import pytest
from exmesh_nodes import uv

from exmesh_graph.errors import DataError
from exmesh_graph.geometry.adjacency import face_areas, signed_areas_2d
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.testing import FakeContext
from exmesh_graph.testing import state as fresh
from exmesh_graph.types import Mesh, Views
from exmesh_graph.uv.pack import NoRoomError
from exmesh_graph.uv.settings import DiscSettings
from exmesh_graph.uv.unwrap import shown_texel, unwrap, unwrap_at


def views(focal):
    pose = np.eye(4)
    pose[2, 3] = 4
    intrinsics = np.array([[focal, 0, 4], [0, focal, 4], [0, 0, 1.0]])
    picture = np.zeros((1, 8, 8, 3), np.float32)
    return Views(("v",), picture, picture[..., 0] + 1, intrinsics[None], np.linalg.inv(pose)[None], "train")


@pytest.mark.thorough
@pytest.mark.parametrize(("focal", "expected"), [(400, 192), (1200, 576), (10, 64)])
def test_a_texel_spans_five_quarters_of_a_pixel(focal, expected):
    """A sphere of radius 0.5 and area pi at a distance of 4: side = sqrt(pi / 0.6) f / 5."""
    seen, mesh = views(focal), icosphere(4, 0.5)
    texel = shown_texel(mesh[0], seen.intrinsics, seen.world_to_camera)
    assert texel == pytest.approx(1.25 * 4 / focal, rel=1e-3)
    side = unwrap_at(*mesh, texel)[2]
    assert expected <= side <= expected + 64
    assert abs(expected - np.sqrt(np.pi / 0.6) * focal / 5) <= 33 or expected == 64


@pytest.mark.thorough
def test_many_small_charts_get_a_larger_atlas():
    """Fifty specks: the space between them takes most of an atlas, and their texels are still as small as asked for."""
    ball, rng = icosphere(1, 0.02), np.random.default_rng(0)
    centres = rng.uniform(-1, 1, (50, 3))
    vertices = np.concatenate([ball[0] + centre for centre in centres]).astype(np.float32)
    faces = np.concatenate([ball[1] + k * len(ball[0]) for k in range(50)]).astype(np.int32)
    area, texel = float(face_areas(vertices, faces).sum()), 0.004
    plain = np.sqrt(area / 0.6) / texel
    uvs, uv_faces, side = unwrap_at(vertices, faces, texel, DiscSettings(padding=4))
    covered = np.abs(signed_areas_2d(uvs, uv_faces)).sum()
    assert side > 1.3 * plain
    assert np.sqrt(area / covered) / side < 1.3 * texel
    assert side % 64 == 0


def test_the_node_asks_the_photographs_and_says_when_there_are_none():
    mesh = Mesh(*icosphere(2, 0.5))
    made = uv.unwrap(FakeContext(), mesh, views(400), p=uv.UnwrapParams(texture_size=0)).carrier
    assert made.texture.shape == (192, 192, 3)
    with pytest.raises(DataError, match="texture_size: 0 asks the photographs"):
        uv.unwrap(FakeContext(), mesh, p=uv.UnwrapParams(texture_size=0))


@pytest.mark.thorough
def test_a_new_atlas_asks_the_photographs_too_and_keeps_its_side_without():
    start = uv.unwrap(FakeContext(), Mesh(*icosphere(2, 0.5)), p=uv.UnwrapParams(texture_size=64)).carrier
    state = fresh(start)
    assert uv.regenerate(FakeContext(), state, p=uv.RegenerateParams()).state.texture.shape == (64, 64, 3)
    finer = uv.regenerate(FakeContext(), state, views(400), p=uv.RegenerateParams()).state
    assert finer.texture.shape[0] in (192, 256)
    fixed = uv.regenerate(FakeContext(), state, views(400), p=uv.RegenerateParams(texture_size=128)).state
    assert fixed.texture.shape == (128, 128, 3)


@pytest.mark.thorough
def test_charts_that_do_not_fit_get_a_larger_atlas_in_place_of_an_error(monkeypatch):
    """Two hundred specks, whose texels are asked for so coarse that even the space between them has no room."""
    ball, rng = icosphere(0, 0.02), np.random.default_rng(1)
    centres = rng.uniform(-1, 1, (200, 3))
    vertices = np.concatenate([ball[0] + centre for centre in centres]).astype(np.float32)
    faces = np.concatenate([ball[1] + k * len(ball[0]) for k in range(200)]).astype(np.int32)
    with pytest.raises(NoRoomError, match="do not fit into 64 x 64"):
        unwrap(vertices, faces, 64)
    uvs, uv_faces, side = unwrap_at(vertices, faces, 0.02)
    assert side in (128, 256)
    assert (signed_areas_2d(uvs, uv_faces) > 0).all()
    monkeypatch.setattr("exmesh_graph.uv.unwrap._LARGEST", 64)
    with pytest.raises(NoRoomError, match="do not fit into 64 x 64"):
        unwrap_at(vertices, faces, 0.02)
