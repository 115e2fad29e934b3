"""Exposures told from one surface: found where they wander, left alone where they do not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from exmesh_nodes.appearance import Auto, Directional, PerVertex, UvTexture
from exmesh_nodes.stage1 import BalanceParams, balance
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from benchmarks.coarse_work import hull, load_scene
from exmesh_graph.geometry.adjacency import face_normals
from exmesh_graph.raster import shown_faces
from exmesh_graph.stage1 import exposure
from exmesh_graph.stage1.exposure import balanced, exposures, separate
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import Mesh, Views
from exmesh_graph.types.pictures import kept_in

SAMPLE = Path(__file__).parents[2] / "graphs" / "samples" / "spot"


@pytest.fixture(scope="module")
def scene() -> tuple[Views, Mesh]:
    """The sample's training views at 128 x 128, and the hull of its masks."""
    loaded, case = load_scene(SAMPLE, 2, 0)
    return loaded.train, Mesh(*hull(case, 32))


def wandering(views: Views, seed: int = 0) -> tuple[Views, np.ndarray]:
    """The views under exposures that differ by up to half a stop, cut off at 1 as files do; and their stops [N, 3]."""
    rng = np.random.default_rng(seed)
    stops = rng.uniform(-0.5, 0.5, (len(views), 1)) + rng.uniform(-0.15, 0.15, (len(views), 3))
    exposed = balanced(views, -np.log(2) * stops)
    return replace(exposed, images=np.minimum(exposed.images, 1)), stops


@pytest.mark.thorough
def test_views_of_one_exposure_do_not_wander(scene):
    assert exposures(*scene).rough < 0.03


@pytest.mark.thorough
def test_exposures_that_wander_are_found_and_taken_out(scene):
    views, mesh = scene
    own = exposures(views, mesh)
    exposed, stops = wandering(views)
    found = exposures(exposed, mesh)
    error = found.stops - own.stops - (stops - stops.mean(0))
    assert found.rough > 0.2
    assert found.known.all()
    assert np.sqrt(np.square(error).mean()) < 0.02  # the darkest and brightest pixels are other ones
    again = exposures(balanced(exposed, found.log_gains), mesh)
    assert again.rough < 0.03


