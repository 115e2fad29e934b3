"""Reflections are told from paint by photographs from far away, and from a wrong surface by neighbours."""

from dataclasses import replace

import numpy as np
import pytest

from exmesh_graph.evaluate.metrics.agreement import reflected, windows_alike
from exmesh_graph.geometry.coarse_start import mirror_row
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.types import Views
from tests.evaluate.test_metrics_rephotography import painted_sphere

COUNT = 45  # 8 degrees apart


def sphere(slide: float) -> Views:
    """Waves painted on a sphere that slide over it as one walks around, as what a mirror shows does."""
    views = painted_sphere(COUNT)
    images = []
    for view in range(COUNT):
        pose, k = views.camera_to_world[view], views.intrinsics[view]
        rows, columns = np.indices((64, 64)) + 0.5
        d = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(k).T @ pose[:3, :3].T
        eye = pose[:3, 3]
        a, b, c = (d * d).sum(-1), 2 * (d @ eye), eye @ eye - 0.49
        at = eye + ((-b - np.sqrt(np.maximum(b * b - 4 * a * c, 0))) / (2 * a))[..., None] * d
        wave = np.sin(6 * (at + slide * pose[:3, 2]) + [0.0, 1, 2]).prod(-1)
        images.append(np.repeat(((0.5 + 0.4 * wave) ** 2.2 * views.alpha[view])[..., None], 3, -1))
    return replace(views, images=np.stack(images).astype(np.float32))


@pytest.mark.thorough
def test_paint_stays_and_reflections_slide() -> None:
    mesh = icosphere(4, 0.7)
    painted, mirrored = (reflected(*mesh, sphere(slide)) for slide in (0.0, 0.6))
    assert painted.compared > 0.1
    assert painted.share < 0.005
    assert mirrored.share > 0.1


def test_a_wrong_surface_is_no_mirror() -> None:
    vertices, faces = icosphere(4, 0.7)
    wrong = reflected(vertices * np.float32(0.8), faces, sphere(0.0))
    assert wrong.share < 0.04


def test_views_that_are_no_far_ones_to_any_say_nothing() -> None:
    views = painted_sphere(COUNT)
    assert reflected(*icosphere(3, 0.7), views.subset(np.array([0, 1]))) == (0, 0)


def test_windows_are_compared_without_their_brightness() -> None:
    rng = np.random.default_rng(0)
    first, known = rng.random((20, 30)), np.ones((20, 30), bool)
    known[:, 25:] = False
    for second, alike in ((0.3 + 0.5 * first, 1.0), (1 - first, -1.0)):
        likeness, counts = windows_alike(first, second, known)
        assert likeness[counts] == pytest.approx(alike, abs=1e-9)
        assert counts[10, 10]
        assert not counts[:, 25:].any()
    window = first[7:14, 4:11].ravel(), (second := rng.random((20, 30)))[7:14, 4:11].ravel()
    assert windows_alike(first, second, known)[0][10, 7] == pytest.approx(np.corrcoef(*window)[0, 1])
    assert not windows_alike(np.full((20, 30), 0.5), second, known)[1].any()


def test_mirrors_are_told_with_what_to_do() -> None:
    assert mirror_row(0.016, 0.1)["value"] == "none"
    assert mirror_row(0.08, 0.001)["value"] == "none"  # too little was compared
    likely = mirror_row(0.08, 0.1)
    assert likely["value"] == "likely"
    for cure in ("spray", "polariser", "masks"):
        assert cure in likely["reason"]
