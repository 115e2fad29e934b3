"""The side of an atlas as fine as photographs show a surface."""

import numpy as np
import pytest
from exmesh_nodes import uv

from exmesh_graph.errors import DataError
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import Mesh, Views
from exmesh_graph.uv.unwrap import shown_side


def views(focal):
    pose = np.eye(4)
    pose[2, 3] = 4
    intrinsics = np.array([[focal, 0, 4], [0, focal, 4], [0, 0, 1.0]])
    picture = np.zeros((1, 8, 8, 3), np.float32)
    return Views(("v",), picture, picture[..., 0] + 1, intrinsics[None], np.linalg.inv(pose)[None], "train")


@pytest.mark.parametrize(("focal", "expected"), [(400, 192), (1200, 576), (10, 64), (1e6, 8192)])
def test_a_texel_spans_five_quarters_of_a_pixel(focal, expected):
    """A sphere of radius 0.5 and area pi at a distance of 4: side = sqrt(pi / 0.6) f / 5."""
    seen = views(focal)
    found = shown_side(*icosphere(4, 0.5), seen.intrinsics, seen.world_to_camera)
    assert found == expected
    assert abs(found - np.sqrt(np.pi / 0.6) * focal / 5) <= 33 or found in (64, 8192)


def test_the_node_asks_the_photographs_and_says_when_there_are_none():
    mesh = Mesh(*icosphere(2, 0.5))
    made = uv.unwrap(FakeContext(), mesh, views(400), p=uv.UnwrapParams(texture_size=0)).carrier
    assert made.texture.shape == (192, 192, 3)
    with pytest.raises(DataError, match="texture_size: 0 asks the photographs"):
        uv.unwrap(FakeContext(), mesh, p=uv.UnwrapParams(texture_size=0))
