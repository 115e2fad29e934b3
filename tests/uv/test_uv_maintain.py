"""The checks of an atlas find what they are for."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.meshes import grid
from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import without_unused
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.uv.maintain import check_atlas
from exmesh_graph.uv.unwrap import unwrap


def sheet():
    vertices, faces = grid(4, 4)
    return vertices, faces, (vertices[:, [2, 0]] * 0.8 + 0.1).astype(np.float32), faces.copy()


def test_compaction_renumbers_and_moves_nothing():
    vertices, faces = icosphere(1)
    uvs, uv_faces = unwrap(vertices, faces, 128)
    keep = uv_faces[:40]
    new_uvs, new_faces = without_unused(uvs, keep)
    assert len(new_uvs) == len(np.unique(keep)) < len(uvs)
    np.testing.assert_array_equal(new_uvs[new_faces], uvs[keep])
    assert new_faces.dtype == uv_faces.dtype
    # equal coordinates of different indices stay two: islands that touch are not welded
    twin = np.concatenate([uvs, uvs])
    assert len(without_unused(twin, np.concatenate([uv_faces, uv_faces + len(uvs)]))[0]) == len(twin)


def test_a_sound_atlas():
    report = check_atlas(*sheet(), 64)
    assert report.charts == 1
    assert report.welded == report.flipped == 0
    assert report.overlap == 0.0
    assert report.covered == pytest.approx(0.64, abs=0.03)
    assert report.stretch == pytest.approx(1.0, abs=1e-4)


def test_folded_faces_and_overlap_are_counted():
    vertices, faces, uvs, uv_faces = sheet()
    uvs = uvs.copy()
    uvs[12] = uvs[12] + [0.5, 0.0]  # an inner vertex far outside its ring
    report = check_atlas(vertices, faces, np.clip(uvs, 0, 1), uv_faces, 128)
    assert 1 <= report.flipped <= 6
    assert report.overlap > 0.02
    assert report.stretch > 1.3


def test_welded_islands_are_counted():
    vertices, faces, uvs, uv_faces = sheet()
    uv_faces[0, 0] = uv_faces[-1, 0]
    assert check_atlas(vertices, faces, uvs, uv_faces, 64).welded == 1


def test_unusable_atlases_are_refused():
    vertices, faces, uvs, uv_faces = sheet()
    bad = uv_faces.copy()
    bad[3, 1] = len(uvs)
    with pytest.raises(GeometryError, match="1 face corners"):
        check_atlas(vertices, faces, uvs, bad, 64)
    with pytest.raises(GeometryError, match="31 UV faces"):
        check_atlas(vertices, faces, uvs, uv_faces[:-1], 64)
    for value in (np.nan, 1.5):
        wrong = uvs.copy()
        wrong[2, 0] = value
        with pytest.raises(GeometryError, match="outside"):
            check_atlas(vertices, faces, wrong, uv_faces, 64)
