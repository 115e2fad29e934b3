"""Blender opens what is exported as it is. Needs a Python with bpy: EXMESH_BPY=path/to/python, pytest -m slow."""

import os
from pathlib import Path

import numpy as np
import pytest
from usd_example import SIZE, example_asset

from exmesh_graph.edit.cameras import orbit
from exmesh_graph.errors import DataError
from exmesh_graph.export.blender import BlenderSettings, compare_with_blender, render_in_blender
from exmesh_graph.export.usd import ExportSettings, write_usd
from exmesh_graph.types import Frame, Views

FRAME = Frame(np.array([[0, 0, 2.0, 1], [0, 2.0, 0, -2], [-2.0, 0, 0, 3], [0, 0, 0, 1.0]]), np.eye(4))
BPY = os.environ.get("EXMESH_BPY", "")
with_blender = [pytest.mark.slow, pytest.mark.skipif(not BPY, reason="EXMESH_BPY names no Python with bpy")]


def plain_asset(**changes):
    """A dielectric with soft maps under a soft sky."""
    ramp = np.linspace(0.15, 0.6, SIZE, dtype=np.float32)
    sky = np.linspace(1.2, 0.2, 16, dtype=np.float32)[:, None, None] * np.ones((16, 32, 3), np.float32)
    sky[:, :8, 0] *= 1.5
    values = {
        "base_color": np.stack(np.broadcast_arrays(ramp[:, None], ramp[None], ramp[::-1, None]), axis=-1).copy(),
        "roughness": np.full((SIZE, SIZE), 0.6, np.float32),
        "environment": sky,
    }
    return example_asset(**{**values, **changes})


def one_view():
    """Square pixels, which is all that Blender has; the principal point off the middle."""
    intrinsics, pose = orbit(1, 80, 96, start=0.4)
    intrinsics[:, 0, 2] += 6.5
    intrinsics[:, 1, 2] -= 4.25
    images, alpha = np.zeros((1, 80, 96, 3), np.float32), np.zeros((1, 80, 96), np.float32)
    return Views(("test.0",), images, alpha, intrinsics, pose, "test")


class TestWithBlender:
    pytestmark = with_blender

    @pytest.mark.parametrize(("up_axis", "file"), [("Y", "asset.usdz"), ("Z", "scene.usda")])
    def test_our_picture_and_blender_s_are_alike(self, tmp_path, up_axis, file):
        write_usd(tmp_path / "out", plain_asset(), FRAME, one_view(), settings=ExportSettings(up_axis=up_axis))
        found = compare_with_blender(tmp_path / "out" / file, BlenderSettings(Path(BPY)))
        assert found["psnr"] > 30
        assert found["iou"] > 0.98

    def test_the_variant_that_is_chosen_is_shown(self, tmp_path):
        settings = BlenderSettings(Path(BPY), samples=16)
        rough = plain_asset(roughness=np.full((SIZE, SIZE), 0.2, np.float32))
        write_usd(tmp_path / "out", rough, FRAME, one_view())
        file = tmp_path / "out" / "scene.usda"
        for shading in ("full", "base_only"):
            assert compare_with_blender(file, settings, variants={"shading": shading})["psnr"] > 27
        full, plain = (render_in_blender(file, settings, variants={"shading": s}) for s in ("full", "base_only"))
        assert np.abs(full["test.0"] - plain["test.0"]).max() > 0.02

    def test_the_light_comes_from_where_the_file_says(self):
        from benchmarks.blender import light_errors

        errors = light_errors(plain_asset(), BlenderSettings(Path(BPY), samples=16))
        assert max(errors.values()) < 1.0


def test_what_cannot_be_rendered_is_told(tmp_path):
    write_usd(tmp_path / "out", plain_asset(), FRAME, one_view())
    nowhere = BlenderSettings(tmp_path / "no_python")
    with pytest.raises(DataError, match="cannot be started"):
        render_in_blender(tmp_path / "out" / "scene.usda", nowhere)
    with pytest.raises(DataError, match="no camera 'other'"):
        render_in_blender(tmp_path / "out" / "scene.usda", nowhere, cameras=["other"])
    with pytest.raises(DataError, match="no cameras"):
        render_in_blender(tmp_path / "out" / "asset.usda", nowhere)
