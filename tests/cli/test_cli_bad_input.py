"""What a stranger gets wrong: each mistake gives one message that names the place and the fix, and harms no store."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exmesh_graph.io.images import write_image

Exmesh = Callable[..., Any]  # of conftest.py
Scene = dict[str, Any]  # transforms_train.json
SIZE, ANGLE = 32, 0.9

GRAPH = """
name: tiny
params: {scene: scene}
nodes:
  views: {type: data.blender, path: "${scene}", test: holdout, holdout: 4}
  hull: {type: init.visual_hull, views: "@views.train", resolution: 16}
  depth: {type: prior.depth_files, folder: depths, views: "@views.train", units: normalised, pattern: "{name}"}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Four photographs of a ball, depth maps for the three that are not held out, and a graph over them."""
    (tmp_path / "g.yaml").write_text(GRAPH)
    (tmp_path / "scene").mkdir()
    (tmp_path / "depths").mkdir()
    frames = []
    for number in range(4):
        pose = looking_at_the_origin(number)
        write_image(tmp_path / "scene" / f"v{number}.png", picture(pose, 0.4 + 0.1 * number))
        frames.append({"file_path": f"v{number}", "transform_matrix": pose.tolist()})
        np.save(tmp_path / "depths" / f"v{number}.npy", np.full((SIZE, SIZE), 2, np.float32))
    scene = {"camera_angle_x": ANGLE, "w": SIZE, "h": SIZE, "frames": frames}
    (tmp_path / "scene" / "transforms_train.json").write_text(json.dumps(scene))
    return tmp_path


def looking_at_the_origin(number: int) -> np.ndarray:
    """Blender's camera-to-world (x right, y up, z back), three units away."""
    turn = 0.4 + number * np.pi / 2
    back = np.array([np.cos(turn), np.sin(turn), 0.5 - 0.3 * number])
    back /= np.linalg.norm(back)
    right = np.cross([0, 0, 1.0], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(back, right), back, 3 * back], axis=1)
    return pose


def picture(pose: np.ndarray, gray: float) -> np.ndarray:
    """RGBA of a unit ball."""
    pixel = (np.arange(SIZE) + 0.5) / SIZE * 2 - 1
    x, y = np.meshgrid(pixel, -pixel)
    rays = np.stack([x, y, -np.full_like(x, 1 / np.tan(ANGLE / 2))], -1) @ pose[:3, :3].T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    along = -rays @ pose[:3, 3]
    hit = 9 - along**2 < 1
    return np.where(hit[..., None], [gray, gray, gray, 1.0], 0.0).astype(np.float32)


def test_the_good_scene_runs(exmesh: Exmesh, folder: Path) -> None:
    assert "3 nodes, 0 from the store, 3 run" in exmesh("run", "g.yaml", "--workers", "0").stdout


WRITTEN = [  # (text of the graph, what stands there instead, words of the message)
    ("init.visual_hull", "init.visul_hull", ("g.yaml:6: [node-type]", "init.visual_hull", "exmesh nodes")),
    ("  hull:", "  hull", ("g.yaml:6: [yaml]", "colon")),
    ("@views.train", "@view.train", ("g.yaml:6: [unknown-node]", "hull.views", "@views.train")),
    ("@views.train", "@views.trian", ("g.yaml:6: [unknown-port]", "@views.train")),
    ("@views.train", "@views.test", ("g.yaml:6: [facet]", "split='test'", "@views.train")),
    ("@views.train", "@depth.depths", ("g.yaml:6: [wrong-type]", "DepthMaps", "@views.train")),
    ('"@views.train"', "@views.train", ("g.yaml:6: [yaml]", "links are quoted")),
    ('views: "@views', 'view: "@views', ("no input port 'view'", "the input views is not connected")),
    ("resolution: 16", "resoluton: 16", ("g.yaml:6: [unknown-parameter]", "nearest: resolution")),
    ("resolution: 16", "resolution: 3", ("g.yaml:6: [parameter]", "greater than or equal to 16", "voxels")),
    ("resolution: 16", "resolution: high", ("g.yaml:6: [parameter] hull: resolution", "found: 'high'")),
    ("resolution: 16", "resolution: .nan", ("g.yaml:6: [parameter] hull: resolution",)),
    ("resolution: 16", "wrong_masks: true", ("g.yaml:6: [parameter] hull: wrong_masks", "not true or false")),
    ('"{name}"', '"../{name}"', ("g.yaml:7: [parameter] depth: pattern",)),
    ("${scene}", "${scne}", ("g.yaml:5: [param]", "nearest: scene")),
    ("scene: scene", "scene: elsewhere", ("g.yaml:5: [source]", "does not exist", "/elsewhere", "`path`")),
    ("folder: depths", "folder: deeps", ("g.yaml:7: [source]", "deeps", "`folder`")),
]


