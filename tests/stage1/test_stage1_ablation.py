"""What only ablations use: a start that knows nothing, and rounds as shares of the whole."""

from __future__ import annotations

import numpy as np
import pytest
from exmesh_nodes import init, stage1
from stage1_scenes import ball, fresh_state, photographs

from exmesh_graph.geometry.adjacency import signed_volume
from exmesh_graph.stage1.length import iterations_in
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


def test_seconds_pay_for_fewer_iterations_on_larger_pictures():
    assert iterations_in(0.001, 512 * 512) == 1
    small, large = iterations_in(60, 256 * 256), iterations_in(60, 1024 * 1024)
    assert small == pytest.approx(60 / (0.013 + 4e-8 * 256 * 256), abs=1)
    assert small / large == pytest.approx((0.013 + 4e-8 * 1024**2) / (0.013 + 4e-8 * 256**2), rel=1e-2)


def test_seconds_decide_the_whole_length_of_which_a_round_takes_its_share():
    views, start = photographs(ball()), fresh_state(ball(radius=0.5))
    seconds = 40 * (0.013 + 4e-8 * views.width * views.height)
    runs = [
        stage1.refine(FakeContext(), start, views, p=stage1.RefineParams(share=0.125, **more)).state
        for more in ({"seconds": seconds}, {"seconds": seconds, "total_iterations": 999}, {"total_iterations": 40})
    ]
    assert runs[0].iteration == 5
    assert runs[0].vertices.tobytes() == runs[1].vertices.tobytes() == runs[2].vertices.tobytes()
    with pytest.raises(ValueError, match="give this round's share"):
        stage1.RefineParams(seconds=3)
