"""The evaluation nodes: what a perfect, a scaled and a wrong asset score, beside their floors."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from exmesh_nodes import evaluate, gallery

from exmesh_graph.errors import DataError
from exmesh_graph.export.gltf import read_glb
from exmesh_graph.graph.cache.fingerprint import fingerprint
from exmesh_graph.graph.declare.packs import load_packs
from exmesh_graph.io.images import read_image
from exmesh_graph.testing import FakeContext, depth_maps
from exmesh_graph.types import Mesh, Metrics, Region, SceneTruth

ROOT = Path(__file__).parent.parent.parent
TYPES = load_packs().types
PARAMS = evaluate.AssetParams(directions=64, bounces=1, pictures=2)


@pytest.fixture(scope="module")
def perfect(scene, tmp_path_factory):
    context = FakeContext(tmp_path_factory.mktemp("perfect"))
    out = evaluate.asset(context, scene.asset, scene.test, scene.truth, scene.train, p=PARAMS)
    return out, context


@pytest.mark.thorough
def test_the_true_asset_scores_high_and_the_gray_guess_low(perfect):
    values = perfect[0].metrics.values
    assert values["held_out"]["psnr"] > 38
    assert values["relit"]["psnr"] > 38
    assert values["material"]["albedo_psnr_linear"] > 60
    assert values["material"]["roughness_mse"] < 1e-8
    np.testing.assert_allclose(values["material"]["albedo_scale"], 1, atol=1e-3)
    floor = values["floor"]
    assert floor["held_out_psnr"] < values["held_out"]["psnr"] - 10
    assert floor["relit_psnr"] < values["relit"]["psnr"] - 10
    assert floor["albedo_psnr_linear"] < 30
    assert floor["roughness_mse"] > 1e-3


def test_the_headline_puts_the_floor_beside_each_figure(perfect):
    headline = {entry["label"]: entry for entry in perfect[0].metrics.values["headline"]}
    floor = perfect[0].metrics.values["floor"]
    assert list(headline) == [
        "Held-out PSNR",
        "Relit PSNR",
        "Relit PSNR, albedo unscaled",
        "Albedo PSNR (linear)",
        "Roughness MSE",
    ]
    assert headline["Relit PSNR"]["floor"] == floor["relit_psnr"]
    assert headline["Roughness MSE"]["better"] == "lower"


def test_means_are_means_over_the_views_and_progress_ends_full(perfect):
    values, context = perfect[0].metrics.values, perfect[1]
    assert np.isclose(values["held_out"]["psnr"], np.mean(list(values["held_out"]["psnr_per_view"].values())))
    assert set(values["held_out"]["psnr_per_view"]) == {"test_a", "test_b", "test_c"}
    # 2 x 3 held-out, 2 x 3 relit (with and without the scale in one), 1 for the interreflected light
    assert context.steps[-1][0] == context.steps[-1][1] == 13


def test_the_gallery_shows_ours_truth_and_error(perfect, scene):
    out, context = perfect
    root = gallery.asset(context, scene.asset, out.scored, scene.truth).gallery.root
    entries = json.loads((root / "captions.json").read_text())
    files = {entry["file"] for entry in entries}
    assert {
        "relit_other.png",
        "albedo.png",
        "roughness.png",
        "environment.png",
        "atlas.png",
        "geometry.png",
        "indirect.png",
        "model.glb",
    } < files
    assert len([f for f in files if f.startswith("held_out")]) == 2
    assert all(entry["title"] and entry["caption"] for entry in entries)
    picture = read_image(root / "held_out_002.png")
    assert picture.shape == (40, 4 * 40 + 3 * 6, 3)
    assert np.abs(picture[:, :40] - picture[:, 46:86]).mean() < 0.01


@pytest.mark.thorough
def test_a_channelwise_scaled_albedo_is_forgiven_and_a_permuted_one_is_not(scene, context):
    factor = np.array([2.0, 0.5, 1.0], np.float32)
    scaled = replace(scene.asset, base_color=scene.asset.base_color * factor)
    values = evaluate.asset(context, scaled, scene.test, scene.truth, p=PARAMS).metrics.values
    np.testing.assert_allclose(values["material"]["albedo_scale"], 1 / factor, rtol=1e-3)
    assert values["material"]["albedo_psnr_linear"] > 60
    assert values["material"]["albedo_psnr_linear_unscaled"] < 25
    assert values["relit"]["psnr"] > 38
    assert values["relit"]["psnr_unscaled"] < 30
    permuted = replace(scene.asset, base_color=scene.asset.base_color[..., [1, 2, 0]].copy())
    values = evaluate.asset(context, permuted, scene.test, scene.truth, p=PARAMS).metrics.values
    assert values["material"]["albedo_psnr_linear"] < 30


@pytest.mark.thorough
def test_the_floor_follows_the_brightness_of_the_training_images(scene, context):
    def level(train):
        out = evaluate.asset(context, scene.asset, scene.test, None, train, p=PARAMS)
        return out.metrics.values["floor"]["light_level"]

    brighter = replace(scene.train, images=scene.train.images * 2)
    assert np.isclose(level(brighter), 2 * level(scene.train), rtol=1e-5)


@pytest.mark.thorough
def test_an_asset_worse_than_the_texture_before_it_is_warned_of(scene, tmp_path):
    fast = evaluate.AssetParams(directions=64, bounces=0, max_views=1, supersampling=1, pictures=1)
    plain = evaluate.asset(FakeContext(tmp_path), scene.asset, scene.test, p=fast).metrics.values["held_out"]
    for shift, worse in ((3.0, True), (-3.0, False)):
        earlier = {"psnr": plain["psnr"], "exposure": plain["exposure"]}
        earlier["psnr_per_view"] = {name: value + shift for name, value in plain["psnr_per_view"].items()}
        context = FakeContext(tmp_path)
        before = Metrics({"held_out": earlier})
        values = evaluate.asset(context, scene.asset, scene.test, before=before, p=fast).metrics.values
        assert values["before"]["gain"] == pytest.approx(-shift)
        assert values["before"]["worse"] is worse
        assert any("below Stage I's texture" in text for text in context.warnings) is worse


@pytest.mark.thorough
def test_without_truth_only_held_out_views_are_scored(scene, context):
    out = evaluate.asset(context, scene.asset, scene.test, p=PARAMS)
    assert set(out.metrics.values) == {"headline", "floor", "held_out"}
    root = gallery.asset(context, scene.asset, out.scored).gallery.root
    files = {e["file"] for e in json.loads((root / "captions.json").read_text())}
    assert files == {
        "held_out_000.png", "held_out_002.png", "indirect.png", "environment.png", "atlas.png", "geometry.png",
        "model.glb",
    }  # fmt: skip


def unmasked(views, level=0.7):
    """The views with a bright wall behind the object, and nothing said of where that is."""
    wall = views.images + (1 - views.alpha[..., None]) * np.float32(level)
    return replace(views, images=wall, alpha=np.ones_like(views.alpha), has_masks=False)


def region_of(scene):
    """What the true masks and the true depth would give."""
    inside = scene.test.alpha > 0.99
    depth = depth_maps(Mesh(scene.asset.vertices, scene.asset.faces), scene.test).depth
    near, far = (np.where(inside, depth + shift, 0).astype(np.float32) for shift in (-0.05, 0.05))
    return Region(scene.test.names, inside, near, far)


@pytest.mark.thorough
def test_views_without_masks_are_scored_where_the_region_says(scene, context):
    values = evaluate.asset(
        context, scene.asset, unmasked(scene.test), region=region_of(scene), p=PARAMS
    ).metrics.values
    masked = evaluate.asset(context, scene.asset, scene.test, p=PARAMS).metrics.values
    # the bright wall behind the object must not raise the level of the floor's light
    assert np.isclose(values["floor"]["light_level"], masked["floor"]["light_level"], rtol=0.1)
    assert values["held_out"]["psnr"] > 25 > values["floor"]["held_out_psnr"]
    assert values["held_out"]["shares"]["covered"] == 1
    assert 0 < values["held_out"]["shares"]["leaked"] < 0.3  # the antialiased rim, which the region leaves out
    labels = [entry["label"] for entry in values["headline"]]
    assert labels[1:] == [
        "Region, share of the pictures",
        "Covered, share of the region",
        "Leaked, share of our surface",
    ]


def test_without_masks_and_region_the_held_out_views_say_what_counts(scene, context):
    with pytest.raises(DataError, match=r"no pixel of the held-out views counts|evaluate\.region"):
        evaluate.asset(context, scene.asset, unmasked(scene.test), p=PARAMS)  # three views, far apart


def test_a_region_of_other_views_is_refused(scene, context):
    other = replace(region_of(scene), names=("a", "b", "c"))
    with pytest.raises(DataError, match="misses view test_a"):
        evaluate.asset(context, scene.asset, unmasked(scene.test), region=other, p=PARAMS)


def test_the_pictures_show_what_is_missing_and_what_leaks(scene, context):
    half = Mesh(scene.asset.vertices, scene.asset.faces)
    carrier = replace(scene.asset, faces=half.faces[:4], uv_faces=scene.asset.uv_faces[:4])
    out = evaluate.stage1(context, carrier, scene.test, p=evaluate.Stage1Params(pictures=3))
    marks, covered = out.scored.marks, out.metrics.values["held_out"]["shares"]["covered"]
    assert 0.1 < covered < 0.9
    assert np.isclose((marks == 1).sum() / ((marks == 1) | (marks == 2)).sum(), covered, atol=0.05)
    root = gallery.stage1(context, carrier, out.scored).gallery.root
    holed = int(np.argmax((marks == 2).sum(axis=(1, 2))))
    picture = read_image(root / f"held_out_{holed:03d}.png")[:, -40:]
    missing = np.isclose(picture, [0.9, 0.1, 0.8], atol=0.01).all(-1)
    assert missing.sum() > 0.5 * (marks[holed] == 2).sum() > 0


@pytest.mark.thorough
def test_fewer_views_and_equal_figures_on_repeat(scene, context, tmp_path):
    p = PARAMS.model_copy(update={"max_views": 1})
    first = evaluate.asset(context, scene.asset, scene.test, scene.truth, p=p)
    root = gallery.asset(context, scene.asset, first.scored, scene.truth).gallery.root
    before = {f.name: f.read_bytes() for f in root.iterdir()}
    again = evaluate.asset(context, scene.asset, scene.test, scene.truth, p=p)
    assert list(first.metrics.values["held_out"]["psnr_per_view"]) == ["test_b"]
    assert first.metrics.values == again.metrics.values
    root = gallery.asset(context, scene.asset, again.scored, scene.truth).gallery.root
    assert before == {f.name: f.read_bytes() for f in root.iterdir()}


def test_chamfer_of_a_grown_octahedron_is_the_gap_between_its_faces(scene, context):
    grown = Mesh((scene.asset.vertices * 1.01).astype(np.float32), scene.asset.faces)
    values = evaluate.mesh(context, grown, scene.truth, p=evaluate.MeshParams(samples=4000)).metrics.values
    # the faces move by 0.01 of the inscribed radius, which is 1 / sqrt(3) of the bounding one
    expected = 10 / np.sqrt(3)
    assert np.isclose(values["chamfer_per_mille_of_radius"]["chamfer"], expected, rtol=0.03)
    headline = {entry["label"]: entry["value"] for entry in values["headline"]}
    assert headline["Closed"] is True
    assert headline["Manifold"] is True
    assert headline["Faces"] == 8


def test_an_open_mesh_and_a_missing_truth(scene, context):
    open_mesh = Mesh(scene.asset.vertices, scene.asset.faces[1:])
    values = evaluate.mesh(context, open_mesh, SceneTruth(names=()), p=evaluate.MeshParams()).metrics.values
    headline = {entry["label"]: entry["value"] for entry in values["headline"]}
    assert headline["Closed"] is False
    assert "Chamfer" not in headline


def test_stage_one_is_scored_by_its_texture(scene, context):
    from exmesh_graph.io.color import srgb_to_linear

    color = np.float32([0.8, 0.4, 0.2])
    carrier = replace(scene.asset, texture=np.broadcast_to(color, (32, 32, 3)).copy())
    flat = scene.test.alpha[..., None] * srgb_to_linear(color)
    views = replace(scene.test, images=flat.astype(np.float32))
    out = evaluate.stage1(context, carrier, views, p=evaluate.Stage1Params())
    assert out.metrics.values["held_out"]["psnr"] > 35  # 3 x 3 samples a pixel against 2 x 2 at the silhouette
    worse = evaluate.stage1(context, carrier, scene.test, p=evaluate.Stage1Params())
    assert worse.metrics.values["held_out"]["psnr"] < 25
    root = gallery.stage1(context, carrier, out.scored).gallery.root
    assert {"geometry.png", "texture.png", "held_out_000.png"} <= {file.name for file in root.iterdir()}
    assert read_glb(root / "model.glb")[0]["extensionsUsed"][-1] == "KHR_materials_unlit"


def test_without_masks_the_training_views_help_to_find_what_counts(scene, context, monkeypatch):
    """One held-out view alone has no parallax; with the others it has."""
    asked = []

    def find(views, train, settings, ground):
        asked.append(train)
        shape = views.alpha.shape
        return Region(views.names, np.ones(shape, bool), np.zeros(shape, np.float32), np.full(shape, 9, np.float32))

    monkeypatch.setattr("exmesh_graph.evaluate.region.find_region", find)
    bare = replace(scene.test, has_masks=False, alpha=np.ones_like(scene.test.alpha))
    carrier = replace(scene.asset, texture=np.full((32, 32, 3), 0.5, np.float32))
    evaluate.stage1(context, carrier, bare, train=scene.train, p=evaluate.Stage1Params(pictures=0))
    assert asked == [scene.train]


@pytest.mark.thorough
def test_no_pictures_asked_for_means_none_of_the_views(scene, context):
    p = PARAMS.model_copy(update={"max_views": 1, "pictures": 0})
    kinds = [pair["kind"] for pair in evaluate.asset(context, scene.asset, scene.test, p=p).scored.pairs]
    assert kinds == ["indirect"]


PICTURES = ("exmesh_graph.gallery", "exmesh_graph.report", "exmesh_graph.export", "exmesh_graph.edit")


@pytest.mark.thorough
@pytest.mark.parametrize("name", sorted(name for name in TYPES if name.startswith(("evaluate.", "benchmark."))))
def test_scores_do_not_depend_on_pages_pictures_or_exports(name):
    modules = fingerprint(TYPES[name]).modules
    assert [module for module in modules if module.startswith(PICTURES)] == []


CAPTIONS = """
import json, pathlib, sys
import exmesh_graph
from exmesh_graph.graph.cache.fingerprint import fingerprint
from exmesh_graph.graph.session import Session