def test_shadows_over_a_quarter_of_a_picture_do_not_count_as_its_exposure(scene):
    views, mesh = scene
    images = np.array(views.images)
    for i in range(0, len(views), 2):
        columns = np.flatnonzero(views.alpha[i].any(0))
        images[i][:, columns[: len(columns) // 4]] *= 0.3
    shaded = exposures(replace(views, images=images), mesh)
    assert np.abs(shaded.stops - exposures(views, mesh).stops).max() < 0.25
    assert shaded.rough < 0.07


def test_a_view_that_shares_nothing_keeps_its_exposure(scene):
    views, mesh = scene
    images = np.array(views.images)
    images[3] = 0
    found = exposures(replace(views, images=images), mesh)
    assert not found.known[3]
    assert found.known.sum() == len(views) - 1
    assert (found.log_gains[3] == 0).all()


def test_without_two_views_that_share_a_face_all_are_left(scene):
    views, mesh = scene
    found = exposures(views.subset([0]), mesh)
    assert (found.log_gains == 0).all()
    assert found.rough == 0


@given(st.integers(0, 1000))
@settings(max_examples=15, deadline=None)
def test_the_sum_of_absolute_errors_is_least(seed):
    """Against linear programming, on sets with gaps and outliers."""
    rng = np.random.default_rng(seed)
    views, faces = 5, 16
    truth = rng.normal(size=(views, 1)) + rng.normal(size=faces) + 0.05 * rng.normal(size=(views, faces))
    truth[rng.random(truth.shape) < 0.1] += 2
    truth[:, : faces // 4][rng.random((views, faces // 4)) < 0.4] = np.nan
    gains, known = separate(np.repeat(truth[..., None], 3, axis=-1))
    assert known.all()
    rows, cols = np.nonzero(np.isfinite(truth) & (np.isfinite(truth).sum(0) >= 2))
    size = views + faces
    design = np.zeros((len(rows), size))
    design[np.arange(len(rows)), rows] = design[np.arange(len(rows)), views + cols] = 1
    unit = np.eye(len(rows))
    least = linprog(
        np.concatenate([np.zeros(size), np.ones(len(rows))]),
        A_ub=np.block([[design, -unit], [-design, -unit]]),
        b_ub=np.concatenate([truth[rows, cols], -truth[rows, cols]]),
        bounds=[(None, None)] * size + [(0, None)] * len(rows),
    ).fun  # fmt: skip
    surface = np.nanmedian(truth - gains[:, :1], axis=0)
    ours = np.abs(truth - gains[:, :1] - surface)[rows, cols].sum()
    assert ours < least * 1.03 + 0.02


def test_patches_in_shadow_or_cut_off_are_not_read(scene):
    views, mesh = scene
    bright = replace(views, images=np.ones_like(np.asarray(views.images)))
    assert np.isnan(exposure.patch_colours(bright, mesh)).all()
    assert np.isfinite(exposure.patch_colours(views, mesh)).any()


@pytest.mark.thorough
@pytest.mark.parametrize(("how", "taken"), [("auto", True), ("on", True), ("off", False)])
def test_the_node_balances_where_exposures_wander_and_says_so(scene, tmp_path, how, taken):
    views, stops = wandering(scene[0])
    context = FakeContext(scratch=tmp_path)
    out = balance(context, views, scene[1], p=BalanceParams(exposure=how))
    levels = np.asarray(out.views.images)[..., 1].sum((1, 2)) / np.asarray(scene[0].images)[..., 1].sum((1, 2))
    assert (np.ptp(np.log2(levels)) < 0.3) == taken
    if how == "off":
        assert out.views is views
    else:
        (row,) = out.decisions.values["decisions"]
        assert row["value"] == "balanced"
        assert np.corrcoef([found[1] for found in out.decisions.values["stops"].values()], stops[:, 1])[0, 1] > 0.98


def test_the_node_leaves_views_of_one_exposure_as_they_are(scene, tmp_path):
    out = balance(FakeContext(scratch=tmp_path), *scene, p=BalanceParams())
    assert out.views is scene[0]
    assert out.decisions.values["decisions"][0]["value"] == "as it is"


def test_a_large_set_is_balanced_file_by_file(scene, tmp_path, monkeypatch):
    views, _ = wandering(scene[0])
    few = views.subset([0, 1, 2, 3])
    gains = np.linspace(-0.3, 0.4, 12).reshape(4, 3)
    whole = balanced(few, gains)
    monkeypatch.setattr("exmesh_graph.io.picture_files.too_large", lambda *_: True)
    with kept_in(tmp_path):
        by_file = balanced(few, gains)
        np.testing.assert_allclose(np.asarray(by_file.images), whole.images, atol=1e-6)


def mirrored(views: Views, mesh: Mesh, stops: float) -> Views:
    """Parts are darker by so much where they mirror every other of some bands of the surroundings."""
    normals, images = face_normals(mesh.vertices, mesh.faces), np.array(views.images)
    size = views.height, views.width
    for i in range(len(views)):
        face = shown_faces(mesh.vertices, mesh.faces, views.intrinsics[i], views.world_to_camera[i], *size)
        towards = views.camera_to_world[i, :3, 3] - mesh.vertices[mesh.faces].mean(1)
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        dark = np.sin(6 * (2 * (towards * normals).sum(1) * normals[:, 1] - towards[:, 1])) < 0
        images[i] *= np.where((face >= 0) & dark[face], 2.0**-stops, 1.0)[..., None]
    return replace(views, images=images)


@pytest.mark.thorough
def test_the_appearance_is_chosen_by_how_much_parts_change_from_view_to_view(scene):
    views, mesh = scene
    said: list[str] = []
    assert isinstance(Auto().decided(views, mesh, said.append), UvTexture)
    assert isinstance(Auto().decided(mirrored(views, mesh, 0.6), mesh, said.append), Directional)
    assert isinstance(Auto(gloss=0).decided(views, mesh, said.append), Directional)
    assert isinstance(PerVertex().decided(views, mesh, said.append), PerVertex)
    assert ["alone" in line for line in said] == [True, False, False]
