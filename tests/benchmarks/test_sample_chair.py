"""The small rendered scene of thin parts in the repository: it is the one that the register knows, and it is read."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.register import choosing, find
from benchmarks.scenes.digests import differences, measured, triangles
from exmesh_graph.io.blender import load_blender
from exmesh_graph.io.settings import BlenderOptions

SAMPLE = Path(__file__).parent.parent.parent / "graphs" / "samples" / "chair"


def test_it_is_the_registered_scene_to_the_byte_and_small():
    assert choosing(SAMPLE).name == "chair_sample"
    assert differences(find(SAMPLE).digests, measured(SAMPLE)) == ([], [])
    assert sum(file.stat().st_size for file in SAMPLE.rglob("*") if file.is_file()) < 4e6


def test_another_mesh_is_told(tmp_path):
    for name in ("mesh", "test"):
        (tmp_path / name).symlink_to(SAMPLE / name)
    other = measured(tmp_path).model_copy(update={"area": 1.01 * measured(SAMPLE).area})
    assert differences(find(SAMPLE).digests, other)[0]


@pytest.mark.thorough
def test_it_loads_with_masks_truth_and_four_lights():
    scene = load_blender(SAMPLE, BlenderOptions())
    assert len(scene.train) == 36
    assert scene.train.has_masks
    truth = scene.truth
    assert sorted(truth.relit) == ["coloured", "lamps", "overcast", "sun"]
    covered = scene.test.alpha > 0.99
    assert truth.albedo[covered].mean() == pytest.approx(0.25, abs=0.15)
    assert 0.05 < covered.mean() < 0.3, "thin parts cover little"
    assert np.linalg.norm(truth.mesh_vertices, axis=1).max() == pytest.approx(0.95, abs=0.02)
    assert len(truth.mesh_faces) == len(triangles(SAMPLE / "mesh" / "mesh.obj"))
    suns = [float(truth.relit[name][0].max() / truth.relit[name][0].mean()) for name in ("overcast", "sun")]
    assert suns[1] > 50 * suns[0], "the lights are unlike"
