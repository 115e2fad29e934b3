"""The sample in the published layouts: loaders agree on it, and each graph runs from folder to the paper's table."""

import numpy as np
import pytest

from benchmarks.layouts import LIGHTS, RUNS, SAMPLE, run, write_layouts
from exmesh_graph.evaluate.protocols.dtu import dtu_chamfer, read_truth
from exmesh_graph.evaluate.protocols.published import TABLES
from exmesh_graph.io.blender import load_blender
from exmesh_graph.io.envmaps import canonical_from_blender, read_environment
from exmesh_graph.io.idr import load_idr
from exmesh_graph.io.meshes import read_mesh
from exmesh_graph.io.normalise import frame_scale, points_to_normalised
from exmesh_graph.io.settings import OrbOptions
from exmesh_graph.io.stanford_orb import load_orb
from exmesh_graph.io.synthetic4relight import load_synthetic4relight


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = tmp_path_factory.mktemp("layouts")
    write_layouts(root, factor=8, views=8, tests=3)
    return root


@pytest.mark.thorough
def test_all_layouts_hold_the_same_scene(folder):
    nerf = load_blender(folder / "nerf_synthetic" / "chair")
    relight = load_synthetic4relight(folder / "Synthetic4Relight" / "hotdog")
    orb, novel = load_orb(folder / "stanford_orb" / "blender_HDR" / "teapot_scene001", OrbOptions(downscale=1))
    for scene in (relight, orb):  # other masks normalise a little differently
        assert frame_scale(scene.frame) == pytest.approx(frame_scale(nerf.frame), rel=0.02)
        np.testing.assert_allclose(scene.test.alpha, nerf.test.alpha, atol=0.01)
        inside = nerf.test.alpha == 1  # a photograph's rim holds some of what is behind it
        np.testing.assert_allclose(scene.test.images[inside], nerf.test.images[inside], atol=0.01)
        np.testing.assert_allclose(scene.test.camera_to_world[:, :3, 3], nerf.test.camera_to_world[:, :3, 3], atol=0.1)
    inside = relight.test.alpha[1] == 1
    np.testing.assert_allclose(orb.truth.albedo[1][inside], relight.truth.albedo[1][inside], atol=0.03)
    # seen by the camera, the true surface lies at the depth map's depth
    k, pose = orb.test.intrinsics[0], np.linalg.inv(orb.test.camera_to_world[0])
    camera = orb.truth.mesh_vertices @ pose[:3, :3].T + pose[:3, 3]
    x, y = (camera @ k.T)[:, :2].T / camera[:, 2]
    depth = orb.truth.depth[0][y.astype(int), x.astype(int)]
    behind = (camera[:, 2] - depth)[depth > 0]  # hidden vertices lie further away; a pixel's depth varies within it
    assert -0.05 < np.quantile(behind, 0.05) < np.quantile(behind, 0.3) < 0.05
    np.testing.assert_allclose(np.linalg.norm(orb.truth.normal[0][orb.truth.depth[0] > 0], axis=1), 1, atol=1e-5)
    assert (orb.truth.normal[0][orb.truth.depth[0] > 0][:, 2] < 0.2).mean() > 0.99  # towards the camera
    # every view's panorama is the same light once it is turned into the world
    for index, light in enumerate(LIGHTS):
        sky = canonical_from_blender(read_environment(SAMPLE / "envmaps" / f"{light}.exr"))
        height = novel.environments.shape[1]
        small = sky.reshape(height, sky.shape[0] // height, 2 * height, -1, 3).mean((1, 3))
        for environment in novel.environments[3 * index : 3 * index + 3]:
            upper = slice(height // 8, height // 2)  # bright parts, away from the pole
            correlation = np.corrcoef(np.log(environment[upper].ravel() + 0.01), np.log(small[upper].ravel() + 0.01))
            assert correlation[0, 1] > 0.85


def test_dtu_is_in_millimetres_and_the_true_surface_scores_nothing(folder):
    scan = load_idr(folder / "DTU" / "scan24")
    assert frame_scale(scan.frame) == pytest.approx(130 / 0.95)  # the object fills 0.95 of the unit sphere
    truth = read_truth(folder / "MVS Data", 24)
    vertices, faces = read_mesh(SAMPLE / "mesh" / "mesh.obj")
    found = dtu_chamfer(100 * vertices, faces, truth, spacing=2.0)
    assert found.chamfer < 1.5  # the scan's points are about 1.4 mm apart
    inside = points_to_normalised(100 * vertices, scan.frame)
    assert 0.85 < np.linalg.norm(inside, axis=1).max() < 1


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_the_graph_runs_from_the_folder_to_the_papers_table(folder, name, capsys):
    (row,) = run(name, folder, [])
    assert row["table"] == name
    figures = {key: value for key, value in row["row"].items() if value is not None}
    assert all(np.isfinite(value) for value in figures.values())
    assert len(figures) >= 2
    printed = capsys.readouterr().out
    assert printed.count("published, other machine") == len(TABLES[name].rows())
    assert "measured here" in printed
