"""Pictures of a round, and the points it adds to the report's charts."""

from __future__ import annotations

import json

import numpy as np
import pytest

from exmesh_graph.evaluate.carrier import score_stage
from exmesh_graph.gallery.rounds import atlas_panels, round_gallery
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.report.contents import ReportFigure
from exmesh_graph.report.page import error_charts
from exmesh_graph.types import Carrier, SceneTruth
from exmesh_graph.uv.unwrap import unwrap


def carrier_of(vertices, faces, uvs, uv_faces, size=64):
    return Carrier(vertices, faces, uvs, uv_faces, np.full((size, size, 3), 0.4, np.float32))


def sheet(width, height):
    """Two triangles over [0, width] x [0, height], the whole atlas."""
    uvs = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    vertices = np.concatenate([uvs * np.float32([width, height]), np.zeros((4, 1), np.float32)], axis=1)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return carrier_of(vertices, faces, uvs, faces)


@pytest.mark.thorough
def test_a_gallery_shows_the_shape_and_the_atlas(tmp_path):
    vertices, faces = icosphere(2, 0.5)
    gallery = round_gallery(tmp_path, carrier_of(vertices, faces, *unwrap(vertices, faces, 64)))
    captions = json.loads((gallery.root / "captions.json").read_text())
    assert [c["title"] for c in captions] == ["Shape", "Atlas"]
    assert "320 faces" in captions[0]["caption"]
    for caption in captions:
        assert 5_000 < (tmp_path / caption["file"]).stat().st_size < 600_000
    from exmesh_graph.io.images import read_image

    picture = read_image(tmp_path / "shape.png")[..., :3]
    turns = np.split(picture[:170, : 6 * 176 - 6], np.arange(1, 6) * 176, axis=1)
    covered = [np.mean(turn.min(axis=2) < 0.9) for turn in turns]
    assert min(covered) > 0.3  # a ball is as large from every side
    assert max(covered) < 1.2 * min(covered)


def test_even_texels_are_white_and_stretched_ones_red():
    (size, aspect, texture), words = atlas_panels(sheet(1.0, 1.0), 32)
    inside = size[2:-2, 2:-2]
    assert np.ptp(inside) < 1e-6
    assert inside.min() > 0.9
    np.testing.assert_allclose(aspect[2:-2, 2:-2], inside)
    np.testing.assert_allclose(texture, 0.4, atol=1e-6)
    assert "1 charts cover 100%" in words
    (_, aspect, _), words = atlas_panels(sheet(3.0, 1.0), 32)
    assert aspect[16, 16, 0] > aspect[16, 16, 1] + 0.4
    assert "95 % below 3.00" in words


def test_texel_sizes_are_told_apart_by_colour():
    mesh = sheet(1.0, 1.0)
    uvs = np.array([[0, 0], [0.5, 0], [0.5, 1], [0.52, 0], [1, 1], [0.52, 0.1]], np.float32)
    uv_faces = np.array([[0, 1, 2], [3, 4, 5]], np.int32)  # the second face has a sixth of the first one's texels
    (size, _, _), _ = atlas_panels(Carrier(mesh.vertices, mesh.faces, uvs, uv_faces, mesh.texture), 64)
    assert size[40, 20, 2] > size[40, 20, 0] - 0.02  # finer than the median: blue or white
    face = uvs[uv_faces[1]].mean(axis=0)
    red, _, blue = size[int((1 - face[1]) * 64), int(face[0] * 64)]
    assert red > blue + 0.2


def test_faces_without_area_break_nothing(tmp_path):
    vertices, faces = icosphere(1)
    vertices = vertices * np.float32(0.0)
    uvs = np.zeros((len(vertices), 2), np.float32)
    round_gallery(tmp_path, carrier_of(vertices, faces, uvs, faces))


def test_a_stage_is_a_point_of_the_charts_and_no_headline():
    vertices, faces = icosphere(2)
    truth = SceneTruth((), mesh_vertices=vertices, mesh_faces=faces)
    values = score_stage(carrier_of(vertices * np.float32(1.01), faces, *unwrap(vertices, faces, 64)), None, truth)
    assert "headline" not in values
    (stage,) = values["stages"]
    assert stage["series"] == "Chamfer"
    assert stage["over"] == {"vertices": len(vertices)}
    assert stage["value"] == pytest.approx(10, rel=0.05)


def test_each_quantity_gets_a_chart_of_its_own():
    figures = [
        ReportFigure("Chamfer", y, "mm", series="Chamfer", after_seconds=x, over={"vertices": v})
        for x, y, v in ((30.0, 2.0, 500), (10.0, 3.0, 100), (90.0, 1.0, 2000))
    ]
    charts = error_charts(figures)
    assert len(charts) == 2
    assert "seconds spent" in charts[0]
    assert "vertices" in charts[1]
    assert "at 2\u202f000 vertices" in charts[1]
    assert len(error_charts(figures[:1])) == 0
