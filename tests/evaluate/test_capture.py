"""What photographs cover, and where more would help: a ball seen from a ring, from above, from one side."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from exmesh_nodes.evaluate import capture
from hypothesis import given, settings
from hypothesis import strategies as st

from exmesh_graph.evaluate.capture import ENOUGH, _angles, _sphere, capture_figures, coverage, places
from exmesh_graph.geometry.patches import patches
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.params import Params
from exmesh_graph.testing import FakeContext, look_at
from exmesh_graph.types import Mesh, Views

SIDE = 96


def ball() -> Mesh:
    vertices, faces = icosphere(4)
    return Mesh((0.5 * vertices).astype(np.float32), faces.astype(np.int32))


def views_from(angles: list[tuple[float, float]], light: float = 0.4) -> Views:
    """Views of the ball from (degrees round, degrees up) at distance 3."""
    around, up = np.radians(np.array(angles, float)).T
    eyes = 3 * np.stack([np.cos(up) * np.sin(around), np.sin(up), np.cos(up) * np.cos(around)], axis=1)
    count = len(eyes)
    camera = np.array([[150.0, 0, SIDE / 2], [0, 150, SIDE / 2], [0, 0, 1]])
    poses = np.stack([look_at(eye) for eye in eyes])
    return Views(
        names=tuple(f"v{i}" for i in range(count)),
        images=np.full((count, SIDE, SIDE, 3), light, np.float32), alpha=np.ones((count, SIDE, SIDE), np.float32),
        intrinsics=np.repeat(camera[None], count, axis=0), camera_to_world=poses, split="train", has_masks=False,
    )  # fmt: skip


def ring(up: float, count: int = 12) -> list[tuple[float, float]]:
    return [(360 * k / count, up) for k in range(count)]


@pytest.mark.thorough
def test_a_ball_seen_from_everywhere_needs_no_more():
    figures = capture_figures(views_from([*ring(-50), *ring(0), *ring(50), (0, 89), (0, -89)]), ball())
    assert figures["headline"][0]["value"] > 95
    assert [row["value"] for row in figures["advice"]] == ["none needed"]


def test_a_patch_is_seen_by_the_views_it_faces():
    """Against the angle between a patch's normal and the direction to the camera: a ball hides nothing else."""
    views, mesh = views_from([(20, 10), (200, -30)]), ball()
    found = coverage(views, mesh)
    which = patches(mesh.vertices, mesh.faces, 40)
    middle = np.stack([np.bincount(which, mesh.vertices[mesh.faces].mean(1)[:, k]) for k in range(3)], 1)
    middle /= np.bincount(which)[:, None]
    normal = middle / np.linalg.norm(middle, axis=1, keepdims=True)
    ray = views.camera_to_world[:, None, :3, 3] - middle
    cosine = np.einsum("npi,pi->np", ray / np.linalg.norm(ray, axis=-1, keepdims=True), normal)
    clear = np.abs(cosine - 0.3) > 0.15
    assert (found.seen == (cosine > 0.3))[clear].mean() > 0.97


@pytest.mark.thorough
def test_from_above_only_more_from_below_are_asked_for():
    views, mesh = views_from([*ring(30), *ring(60)]), ball()
    figures = capture_figures(views, mesh)
    first = figures["advice"][0]
    assert "below v" in first["value"] or "below and" in first["value"]
    assert "Seen from below" in first["reason"]
    assert _angles(places(views, mesh, coverage(views, mesh))[0].direction)[1] < -20


def test_from_one_side_the_other_is_asked_for_and_on_the_right_hand():
    views = views_from([(a, u) for a in (-60, -30, 0, 30) for u in (-40, 0, 40)])
    chosen = places(views, ball(), coverage(views, ball()))
    assert np.cos(np.radians(_angles(chosen[0].direction)[0] - 165)) > 0.7
    assert chosen[0].gain == max(place.gain for place in chosen)


def test_an_added_place_is_seen_once_photographed():
    views, mesh = views_from(ring(0)), ball()
    before = coverage(views, mesh)
    chosen = places(views, mesh, before)
    angles = [_angles(place.direction) for place in chosen]
    more = views_from([*ring(0), *[(a + d, u) for a, u in angles for d in (-3, 0, 3)]])
    after = coverage(more, mesh)

    def lacking(found):
        return found.area[found.seen.sum(0) < ENOUGH].sum() / found.area.sum()

    assert lacking(after) < 0.35 * lacking(before)


def test_white_pictures_are_named():
    views = views_from(ring(0))
    images = np.array(views.images)
    images[2] = 1
    figures = capture_figures(replace(views, images=images), ball())
    assert list(figures["blown_out"]) == ["v2"]
    assert "v2" in figures["advice"][-1]["reason"]


def test_the_node_logs_its_advice(tmp_path):
    out = capture(FakeContext(scratch=tmp_path), views_from(ring(0)), ball(), p=Params())
    assert out.metrics.values["advice"]


@given(st.integers(1, 30))
@settings(max_examples=10, deadline=None)
def test_patches_have_no_gaps_and_hold_faces_of_one_way(cells):
    mesh = ball()
    found = patches(mesh.vertices, mesh.faces, cells)
    assert (np.unique(found) == np.arange(found.max() + 1)).all()
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middle = corners.mean(1)
    side = np.ptp(middle, axis=0).max()
    for patch in range(found.max() + 1):
        of = normal[found == patch]
        assert len({(int(abs(n).argmax()), bool(n[abs(n).argmax()] > 0)) for n in of}) == 1
        assert np.ptp(middle[found == patch], axis=0).max() <= side / cells + 1e-6


def test_the_lattice_is_even():
    points = _sphere(200)
    assert np.allclose(np.linalg.norm(points, axis=1), 1)
    nearest = np.sort(np.linalg.norm(points[:, None] - points, axis=-1), axis=1)[:, 1]
    assert nearest.min() > 0.6 * nearest.max()
    assert np.abs(points.mean(0)).max() < 0.01


def test_one_view_is_no_error():
    assert capture_figures(views_from([(0, 0)]), ball())["headline"][0]["value"] == 0
