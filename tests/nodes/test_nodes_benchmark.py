"""The benchmark nodes on the tiny scene, their graphs on folders of the published layouts, and the printed tables."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from exmesh_nodes import benchmark

from exmesh_graph.errors import DataError, MissingLibraryError
from exmesh_graph.evaluate.protocols.dtu import DtuTruth, score_dtu
from exmesh_graph.evaluate.protocols.published import NOTE, TABLES, as_markdown, as_text, paper_table
from exmesh_graph.evaluate.protocols.stanford_orb import depth_map
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.report.collect import collect_benchmarks
from exmesh_graph.types import Carrier, Frame, LitViews, Mesh, Metrics, SceneTruth

QUICK = {"directions": 64, "bounces": 1, "supersampling": 2}
FRAME = Frame(np.diag([2.0, 2, 2, 1]), np.eye(4))


@pytest.mark.thorough
def test_synthetic4relight_gives_the_papers_row_and_every_albedo_rule(scene, context):
    p = benchmark.Synthetic4RelightParams(scene="hotdog", pictures=1, **QUICK)
    values = benchmark.synthetic4relight(context, scene.asset, scene.test, scene.truth, scene.train, p=p).metrics.values
    row = values["benchmark"]["row"]
    assert set(row) == {*TABLES["synthetic4relight"].columns} - {"time"}
    assert row["NVS PSNR"] > 38
    assert row["relight PSNR"] > 38
    assert row["albedo PSNR"] > 60
    assert row["roughness MSE"] < 1e-6
    assert row["NVS LPIPS"] is None
    assert row["albedo PSNR"] == pytest.approx(values["albedo_rules"]["median"]["linear"])
    assert set(values["albedo_rules"]) >= {"median", "least_squares", "sampled_red", "none", "r3dg"}


@pytest.mark.thorough
def test_the_rule_goes_onto_relit_pictures_and_is_not_fitted_on_them(scene, context):
    dark = replace(scene.asset, base_color=scene.asset.base_color / 2)
    rows = {}
    for rule in ("median", "none"):
        p = benchmark.Synthetic4RelightParams(scene="x", pictures=0, max_views=1, rule=rule, **QUICK)
        out = benchmark.synthetic4relight(context, dark, scene.test, scene.truth, p=p)
        rows[rule] = out.metrics.values["benchmark"]["row"]
    assert rows["median"]["relight PSNR"] > rows["none"]["relight PSNR"] + 8
    # A relit truth under a brighter light must cost the figure: the scale comes from albedo.
    lights = {"other": (scene.truth.relit["other"][0], scene.truth.relit["other"][1] * 2)}
    brighter = replace(scene.truth, relit=lights)
    p = benchmark.Synthetic4RelightParams(scene="x", pictures=0, max_views=1, **QUICK)
    out = benchmark.synthetic4relight(context, dark, scene.test, brighter, p=p)
    assert out.metrics.values["benchmark"]["row"]["relight PSNR"] < rows["median"]["relight PSNR"] - 8


@pytest.mark.thorough
def test_a_scene_without_truth_and_weights_that_are_not_there(scene, context, tmp_path):
    p = benchmark.Synthetic4RelightParams(scene="x", **QUICK)
    with pytest.raises(DataError, match="lacks albedo"):
        benchmark.synthetic4relight(context, scene.asset, scene.test, replace(scene.truth, albedo=None), p=p)
    missing = benchmark.Synthetic4RelightParams(lpips=tmp_path / "none.safetensors")
    with pytest.raises(MissingLibraryError, match="is there"):
        benchmark.lpips_weights(missing)


@pytest.fixture(scope="module")
def orb_truth(scene):
    """Depth and normals rendered from the octahedron itself; a second capture under another light."""
    from exmesh_graph.stage2.render import render_transport, render_views

    depth = np.stack([depth_map(scene.asset, scene.test, i) for i in range(3)])
    transport = render_transport(scene.asset, 1, 64)
    other = np.roll(scene.asset.environment, 6, axis=1)[..., ::-1].copy()
    cameras = (scene.test.intrinsics, scene.test.camera_to_world, scene.test.height, scene.test.width)
    seen = render_views(scene.asset, *cameras, environment=other, transport=transport, seed=9)
    normal = np.einsum("nhwi,nij->nhwj", seen.normal, scene.test.camera_to_world[:, :3, :3])
    truth = replace(scene.truth, depth=depth.astype(np.float32), normal=normal.astype(np.float32))
    views = {**vars(scene.test), "names": ("a", "b", "c"), "images": seen.images, "alpha": seen.alpha}
    return truth, LitViews(**views, environments=np.stack([other] * 3))


@pytest.mark.thorough
def test_stanford_orb_of_the_true_asset(scene, orb_truth, context):
    truth, novel = orb_truth
    p = benchmark.OrbParams(scene="teapot_scene001", **QUICK)
    values = benchmark.stanford_orb(context, scene.asset, scene.test, novel, truth, FRAME, p=p).metrics.values
    row = values["benchmark"]["row"]
    assert set(row) == {*TABLES["stanford_orb"].columns} - {"time"}
    assert min(row["NVS PSNR-H"], row["NVS PSNR-L"], row["relight PSNR-H"], row["relight PSNR-L"]) > 35
    assert row["depth"] == pytest.approx(0, abs=1e-6)
    assert row["normal"] < 0.01
    assert values["albedo"]["psnr"] > 50
    # shape is from vertices to samples: six vertices, so only that direction is small
    assert row["CD"] > 1


@pytest.mark.thorough
def test_stanford_orb_catches_a_light_that_is_not_turned_and_depth_of_another_shape(scene, orb_truth, context):
    truth, novel = orb_truth
    p = benchmark.OrbParams(scene="x", max_views=1, **QUICK)
    straight = benchmark.stanford_orb(context, scene.asset, scene.test, novel, truth, FRAME, p=p).metrics.values
    turned = replace(novel, environments=np.roll(novel.environments, 8, axis=2))
    flat = replace(scene.asset, vertices=scene.asset.vertices * np.float32([1, 0.6, 1]))
    wrong = benchmark.stanford_orb(context, flat, scene.test, turned, truth, FRAME, p=p).metrics.values
    for name in ("relight PSNR-H", "relight PSNR-L"):
        assert wrong["benchmark"]["row"][name] < straight["benchmark"]["row"][name] - 5
    assert wrong["benchmark"]["row"]["depth"] > 0.5
    assert wrong["benchmark"]["row"]["normal"] > 0.02


def test_speed(scene, context):
    p = benchmark.SpeedParams(size=24, frames=2, directions=64, bounces=1, specular_samples=2)
    values = benchmark.speed(context, scene.asset, scene.test, p=p).metrics.values
    assert values["relight_fps"] > 0
    assert (values["vertices"], values["faces"], values["timed_frames"]) == (6, 8, 1)
    assert values["ply_bytes"] < 500


def test_nerf_synthetic_in_thousandths_of_the_files_unit(scene, context):
    p = benchmark.NerfSyntheticParams(scene="lego", samples=2000)
    grown = Mesh((scene.asset.vertices * 1.01).astype(np.float32), scene.asset.faces)
    values = benchmark.nerf_synthetic(context, grown, scene.truth, scene.test, FRAME, p=p).metrics.values
    gap = 1000 * 2 * 0.9 * 0.01 / np.sqrt(3)  # two scene units per normalised one
    row = values["benchmark"]["row"]
    assert row["CD visible"] == pytest.approx(gap, rel=0.05)
    assert row["CD full"] == pytest.approx(gap, rel=0.05)
    assert row["PSNR"] is None
    carrier = Carrier(
        **{name: getattr(scene.asset, name) for name in Carrier.__dataclass_fields__ if name in vars(scene.asset)}
    )
    scored = benchmark.nerf_synthetic(context, carrier, scene.truth, scene.test, FRAME, p=p)
    assert 5 < scored.metrics.values["benchmark"]["row"]["PSNR"] < 30
    with pytest.raises(DataError, match="no true mesh"):
        benchmark.nerf_synthetic(context, grown, SceneTruth(names=()), scene.test, FRAME, p=p)


def test_dtu_is_in_the_files_millimetres_and_culls_what_masks_do_not_show(scene, monkeypatch):
    vertices, faces = icosphere(4)
    ball = Mesh((0.5 * vertices).astype(np.float32), faces)
    rng = np.random.default_rng(0)
    cloud = rng.normal(size=(20000, 3))
    cloud *= 4 / np.linalg.norm(cloud, axis=1, keepdims=True)
    frame = Frame(np.array([[8.0, 0, 0, 100], [0, 8, 0, 0], [0, 0, 8, 0], [0, 0, 0, 1]]), np.eye(4))
    box = np.array([[90.0, -10, -10], [110, 10, 10]])
    truth = DtuTruth(cloud + np.array([100, 0, 0]), np.ones((21, 21, 21), bool), box, 1.0, np.array([0.0, 0, 0, 1]))
    monkeypatch.setattr("exmesh_graph.evaluate.protocols.dtu.read_truth", lambda folder, scan: truth)
    # A floater beside the octahedron, which the masks show.
    speck, outer = icosphere(2)
    speck = (speck * 0.05 + np.array([0.6, 0.6, 0])).astype(np.float32)
    both = Mesh(np.concatenate([ball.vertices, speck]), np.concatenate([faces, outer + len(vertices)]))
    values = score_dtu(both, frame, Path(), 24, [scene.test])
    alone = score_dtu(ball, frame, Path(), 24)
    assert values["culled"]["mesh_points"] < values["unculled"]["mesh_points"]
    assert values["culled"]["d2s"] == pytest.approx(alone["unculled"]["d2s"], abs=1e-3)
    assert values["unculled"]["d2s"] > values["culled"]["d2s"] + 0.01
    assert values["benchmark"] == {
        "table": "dtu", "scene": "24", "row": {"CD": values["culled"]["chamfer"], "vertices": len(both.vertices)},
    }  # fmt: skip
    assert "culled" not in alone
    assert alone["unculled"]["chamfer"] < 0.12


def test_the_papers_tables_hold_what_the_paper_says():
    for name, table in TABLES.items():
        assert all(len(row) == len(table.columns) + 1 for row in table.rows()), name
    dtu = {row[0]: row[1:] for row in TABLES["dtu"].rows()}
    for method, cells in dtu.items():  # the average of the scans, as printed, within rounding
        assert np.mean([float(cell) for cell in cells[:15]]) == pytest.approx(float(cells[15]), abs=0.0101), method
    assert dtu["ExMesh++"][15:] == ("0.58", "13m", "102K")
    assert len(TABLES["stanford_orb"].rows()) == 11
    assert len(TABLES["synthetic4relight"].rows()) == 8


def test_ours_is_the_mean_over_scenes_and_marked(scene):
    def scored(name, psnr, mse, seconds):
        row = {"relight PSNR": psnr, "roughness MSE": mse, "NVS LPIPS": None}
        return {"table": "synthetic4relight", "scene": name, "row": row, "seconds": seconds}

    scenes = [scored("chair", 30, 0.01, 60), scored("chair", 32, 0.01, 60), scored("jugs", 35, 0.03, 180)]
    rows = paper_table("synthetic4relight", scenes)
    ours = dict(zip(rows[0], rows[-1], strict=True))
    assert ours["method"] == "ours, 2 scenes"
    assert (ours["relight PSNR"], ours["roughness MSE"], ours["NVS LPIPS"], ours["time"]) == (
        "33.00",
        "0.020",
        "-",
        "2m",
    )
    assert all(row[-1] == NOTE for row in rows[1:-1])
    assert rows[-1][-1] == "measured here: jugs, chair"
    text = as_text(rows)
    assert text.splitlines()[-1].startswith("ours, 2 scenes")
    assert as_markdown(rows).count("\n") == len(rows) + 1
    scans = paper_table("dtu", [{"table": "dtu", "scene": "37", "row": {"CD": 0.5, "vertices": 20000}, "seconds": 5}])
    ours = dict(zip(scans[0], scans[-1], strict=True))
    assert (ours["24"], ours["37"], ours["CD"], ours["vertices"]) == ("-", "0.50", "0.50", "20K")


def test_rows_are_collected_from_a_runs_record():
    metrics = {"d": Metrics({"benchmark": {"table": "dtu", "scene": "24", "row": {"CD": 1.0}}}), "e": Metrics({})}

    def output(digest):
        return {"metrics": {"type": "Metrics", "digest": digest}}

    inputs = {"fit": {}, "cd": {"mesh": "@fit.state"}, "other": {}}
    record = {
        "nodes": [
            {"name": "fit", "type": "stage1.refine", "seconds": 7.0, "outputs": {}},
            {"name": "cd", "type": "benchmark.dtu", "seconds": 2.0, "outputs": output("d")},
            {"name": "other", "type": "evaluate.mesh", "outputs": output("e")},
        ],
        "resolved": {"nodes": {name: {"inputs": wires} for name, wires in inputs.items()}},
    }
    found = collect_benchmarks(record, metrics.get)
    assert [(entry["scene"], entry["row"]["CD"]) for entry in found] == [("24", 1.0)]
    assert found[0]["seconds"] >= 7.0
