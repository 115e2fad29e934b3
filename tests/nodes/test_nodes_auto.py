"""init.auto: what it picks, that it says so, and that only this runs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from exmesh_nodes import auto, gaussians, init, prior

from exmesh_graph.errors import DataError
from exmesh_graph.evaluate.metrics import removable, rephotography
from exmesh_graph.geometry import openings
from exmesh_graph.geometry.coarse_start import (
    MOST_ITERATIONS,
    Known,
    bolder,
    choose,
    reduction,
    surface_row,
    uncarved_row,
)
from exmesh_graph.geometry.hull import surface
from exmesh_graph.geometry.lids import lids
from exmesh_graph.geometry.openings import Lidded, opened
from exmesh_graph.geometry.settings import CleanSettings, HullSettings
from exmesh_graph.io.blender import load_blender
from exmesh_graph.io.settings import BlenderOptions
from exmesh_graph.report.page import decision_tables
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import DepthMaps, Mesh, PointCloud
from tests.evaluate.test_metrics_opened import photographs
from tests.geometry.test_openings import HALF, drum, grid_of

SAMPLE = Path(__file__).parents[2] / "graphs" / "samples" / "spot"
KNOWN = Known(views=30, masks=True, points=False, depths=False, pixels=256 * 256)


@pytest.fixture(scope="module")
def views():
    return load_blender(SAMPLE, BlenderOptions(downscale=8, max_views=8)).train


@pytest.mark.parametrize(
    ("change", "seconds", "start", "because"),
    [
        ({}, 20, "hull", "more than 20"),
        ({}, 300, "stereo", "no outline shows"),
        ({"pixels": 1600 * 1200, "views": 60}, 300, "hull", "some 481 s, more than 300"),
        ({"depths": True}, 20, "tsdf", "masks close"),
        ({"depths": True, "masks": False}, 300, "tsdf", "depth maps are wired in"),
        ({"masks": False, "points": True}, 300, "stereo", "points are wired in"),
        ({"masks": False}, 300, "stereo", "neither masks, points nor depth maps"),
        ({"masks": False}, 5, "stereo", "is fused, in some 38 s"),
        ({"stereo": True}, 5, "stereo", "found with the masks"),
        ({"stereo": True, "masks": False}, 5, "stereo", "when masks were looked for"),
    ],
)
def test_the_choice_follows_what_there_is_and_the_time(change, seconds, start, because):
    made, count = choose(replace(KNOWN, **change), seconds)
    assert made.value == start
    assert because.lower() in made.reason.lower()
    assert 500 <= count.value <= MOST_ITERATIONS
    assert choose(replace(KNOWN, **change), 1e9)[1].value == MOST_ITERATIONS


def test_pictures_come_down_to_the_asked_side():
    assert [reduction(w, h, 400) for w, h in ((400, 300), (401, 300), (4000, 3000), (300, 1600), (10, 8))] == [
        1, 2, 10, 4, 1,
    ]  # fmt: skip


@pytest.mark.thorough
def test_only_the_chosen_start_runs_and_the_report_says_which(views, monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("this start was not chosen")

    for module, name in ((gaussians, "pgsr"), (prior, "patch_match"), (init, "tsdf"), (init, "sphere")):
        monkeypatch.setattr(module, name, refuse)
    context = FakeContext()
    out = auto.auto(context, views, p=auto.AutoParams(seconds=5, resolution=32, faces=400, tolerance=0))
    assert out.mesh.facets()["closed"]
    assert len(out.mesh.faces) <= 400
    (table,) = decision_tables({"coarse.decisions": out.decisions.values}).values()
    assert [(row["name"], row["value"]) for row in table] == [("start", "hull")]
    assert "more than 5" in table[0]["reason"]
    assert table[0]["reason"] in context.lines[0]
    monkeypatch.undo()
    monkeypatch.setattr(init, "visual_hull", refuse)
    other = auto.auto(context, views, p=auto.AutoParams(seconds=5, method="sphere", faces=400))
    assert other.decisions.values["decisions"][0]["reason"] == "Set by `method`."
    assert np.linalg.norm(other.mesh.vertices, axis=1) == pytest.approx(0.8, abs=0.05)
    with pytest.raises(DataError, match="none are wired in"):
        auto.auto(context, views, p=auto.AutoParams(method="tsdf"))


@pytest.mark.thorough
def test_edges_span_no_more_pixels_than_asked_up_to_the_most_faces(views):
    def faces(**parameters):
        p = auto.AutoParams(method="hull", resolution=48, faces=200, tolerance=0, openings=False, **parameters)
        return len(auto.auto(FakeContext(), views, p=p).mesh.faces)

    as_asked, coarse, fine = faces(), faces(edge=6), faces(edge=2)
    assert as_asked <= 200
    assert coarse == as_asked, "edges span less than so many of these small pictures' pixels"
    assert 2 * as_asked < fine
    finer = load_blender(SAMPLE, BlenderOptions(downscale=4, max_views=8)).train
    p = auto.AutoParams(method="hull", resolution=48, faces=200, tolerance=0, openings=False, edge=4)
    mesh = auto.auto(FakeContext(), finer, p=p).mesh
    assert len(mesh.faces) == pytest.approx(fine, rel=0.15)
    assert auto._budget(Mesh(1000 * mesh.vertices, mesh.faces), finer, p) == CleanSettings().max_faces


@pytest.mark.thorough
@pytest.mark.parametrize("foretold", [None, (0.8, 0.2)])
def test_photographs_decide_between_the_hull_and_what_was_carved_out_of_it(foretold, monkeypatch):
    """Depth maps that cut off all that is far from the middle: the photographs do not fit what is left."""
    views = load_blender(SAMPLE, BlenderOptions(downscale=8, max_views=16)).train
    middle = np.linalg.norm(views.camera_to_world[:, :3, 3], axis=1).astype(np.float32) - np.float32(0.5)
    through = DepthMaps(views.names, np.where(views.alpha > 0.5, middle[:, None, None], np.float32(0)))
    monkeypatch.setattr(prior, "patch_match", lambda *_, **__: prior.DepthOut(through))
    if foretold is not None:
        monkeypatch.setattr(rephotography, "gain", lambda *_: foretold)
    context = FakeContext()
    p = auto.AutoParams(resolution=24, faces=200, openings=False)
    out = auto.auto(context, views, p=p)
    row = out.decisions.values["decisions"][-1]
    hull = auto.auto(context, views, p=p.model_copy(update={"method": "hull"})).mesh
    kept = len(hull.vertices) == len(out.mesh.vertices) and np.array_equal(hull.vertices, out.mesh.vertices)
    if foretold is None:
        assert kept
        assert row["value"] == "hull"
    else:
        assert not kept
        assert (row["value"], row["gain"], row["error"]) == ("stereo", 0.8, 0.2)
        assert "stereo carved than over the hull, by 0.80 +- 0.20 dB" in row["reason"]
    assert row["reason"] in context.lines[1]
    assert [r["name"] for r in decision_tables({"d": out.decisions.values})["d"]] == ["start", "surface"]


@pytest.mark.thorough
def test_the_mouth_of_a_vessel_is_opened():
    """A painted cup, whose hull is a drum; `openings: false` leaves it one."""
    grid = grid_of(48)
    mesh = surface(drum(grid), grid)
    top = next(lid for lid in lids(drum(grid), grid, *mesh) if lid.normal[1] > 0.9)
    views = photographs(*opened(drum(grid), grid, [Lidded(drum(grid), grid, *mesh, top).opening(0.09, 0.75)]))
    context = FakeContext()
    out = auto.auto(context, views, p=auto.AutoParams(method="hull", faces=1500))
    row = out.decisions.values["decisions"][-1]
    assert (row["name"], row["value"]) == ("openings", "1")
    assert "faces (0.0, 1.0, " in row["reason"]
    assert any(row["reason"] in line for line in context.lines)
    closed = auto.auto(FakeContext(), views, p=auto.AutoParams(method="hull", faces=1500, openings=False))
    assert [one["name"] for one in closed.decisions.values["decisions"]] == ["start", "base"]  # seen from above

    def bottom(one):
        near = np.hypot(one.vertices[:, 0], one.vertices[:, 2]) < 0.25
        return one.vertices[near & (one.vertices[:, 1] > -0.4), 1].max()

    assert bottom(closed.mesh) > HALF - 0.05
    assert bottom(out.mesh) < HALF - 0.6


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("found", "gain", "kept", "open_at"),
    [
        (0, -1.0, "hull", []),
        (0, 0.5, "stereo", []),
        (1, -1.0, "hull", [1, 1]),
        (1, 0.5, "stereo", [1, 1]),  # beside the mouth, which stays open
        (1, 1.0, "stereo", [1, 1]),  # in it, too
    ],
)
def test_what_was_carved_is_judged_against_the_opened_hull(found, gain, kept, open_at, monkeypatch):
    """A mouth that no outline shows must not speak for a carved surface and all its pits."""
    views = load_blender(SAMPLE, BlenderOptions(downscale=8, max_views=16)).train
    distance = np.linalg.norm(views.camera_to_world[:, :3, 3], axis=1).astype(np.float32) - np.float32(0.5)
    through = DepthMaps(views.names, np.where(views.alpha > 0.5, distance[:, None, None], np.float32(0)))
    monkeypatch.setattr(prior, "patch_match", lambda *_, **__: prior.DepthOut(through))
    judged, looked = [], []

    def scores(self, surface):
        judged.append(surface[0])
        return rephotography.Scores(np.zeros(3), np.zeros(3))

    def mouths(ctx, shown, solid, p):
        looked.append(float(solid(24)[0].max()))
        return ["mouth"] * found, {"name": "openings", "value": str(found or "none"), "reason": ""}

    made = []
    monkeypatch.setattr(rephotography.Foretold, "scores", scores)
    monkeypatch.setattr(rephotography, "gain", lambda *_: (gain, 0.1))
    monkeypatch.setattr(removable, "removable", lambda carving, *_: [carving.taken])
    monkeypatch.setattr(auto, "_mouths", mouths)
    monkeypatch.setattr(openings, "opened", lambda values, grid, mouths: made.append(mouths) or surface(values, grid))
    monkeypatch.setattr(openings, "apart", lambda let, grid, mouths: let)
    out = auto.auto(FakeContext(), views, p=auto.AutoParams(resolution=24, faces=200))
    assert len(judged) == 2 + found
    again = kept == "stereo" and (not found or gain > 0.6)
    assert len(looked) == 1 + again  # what was carved may be a vessel as well
    assert max(looked) == looked[0]
    assert [len(mouths) for mouths in made] == open_at + [1] * (found and again)
    rows = [(row["name"], row["value"]) for row in out.decisions.values["decisions"]]
    assert rows[1:] == [("surface", kept), ("openings", str(found or "none"))]


def test_iterations_ask_for_gaussians(views, monkeypatch):
    flat = DepthMaps(views.names, np.where(views.alpha > 0.5, np.float32(2.5), np.float32(0)))
    monkeypatch.setattr(auto, "_fitted_depths", lambda *_: flat)
    out = auto.auto(FakeContext(), views, p=auto.AutoParams(iterations=700, resolution=24, faces=200, tolerance=0))
    assert [row["value"] for row in out.decisions.values["decisions"]] == ["pgsr", 700]
    assert "asks for" in out.decisions.values["decisions"][0]["reason"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gains", "kept"), [((1, 1), "pgsr"), ((1, -1), "stereo"), ((-1, 1), "pgsr"), ((-1, -1), "hull")]
)
def test_where_gaussians_are_asked_for_stereo_is_tried_beside_them(gains, kept, monkeypatch):
    views = load_blender(SAMPLE, BlenderOptions(downscale=8, max_views=16)).train
    distance = np.linalg.norm(views.camera_to_world[:, :3, 3], axis=1).astype(np.float32)
    inside = views.alpha > 0.5

    def depths(radius):
        return DepthMaps(views.names, np.where(inside, (distance - np.float32(radius))[:, None, None], np.float32(0)))

    radii = {"stereo": 0.5, "pgsr": 0.3}
    monkeypatch.setattr(prior, "patch_match", lambda *_, **__: prior.DepthOut(depths(radii["stereo"])))
    monkeypatch.setattr(auto, "_fitted_depths", lambda *_: depths(radii["pgsr"]))
    left = [float(gain) for gain in gains for _ in ("picture", "detail")]
    monkeypatch.setattr(rephotography, "gain", lambda *_: (left.pop(0), 0.1))
    monkeypatch.setattr(removable, "removable", lambda carving, *_: [carving.taken])
    p = auto.AutoParams(iterations=10, resolution=24, faces=200, openings=False)
    out = auto.auto(FakeContext(), views, p=p)
    alone = auto.auto(FakeContext(), views, p=p.model_copy(update={"method": kept})).mesh
    np.testing.assert_array_equal(out.mesh.vertices, alone.vertices)
    rows = [row["value"] for row in out.decisions.values["decisions"] if row["name"] == "surface"]
    assert len(rows) == 2
    assert rows[-1] == {"pgsr": "gaussians"}.get(kept, kept)


@pytest.mark.thorough
def test_photographs_foretell_one_another_in_one_exposure(tmp_path):
    """Where exposures wander they are evened out first, by what the carved surface shows of them."""
    as_it_is = load_blender(SAMPLE, BlenderOptions(downscale=2)).train
    mesh = init.visual_hull(FakeContext(), as_it_is, p=HullSettings(resolution=48)).mesh
    factors = 2 ** np.random.default_rng(3).uniform(-0.5, 0.5, len(as_it_is)).astype(np.float32)
    dark = np.asarray(as_it_is.images) * 0.5  # so that nothing is cut off
    wandering = replace(as_it_is, images=dark * factors[:, None, None, None])
    ctx, p = FakeContext(scratch=tmp_path), auto.AutoParams()
    assert auto._steady(ctx, as_it_is, mesh, p) is as_it_is
    assert not ctx.lines
    steady = auto._steady(ctx, wandering, mesh, p)
    assert "evened out" in ctx.lines[0]
    ratio = np.log2([steady.images[k][dark[k] > 0.1].mean() / dark[k][dark[k] > 0.1].mean() for k in range(len(dark))])
    assert ratio.std() < 0.2 * np.log2(factors).std()


@pytest.mark.parametrize(
    ("gain", "detail", "value", "told"),
    [
        ((0.41, 0.40), (0, 0.1), "stereo", "stereo carved than over the hull, by 0.41 +- 0.40 dB."),
        ((0.39, 0.40), (0, 0.1), "hull", "by 0.39 +- 0.40 dB: no more than the doubt of it, so the hull stays."),
        ((-0.39, 0.4), (0, 0.1), "hull", "over the hull than over the surface that stereo carved, by 0.39 +- 0.40 dB."),
        ((0.29, 0.03), (1, 0.1), "hull", "no more than pits under gloss bring (0.30 dB), so the hull stays."),
        ((0.31, 0.03), (-0.05, 0.06), "stereo", "carved than over the hull, by 0.31 +- 0.03 dB."),
        ((0.40, 0.03), (-0.57, 0.06), "hull", "by 0.57 +- 0.06 dB, as over pits under gloss, so the hull stays."),
    ],
)  # fmt: skip
def test_what_was_carved_must_gain_beyond_doubt_and_beyond_what_gloss_brings(gain, detail, value, told):
    row = surface_row(gain, detail, "stereo")
    assert row["value"] == value
    assert row["reason"].endswith(told)
    assert (row["gain"], row["error"], row["detail"]) == (*gain, detail[0])


def test_a_bolder_choice_must_gain_beyond_doubt_and_in_its_details():
    assert [bolder((gain, 0.1), (1.0, 0.1)) for gain in (-1.0, 0.29, 0.31)] == [False, False, True]
    assert [bolder((1.0, 0.1), (gain, 0.1)) for gain in (-1.0, 0.19, 0.21)] == [False, False, True]


def test_where_photographs_let_nothing_go_that_is_said():
    row = uncarved_row("gaussians", "stereo")
    assert row["value"] == "stereo"
    assert row["reason"].endswith("the Gaussians would carve, so the surface that stereo carved stays.")


def test_depth_that_was_found_with_the_masks_is_not_looked_for_again(views, monkeypatch):
    """A mask lets through what lies in it, of depth maps that hold the background too."""
    near = np.linalg.norm(views.camera_to_world[:, :3, 3], axis=1).astype(np.float32)[:, None, None]
    inside = views.alpha >= 0.5
    whole = DepthMaps(views.names, np.where(inside, near - np.float32(0.4), near + np.float32(0.2)))
    cut = replace(whole, depth=np.where(inside, whole.depth, np.float32(0)))
    p = auto.AutoParams(seconds=1, resolution=24, faces=200, tolerance=0)
    monkeypatch.setattr(prior, "patch_match", lambda *_, **__: prior.DepthOut(cut))
    looked = auto.auto(FakeContext(), views, p=p.model_copy(update={"seconds": 1e4}))
    monkeypatch.setattr(prior, "patch_match", None)
    kept = auto.auto(FakeContext(), views, stereo=whole, p=p)
    np.testing.assert_array_equal(kept.mesh.vertices, looked.mesh.vertices)
    assert "found with the masks" in kept.decisions.values["decisions"][0]["reason"]
    with pytest.raises(DataError, match="not those of the views"):
        auto.auto(FakeContext(), views, stereo=DepthMaps(views.names[1:], whole.depth[1:]), p=p)


@pytest.mark.thorough
def test_stereo_carves_and_fuses(views):
    context = FakeContext()
    p = auto.AutoParams(method="stereo", resolution=32, faces=400, tolerance=0)
    out = auto.auto(context, views, p=p)
    assert out.mesh.facets()["closed"]
    assert [row["value"] for row in out.decisions.values["decisions"]] == ["stereo"]
    assert any(line.startswith("depth in") for line in context.lines)
    middle = np.median(out.mesh.vertices, axis=0)
    assert (np.linalg.norm(out.mesh.vertices - middle, axis=1) < 1).all()
    bare = replace(views, alpha=np.ones_like(views.alpha), has_masks=False)
    with pytest.raises(DataError, match=r"(?s)no two of the 8 views agree.*iterations: 500"):
        auto.auto(context, bare, p=p)
    larger = load_blender(SAMPLE, BlenderOptions(downscale=2, max_views=20)).train
    bare = replace(larger, alpha=np.ones_like(larger.alpha), has_masks=False)
    fused = auto.auto(context, bare, p=auto.AutoParams(resolution=32, faces=400))
    assert [row["value"] for row in fused.decisions.values["decisions"]] == [
        "stereo",
        "none",
        "none",
    ]  # start, table, mirrors
    assert len(fused.mesh.faces) > 50


@pytest.mark.slow
def test_gaussians_are_fitted_and_fused_and_depths_are_fused(views):
    context = FakeContext()
    p = auto.AutoParams(method="pgsr", iterations=40, count=800, resolution=32, faces=400)
    out = auto.auto(context, views, p=p)
    assert out.mesh.facets()["closed"]
    assert [row["value"] for row in out.decisions.values["decisions"]] == ["pgsr", 40]
    flat = DepthMaps(views.names, np.where(views.alpha > 0.5, np.float32(2.5), np.float32(0)))
    cloud = PointCloud(np.zeros((4, 3), np.float32), np.zeros((4, 3), np.float32))
    carved = auto.auto(context, views, cloud, flat, p=auto.AutoParams(seconds=1e6, resolution=32, faces=400))
    assert carved.decisions.values["decisions"][0]["value"] == "tsdf"


def test_dropping_parts_of_an_object_is_said():
    from exmesh_graph.geometry.shapes import icosphere
    from exmesh_graph.types import Mesh

    vertices, faces = icosphere(3, 0.3)
    beside = vertices + np.array([0.7, 0, 0])
    two = Mesh(np.concatenate([vertices, beside]).astype(np.float32),
               np.concatenate([faces, faces + len(vertices)]).astype(np.int32))  # fmt: skip
    context = FakeContext()
    assert len(init.clean(context, two, p=init.CleanSettings(faces=400)).mesh.faces) <= 400
    assert "50% of the surface" in "".join(context.warnings)
    quiet = FakeContext()
    init.clean(quiet, two, p=init.CleanSettings(faces=400, components=0))
    assert not quiet.warnings


def test_a_carved_surface_that_touches_itself_is_mended(views, monkeypatch):
    from exmesh_graph.geometry import hull
    from exmesh_graph.geometry.shapes import icosphere
    from exmesh_graph.geometry.soundness import inspect

    vertices, faces = icosphere(2, 0.5)
    pillow = np.array([[faces[0, 0], faces[0, 1], faces[9, 2]], [faces[0, 1], faces[0, 0], faces[9, 2]]], np.int32)
    assert inspect(vertices, np.concatenate([faces, pillow])).crowded_edges
    monkeypatch.setattr(hull, "surface", lambda *_: (vertices, np.concatenate([faces, pillow])))
    flat = DepthMaps(views.names, np.zeros(views.alpha.shape, np.float32))
    made = init.tsdf(FakeContext(), views, flat, p=init.TsdfParams(solid=True)).mesh
    assert len(made.faces) == len(faces)
    assert inspect(made.vertices, made.faces).closed