@pytest.mark.thorough
@pytest.mark.parametrize(("old", "new", "words"), WRITTEN, ids=[new.strip() for _, new, _ in WRITTEN])
def test_a_fault_in_the_graph(exmesh: Exmesh, folder: Path, old: str, new: str, words: tuple[str, ...]) -> None:
    (folder / "g.yaml").write_text(GRAPH.replace(old, new, 1))
    shown = exmesh("run", "g.yaml", "--workers", "0", code=2).stderr
    for word in words:
        assert word in shown
    assert not (folder / "runs").exists()


def test_the_old_name_of_a_parameter_works_with_a_note(exmesh: Exmesh, folder: Path) -> None:
    (folder / "g.yaml").write_text(GRAPH.replace("resolution: 16", "resolution: 16, dissent: 1", 1))
    done = exmesh("check", "g.yaml")
    assert "'dissent' is now called 'wrong_masks'" in " ".join((done.stdout + done.stderr).split())


SETS = [
    ("resolution", ("cannot read --set", "--set node.param=value")),
    ("scne=x", ("no parameter 'scne'", "nearest: scene")),
    ("hull=3", ("no parameter 'hull'", "--set hull.PARAMETER=VALUE")),
    ("hul.resolution=20", ("no node 'hul'", "nearest: hull.resolution")),
    ("hull.resoluton=20", ("no parameter 'resoluton'", "nearest: resolution")),
    ("hull.resolution=", ("[parameter] hull: resolution",)),
    ("hull.resolution=[", ("cannot read the value of --set 'hull.resolution=['", "quote")),
    ("hull.views=@views.test", ("[facet]", "-> hull.views (command line)")),
    ("hull.views=views.train", ("input port", '"@node.port"', "@views.train")),
    ("seed=-1", ("[seed]", "whole number")),
    ("views.path=elsewhere", ("[source]", "/elsewhere")),
]


@pytest.mark.parametrize(("text", "words"), SETS, ids=[text for text, _ in SETS])
def test_a_fault_on_the_command_line(exmesh: Exmesh, folder: Path, text: str, words: tuple[str, ...]) -> None:
    shown = exmesh("check", "g.yaml", "--set", text, code=2).stderr
    assert shown.startswith("command line: ")
    for word in words:
        assert word in shown


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "no such graph file"),
        (b"", "a graph file is a mapping"),
        (b"nodes:\n\t- a: b", "not with tabs"),
        (b"\xff\xfe\x00", "cannot read the graph file"),
    ],
)
def test_an_unreadable_graph_file(exmesh: Exmesh, folder: Path, content: bytes | None, words: str) -> None:
    if content is not None:
        (folder / "bad.yaml").write_bytes(content)
    shown = exmesh("run", "bad.yaml", code=2).stderr
    assert shown.startswith("bad.yaml:")
    assert words in shown


def test_names_of_nodes_and_folders(exmesh: Exmesh, folder: Path) -> None:
    assert "expected: hull" in exmesh("run", "g.yaml", "--workers", "0", "--node", "hul", code=2).stderr
    assert "expected: views, hull, depth" in exmesh("plan", "g.yaml", "--node", "xyz", code=2).stderr
    assert "no run folder" in exmesh("report", "nowhere", code=1).stderr
    assert "there is no store here" in exmesh("verify", "--store", "nowhere", code=1).stderr
    assert "the store is not a folder" in exmesh("run", "g.yaml", "--workers", "0", "--store", "g.yaml", code=1).stderr
    assert (
        "take another folder with --runs"
        in exmesh("run", "g.yaml", "--workers", "0", "--runs", "g.yaml", code=1).stderr
    )


def cut_image(folder: Path) -> None:
    path = folder / "scene" / "v2.png"
    path.write_bytes(path.read_bytes()[:60])


def empty_mask(folder: Path) -> None:
    write_image(folder / "scene" / "v2.png", np.zeros((SIZE, SIZE, 4), np.float32))


def other_size(folder: Path) -> None:
    write_image(folder / "scene" / "v2.png", np.ones((SIZE, 2 * SIZE, 4), np.float32))


def mask_of_other_size(folder: Path) -> None:
    write_image(folder / "scene" / "v2.png", np.ones((SIZE, SIZE, 3), np.float32))
    write_image(folder / "scene" / "v2_mask.png", np.ones((2 * SIZE, SIZE, 1), np.float32))


def camera(change: Callable[[Scene], Any]) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        path = folder / "scene" / "transforms_train.json"
        scene = json.loads(path.read_text())
        change(scene)
        path.write_text(json.dumps(scene))

    return edit


def depth_map(value: float) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        depth = np.full((SIZE, SIZE), 2, np.float32)
        depth[3, 5] = value
        np.save(folder / "depths" / "v1.npy", depth)

    return edit