def digests():
    with Session() as session:
        types = session.types.items()
        return {name: fingerprint(d).digest for name, d in types if name.startswith(("evaluate.", "gallery."))}

before, home = digests(), pathlib.Path(exmesh_graph.__file__).parent
assert home.is_relative_to(sys.argv[1])
for file, words in json.loads(sys.argv[2]).items():
    text = (home / file).read_text()
    assert words in text, file
    (home / file).write_text(text.replace(words, words + ", captioned anew"))
print(json.dumps([name for name, digest in digests().items() if digest != before[name]]))
"""


@pytest.mark.thorough
def test_a_caption_edit_leaves_the_scores_and_makes_the_pictures_anew(tmp_path):
    """On a copy of the sources: the keys of scores stay, those of pictures change."""
    for name in ("exmesh_graph", "nodes"):
        shutil.copytree(ROOT / name, tmp_path / name.replace("nodes", "exmesh_nodes"),
                        ignore=shutil.ignore_patterns("__pycache__", "vendor"))  # fmt: skip
    files = {"gallery/evaluation.py": "Held-out view", "gallery/rounds.py": "Above: from", "report/charts.py": "px"}
    words = [sys.executable, "-c", CAPTIONS, str(tmp_path), json.dumps(files)]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False,
                          env={**os.environ, "PYTHONPATH": str(tmp_path)})  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert set(json.loads(done.stdout)) == {"gallery.asset", "gallery.round", "gallery.stage1"}
