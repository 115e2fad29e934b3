"""What only ablations use: a start that knows nothing, and rounds as shares of the whole."""

from __future__ import annotations

import numpy as np
import pytest
from exmesh_nodes import init, stage1
from stage1_scenes import ball, fresh_state, photographs

from exmesh_graph.geometry.adjacency import signed_volume
from exmesh_graph.testing import FakeContext
from exmesh_graph.types.edges import is_closed


@pytest.mark.parametrize(("budget", "faces"), [(1280, 1280), (1279, 320), (20, 20), (6000, 5120)])
def test_a_sphere_of_at_most_so_many_faces(budget, faces):
    mesh = init.sphere(FakeContext(), p=init.SphereParams(faces=budget, radius=0.5)).mesh
    assert len(mesh.faces) == faces
    assert is_closed(mesh.faces)
    assert signed_volume(mesh.vertices, mesh.faces) > 0
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), 0.5, rtol=1e-6)


def test_a_share_stands_for_its_iterations():
    views = photographs(ball())
    start = fresh_state(ball(radius=0.5))
    runs = [
        stage1.refine(FakeContext(), start, views, p=stage1.RefineParams(total_iterations=40, **more)).state
        for more in ({"share": 0.13333}, {"iterations": 5})
    ]
    assert runs[0].iteration == runs[1].iteration == 5
    assert runs[0].vertices.tobytes() == runs[1].vertices.tobytes()
    assert (runs[0].vertices != start.vertices).any()


def test_a_share_of_nothing_is_refused():
    with pytest.raises(ValueError, match="share is a part of total_iterations"):
        stage1.RefineParams(share=0.3)
    assert stage1.RefineParams(share=0.3, total_iterations=100).share == 0.3
