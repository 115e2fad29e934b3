"""Sets too large for memory: loaded into files, with the bits that a set in memory has, and used one view at a time."""

from __future__ import annotations

import numpy as np
import pytest
from exmesh_nodes import data
from io_scenes import ring, write_blender

from exmesh_graph import testing
from exmesh_graph.geometry import hull
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.declare.packs import load_packs
from exmesh_graph.graph.language.check import check_file
from exmesh_graph.graph.run.backends import Inline
from exmesh_graph.graph.run.rundir import RunFolder
from exmesh_graph.graph.run.runner import Runner
from exmesh_graph.io.blender import load_blender
from exmesh_graph.io.idr import load_idr
from exmesh_graph.io.middlebury import load_middlebury
from exmesh_graph.io.settings import BlenderOptions, IdrOptions, MiddleburyOptions
from exmesh_graph.stage1.init import initial_state
from exmesh_graph.stage1.refine import refine
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.stage2.probe.short import sample_views
from exmesh_graph.targets import prepare_targets
from exmesh_graph.types import Views, pictures

GRAPH = """
nodes:
  views: {{type: data.blender, path: {scene}, truth: false, hdr: false}}
  hull: {{type: init.visual_hull, views: "@views.train", resolution: 32}}
outputs: {{mesh: "@hull.mesh"}}
"""


@pytest.fixture
def in_files(monkeypatch):
    return lambda: monkeypatch.setattr(pictures, "LARGE", 0)


def _same(scene, other):
    for part in ("train", "test"):
        first, second = getattr(scene, part), getattr(other, part)
        assert second.in_files
        assert not first.in_files
        for name in ("images", "alpha", "camera_to_world", "intrinsics", "masked"):
            assert np.asarray(getattr(first, name)).tobytes() == np.asarray(getattr(second, name)).tobytes(), name
        assert (first.has_masks, first.clipped, first.names) == (second.has_masks, second.clipped, second.names)
    assert scene.notes == other.notes


def _kinds(views):
    return {views.images.codes(k).dtype.str for k in range(len(views))}


def test_pictures_with_alpha_are_kept_as_their_codes(blender_scene, in_files):
    options = BlenderOptions(hdr=False, truth=False)
    usual = load_blender(blender_scene, options)
    in_files()
    large = load_blender(blender_scene, options)
    _same(usual, large)
    assert _kinds(large.train) == {"|u1"}
    assert large.train.images.codes(0).shape[2] == 4


def test_pictures_with_masks_beside_them_are_kept_as_codes(middlebury_scene, in_files):
    usual = load_middlebury(middlebury_scene, MiddleburyOptions(downscale=1))
    in_files()
    large = load_middlebury(middlebury_scene, MiddleburyOptions(downscale=1))
    _same(usual, large)
    assert _kinds(large.train) == {"|u1"}


def test_pictures_without_masks_are_kept_as_codes(idr_scene, in_files):
    usual = load_idr(idr_scene, IdrOptions(holdout=5))
    in_files()
    large = load_idr(idr_scene, IdrOptions(holdout=5))
    _same(usual, large)
    assert _kinds(large.train) == {"|u1"}
    assert large.train.images.codes(0).shape[2] == 3
    assert large.train.alpha.codes(0).shape == (1, 1)


@pytest.mark.parametrize("downscale", [1, 2])
def test_what_no_code_can_say_is_kept_as_floats(tmp_path, in_files, downscale):
    """Linear pictures, and means of several pixels."""
    for split, count, turn in (("train", 6, 0.0), ("test", 2, 0.2)):
        write_blender(tmp_path, split, ring(count, offset=turn), ending="_rgba.exr" if downscale == 1 else "_rgba.png")
    options = BlenderOptions(hdr=downscale == 1, truth=False, downscale=downscale)
    usual = load_blender(tmp_path, options)
    in_files()
    large = load_blender(tmp_path, options)
    _same(usual, large)
    assert _kinds(large.train) == {"<f4"}


def test_a_node_puts_the_files_into_its_scratch_folder(blender_scene, tmp_path_factory, in_files):
    in_files()
    context = testing.FakeContext(scratch=tmp_path_factory.mktemp("scratch"))
    out = data.blender(context, p=data.BlenderParams(path=blender_scene, truth=False))
    assert all(file.is_relative_to(context.scratch) for file in (*out.train.images.files, *out.test.alpha.files))