RUNNING = {
    "cut image": (cut_image, "views: ", ("v2.png", "cannot be decoded", "export the file again")),
    "empty mask": (empty_mask, "views: ", ("v2.png", "mask is empty", "leave this view out")),
    "other size": (other_size, "views: ", ("v2.png", "64 x 32", "32 x 32")),
    "mask of other size": (mask_of_other_size, "views: ", ("v2_mask.png", "32 x 64", "32 x 32")),
    "singular camera": (
        camera(lambda scene: scene["frames"][1]["transform_matrix"].__setitem__(0, [0, 0, 0, 0])),
        "views: ", ("v1", "singular", "export the cameras again"),
    ),
    "mirrored camera": (
        camera(lambda scene: [row.__setitem__(0, -row[0]) for row in scene["frames"][1]["transform_matrix"][:3]]),
        "views: ", ("v1", "not rigid", "mirroring"),
    ),
    "NaN in a camera": (
        camera(lambda scene: scene["frames"][1]["transform_matrix"][0].__setitem__(0, float("nan"))),
        "views: ", ("v1", "NaN"),
    ),
    "two views of one name": (
        camera(lambda scene: scene["frames"].append(scene["frames"][1])), "views: ", ("two views are called 'v1'",),
    ),
    "NaN in a depth map": (depth_map(np.nan), "depth: ", ("v1.npy", "column 5, row 3", "replace invalid pixels by 0")),
    "negative depth": (depth_map(-1), "depth: ", ("v1.npy", "column 5, row 3")),
}  # fmt: skip


@pytest.mark.thorough
@pytest.mark.parametrize(("spoil", "node", "words"), RUNNING.values(), ids=RUNNING)
def test_bad_data_found_by_a_node(
    exmesh: Exmesh, folder: Path, spoil: Callable[[Path], None], node: str, words: tuple[str, ...]
) -> None:
    spoil(folder)
    shown = exmesh("run", "g.yaml", "--workers", "0", code=1).stderr
    assert f"failed: {node}" in shown
    for word in (*words, "go on when mended: exmesh run g.yaml"):
        assert word in shown
    assert "0 moved to quarantine" in exmesh("verify").stdout
    assert list((folder / ".exmesh" / "work").iterdir()) == []
    names = [line["event"] for line in map(json.loads, (folder / "runs/latest/events.jsonl").read_text().splitlines())]
    assert names[-2:] == ["node_failed", "run_finished"]


LISTED = {
    "no image": (lambda folder: (folder / "scene" / "v2.png").unlink(), ("v2", "does not exist", "file_path")),
    "no depth maps": (lambda folder: (folder / "depths").rename(folder / "away"), ("/depths",)),
    "cut camera file": (
        lambda folder: (folder / "scene" / "transforms_train.json").write_text('{"frames": [{"fi'),
        ("transforms_train.json", "not valid JSON"),
    ),
    "no views": (camera(lambda scene: scene.update(frames=[])), ("transforms_train.json", "lists no views")),
    "a view without a file": (camera(lambda scene: scene["frames"][1].pop("file_path")), ("frame 1", "file_path")),
    "a word for a number": (camera(lambda scene: scene.update(w="wide")), ("frame 0", "wide", "numbers")),
    "a view that is none": (
        camera(lambda scene: scene["frames"].__setitem__(1, "v1")),
        ("frame 1", "transform_matrix"),
    ),
    "an impossible angle": (camera(lambda scene: scene.update(camera_angle_x=4)), ("camera_angle_x", "radians")),
}


@pytest.mark.parametrize(("spoil", "words"), LISTED.values(), ids=LISTED)
def test_bad_data_found_before_the_run(
    exmesh: Exmesh, folder: Path, spoil: Callable[[Path], None], words: tuple[str, ...]
) -> None:
    spoil(folder)
    shown = exmesh("check", "g.yaml", code=2).stderr
    assert shown.startswith("g.yaml:")
    assert "[source]" in shown
    for word in words:
        assert word in shown


@pytest.mark.thorough
def test_a_full_disk(exmesh: Exmesh, folder: Path) -> None:
    """A limit on the size of files stands for it: the store cannot take the pictures, the run folder its records."""
    done = subprocess.run(
        [sys.executable, "-c", "from exmesh_graph.cli import main; main()", "run", "g.yaml"],
        cwd=folder, capture_output=True, text=True, check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000)),
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert "failed: views: " in done.stderr
    assert "/.exmesh: the store cannot be written" in done.stderr
    assert "make room there" in done.stderr
    assert "0 objects and 0 actions read, 0 moved" in exmesh("verify").stdout
    assert list((folder / ".exmesh" / "work").iterdir()) == []
    assert "3 nodes, 0 from the store, 3 run" in exmesh("run", "g.yaml", "--workers", "0").stdout


def test_broken_records(exmesh: Exmesh, folder: Path) -> None:
    """What a crash of the machine may leave behind is told or made again, never believed."""
    exmesh("run", "g.yaml", "--workers", "0")
    for path in (folder / ".exmesh" / "actions").glob("*/*.json"):
        path.write_text(path.read_text()[:100])
    assert "3 moved to quarantine" in exmesh("verify", code=1).stdout
    assert "0 from the store, 3 run" in exmesh("run", "g.yaml", "--workers", "0").stdout
    (folder / "runs" / "latest" / "run.json").write_text('{"state": "do')
    assert "unreadable" in exmesh("status").stdout
    assert "run.json cannot be read" in exmesh("report", code=1).stderr
    assert "run.json cannot be read" in exmesh("why", "hull", code=1).stderr
