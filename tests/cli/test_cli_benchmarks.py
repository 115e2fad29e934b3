"""The graphs of published benchmarks check on folders of the published layout."""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from benchmarks.meshes import write_ply
from exmesh_graph.api.opening import checked_graph
from exmesh_graph.errors import GraphError
from exmesh_graph.io.images import write_image

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests" / "io"))


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """One scene of each benchmark, as small as the layouts allow."""
    from io_scenes import ANGLE, SIZE, ring, sphere_picture, write_blender

    from exmesh_graph.io.cameras import intrinsics_from_fov

    root = tmp_path_factory.mktemp("benchmarks")
    scan = root / "DTU" / "scan24"
    poses, k, cameras = ring(8), intrinsics_from_fov(ANGLE, SIZE, SIZE), {}
    for i, pose in enumerate(poses):
        for place in ("image", "mask"):
            (scan / place).mkdir(parents=True, exist_ok=True)
        rgb, alpha, _ = sphere_picture(pose)
        write_image(scan / "image" / f"{i:06d}.png", rgb)
        write_image(scan / "mask" / f"{i:03d}.png", alpha)
        cameras[f"world_mat_{i}"] = np.vstack([k @ np.linalg.inv(pose)[:3], [0, 0, 0, 1]])
        cameras[f"scale_mat_{i}"] = np.eye(4)
    np.savez(scan / "cameras_sphere.npz", **cameras)
    truth = root / "MVS Data"
    (truth / "Points" / "stl").mkdir(parents=True)
    (truth / "ObsMask").mkdir()
    write_ply(truth / "Points" / "stl" / "stl024_total.ply", np.zeros((4, 3)), np.zeros((0, 3), np.int32))
    savemat(truth / "ObsMask" / "ObsMask24_10.mat", {"ObsMask": np.ones((2, 2, 2)), "BB": np.eye(2, 3), "Res": [[1.0]]})
    savemat(truth / "ObsMask" / "Plane24.mat", {"P": np.ones((4, 1))})
    for name in ("nerf/chair", "s4r/hotdog"):
        write_blender(root / name, "train", ring(4))
        write_blender(root / name, "test", ring(2, offset=0.5))
    relit = root / "s4r" / "hotdog" / "test_rli"
    relit.mkdir()
    (root / "s4r" / "envmaps").mkdir()
    for file in (root / "s4r" / "hotdog" / "train").glob("*_rgba.png"):
        write_image(file.with_name(file.name.replace("_rgba.png", "_rgb.exr")), np.ones((SIZE, SIZE, 3)), "float")
        file.unlink()
    for light in ("envmap6", "envmap12"):
        write_image(root / "s4r" / "envmaps" / f"{light}.exr", np.ones((4, 8, 3)), "float")
        for i in range(2):
            shutil.copy(root / "s4r" / "hotdog" / "test" / f"{i:03d}_rgba.png", relit / f"{light}_{i:03d}.png")
    return root


@pytest.mark.parametrize(
    ("graph", "sets", "scores"),
    [
        ("dtu", ["data={}/DTU", "truth={}/MVS Data"], "chamfer"),
        ("nerf_synthetic", ["data={}/nerf"], "chamfer"),
        ("synthetic4relight", ["data={}/s4r"], "score"),
    ],
)
def test_the_graph_checks_on_a_folder_of_the_published_layout(folders, graph, sets, scores):
    checked = checked_graph(ROOT / "graphs" / f"{graph}.yaml", [text.format(folders) for text in sets])
    assert checked.nodes[scores].definition.type.startswith("benchmark.")


def test_a_scan_that_is_not_there_is_said(folders):
    sets = [f"data={folders}/DTU", f"truth={folders}/MVS Data", "scan=37"]
    with pytest.raises(GraphError, match="scan37"):
        checked_graph(ROOT / "graphs" / "dtu.yaml", sets)