@pytest.mark.thorough
def test_the_solvers_see_the_same_whatever_fits_into_memory(blender_scene, in_files):
    """In arrays, in files and held, in files and made anew at each visit: the same bytes."""
    options = BlenderOptions(hdr=False, truth=False)
    arrays = load_blender(blender_scene, options).train
    in_files()
    files = load_blender(blender_scene, options).train
    room = 16 * 2.5 * arrays.height * arrays.width / 2**30  # of two views
    results = []
    for views, memory in ((arrays, 4.0), (files, 4.0), (files, room), (files, 0.0), (arrays, 0.0)):
        state = initial_state(testing.carrier(), views)
        state, _ = refine(state, views, RefineSettings(iterations=20, memory_gib=memory), seed=1)
        results.append(state.vertices.tobytes() + state.texture.tobytes())
    assert len(set(results)) == 1
    for downscale in (1, 2):
        held, visited = (prepare_targets(files, downscale=downscale, memory_gib=gib) for gib in (4.0, room))
        assert [image.numpy().tobytes() for image in held.images] == [i.numpy().tobytes() for i in visited.images]
        assert [alpha.numpy().tobytes() for alpha in held.alpha] == [a.numpy().tobytes() for a in visited.alpha]


def test_no_more_than_the_room_is_held(blender_scene):
    views = load_blender(blender_scene, BlenderOptions(hdr=False, truth=False)).train
    targets = prepare_targets(views, memory_gib=16 * 3 * views.height * views.width / 2**30)
    for view in (5, 1, 1, 4, 0, 2, 5):
        targets.images[view], targets.alpha[view]
    assert set(targets.images.visited.held) == {5, 1, 4}
    assert len(targets.images.visited.recent) <= 2


def test_the_probe_reduces_pictures_one_by_one(blender_scene, in_files):
    options = BlenderOptions(hdr=False, truth=False)
    usual = sample_views(load_blender(blender_scene, options).train, view_pixels=100)
    in_files()
    large = sample_views(load_blender(blender_scene, options).train, view_pixels=100)
    assert usual.factor == large.factor > 1
    assert usual.views.images.tobytes() == large.views.images.tobytes()


def test_the_hull_of_a_large_set_is_that_of_reduced_masks(blender_scene, monkeypatch):
    views = load_blender(blender_scene, BlenderOptions(hdr=False, truth=False)).train
    points = np.random.default_rng(0).uniform(-1, 1, (2000, 3)).astype(np.float32)
    whole = hull.SilhouetteField.of_views(views)
    monkeypatch.setattr(hull, "_FIELD_BYTES", views.alpha.nbytes // 4)
    reduced = hull.SilhouetteField.of_views(views)
    assert reduced.distances.shape[1:] == (views.height // 2, views.width // 2)
    pixel = 2.5 / views.intrinsics[0, 0, 0]  # world units, about
    difference = np.abs(whole(points, -1.0) - reduced(points, -1.0))
    near = np.abs(whole(points, -1.0)) < 0.2
    assert near.sum() > 100
    assert np.median(difference[near]) < 0.5 * pixel
    assert difference[near].max() < 4 * pixel


def test_files_go_to_the_store_and_are_read_from_there(blender_scene, tmp_path_factory, in_files):
    """The scratch folder of the node that loaded them is gone when the next one runs."""
    in_files()
    folder = tmp_path_factory.mktemp("run")
    (folder / "graph.yaml").write_text(GRAPH.format(scene=blender_scene))
    store = Store(folder / "store")
    graph = check_file(folder / "graph.yaml", [], load_packs())
    record = Runner(graph, store, RunFolder(folder / "runs", "large"), lambda _: None, backend=Inline(store)).run()
    rows = {row["name"]: row for row in record["nodes"]}
    assert {row["state"] for row in rows.values()} == {"done"}
    views = store.load(Views, rows["views"]["outputs"]["train"]["digest"])
    assert views.in_files
    assert all(file.is_relative_to(store.root / "objects") for file in views.images.files)
    assert not any(store.work.rglob("*.npy"))
