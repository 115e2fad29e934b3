"""mask.files, mask.from_surface, init.object and mask.auto: what they hand on, and that they say so."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from exmesh_nodes import mask, prior

from exmesh_graph.errors import DataError
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.graph.declare.packs import load_packs
from exmesh_graph.io.blender import load_blender
from exmesh_graph.io.images import write_image
from exmesh_graph.io.settings import BlenderOptions
from exmesh_graph.raster import rasterize
from exmesh_graph.report.page import decision_tables
from exmesh_graph.testing import FakeContext, depth_maps, look_at
from exmesh_graph.types import DepthMaps, Mesh, PointCloud, Views

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "graphs" / "samples" / "spot"
SMALL = {"resolution": 64, "band": 4}


@pytest.fixture(scope="module")
def ball():
    """A speckled reddish ball before a speckled grey wall, eight views of 48 x 48, no masks; and what it is."""
    vertices, faces = icosphere(3, 0.4)
    size, turns = 48, 2 * np.pi * np.arange(8) / 8
    eyes = 2.5 * np.stack([np.sin(turns), np.full(8, 0.4), np.cos(turns)], axis=1)
    k = np.repeat(np.array([[[1.6 * size, 0, size / 2], [0, 1.6 * size, size / 2], [0, 0, 1]]]), 8, axis=0)
    blank = np.ones((8, size, size), np.float32)
    views = Views(tuple(f"v{i}" for i in range(8)), np.repeat(blank[..., None], 3, -1), blank, k,
                  np.stack([look_at(eye) for eye in eyes]), "train", has_masks=False)  # fmt: skip
    mesh = Mesh(vertices, faces)
    depths = depth_maps(mesh, views)
    colours = np.where((depths.depth > 0)[..., None], [0.6, 0.1, 0.1], 0.3)
    speckles = np.random.default_rng(0).uniform(0.6, 1.4, (8, size, size, 1))
    return replace(views, images=(colours * speckles).astype(np.float32)), depths, mesh


def overlap(views, depths):
    inside, truth = np.asarray(views.alpha) >= 0.5, depths.depth > 0
    return (inside & truth).sum() / (inside | truth).sum()


def test_masks_from_files_are_what_a_loader_makes_of_them(tmp_path):
    """The sample as its loader reads it, from opaque pictures and masks beside them."""
    masked = load_blender(SAMPLE, BlenderOptions(max_views=3, downscale=4)).train
    straight = np.where(masked.alpha[..., None] > 0, masked.images / np.maximum(masked.alpha, 1e-6)[..., None], 0.5)
    opaque = replace(masked, images=straight.astype(np.float32), alpha=np.ones_like(masked.alpha), has_masks=False)
    for name, alpha in zip(masked.names, masked.alpha, strict=True):
        write_image(tmp_path / f"{name}.png", alpha, "uint16")
    out = mask.files(FakeContext(tmp_path), opaque, p=mask.FilesParams(path=tmp_path)).views
    assert out.facets() == {"split": "train", "masks": True}
    assert out.alpha == pytest.approx(masked.alpha, abs=1e-4)
    assert out.images == pytest.approx(masked.images, abs=1e-4)
    assert set(load_packs().types["mask.files"].sources(mask.FilesParams(path=tmp_path))) == {
        f"{name}.png" for name in masked.names
    }


def test_a_surface_gives_masks_and_views_beside_it_are_left_out(ball):
    views, depths, mesh = ball
    context = FakeContext()
    rough = Mesh(1.12 * mesh.vertices, mesh.faces)
    out = mask.from_surface(context, views, rough, p=mask.SurfaceParams(band=4)).views
    assert overlap(out, depths) > 0.95
    assert (out.images == views.images * out.alpha[..., None]).all()
    assert context.steps[-1] == (8, 8)
    poses = views.camera_to_world.copy()
    poses[2, :3, 3] += [0, 90, 0]
    out = mask.from_surface(context, replace(views, camera_to_world=poses), rough, p=mask.SurfaceParams(band=4)).views
    assert out.names == tuple(f"v{i}" for i in range(8) if i != 2)
    assert "1 of 8 views do not show the surface and are left out: v2" in context.warnings[0]


def test_the_object_of_depth_maps_is_closed(ball):
    views, depths, _ = ball
    context = FakeContext()
    out = mask.object_(context, views, None, depths, p=mask.ObjectParams(resolution=64))
    assert out.mesh.facets()["closed"]
    assert out.mesh.facets()["manifold"]
    reach = np.linalg.norm(out.mesh.vertices, axis=1)
    assert np.median(reach) == pytest.approx(0.4, abs=0.04)
    assert reach.max() < 0.7  # the cones of a hull above and below a ring of cameras
    assert context.lines[-1].startswith("table: none. No plane was found")


def test_stereo_looks_in_a_wider_world_and_its_depths_come_back(ball, monkeypatch):
    views, depths, _ = ball
    seen = []

    def stereo(ctx, wide, points, *, p):
        seen.append((wide.camera_to_world, points.points, p.side))
        return prior.DepthOut(DepthMaps(depths.names, depths.depth / np.float32(1.5)))

    monkeypatch.setattr(prior, "patch_match", stereo)
    cloud = PointCloud(np.ones((2, 3), np.float32), np.ones((2, 3), np.float32))
    p = mask.ObjectParams(resolution=64, reach=1.5, side=200)
    found = mask.object_(FakeContext(), views, cloud, p=p).mesh
    given = mask.object_(FakeContext(), views, None, depths, p=p).mesh
    assert found.vertices == pytest.approx(given.vertices, abs=0.02)
    poses, points, side = seen[0]
    assert poses[:, :3, 3] * 1.5 == pytest.approx(views.camera_to_world[:, :3, 3])
    assert poses[:, :3, :3] == pytest.approx(views.camera_to_world[:, :3, :3])
    assert points == pytest.approx(cloud.points / 1.5)
    assert side == 200


def decided(context, views, **parameters):
    out = mask.auto(context, views, p=mask.AutoParams(**SMALL, **parameters))
    (table,) = decision_tables({"views.decisions": out.decisions.values}).values()
    return out.train, table[0]


def test_views_with_masks_are_handed_on(ball, monkeypatch):
    monkeypatch.setattr(prior, "patch_match", None)
    views, depths, _ = ball
    masked = replace(views, alpha=(depths.depth > 0).astype(np.float32), has_masks=True)
    context = FakeContext()
    train, row = decided(context, masked)
    assert train is masked
    assert (row["value"], row["reason"]) == ("given", "The views have masks: none are looked for.")
    some = replace(masked, alpha=np.where(np.arange(8)[:, None, None] < 6, masked.alpha, 1).astype(np.float32))
    assert "2 lack theirs" in decided(context, some)[1]["reason"]
    assert not context.warnings
    assert decided(context, views, find=False)[0] is views
    assert mask.auto(context, masked, p=mask.AutoParams()).depths is None


def test_masks_are_found_where_an_object_stands_apart(ball, monkeypatch):
    views, depths, _ = ball
    monkeypatch.setattr(mask, "_stereo", lambda *_: depths)
    context = FakeContext()
    train, row = decided(context, views)
    assert row["value"] == "found"
    assert "100% of the views and their common shape overlap by 9" in row["reason"]
    assert train.masked.all()
    assert overlap(train, depths) > 0.93
    assert not context.warnings
    assert context.lines[0] == f"masks: found. {row['reason']}"


@pytest.mark.parametrize(
    ("parameters", "because"),
    [
        ({"least_apart": 1.0}, r"(?s)goes on beyond their pictures \(least_apart 1\)"),
        ({"least_overlap": 1.0}, r"overlap by 9[0-9]% \(least_overlap 1\)"),
        ({"table": "remove"}, "no plane was found"),
    ],
)
def test_where_a_check_fails_the_views_stay_as_they_came_and_that_is_said(ball, monkeypatch, parameters, because):
    views, depths, _ = ball
    monkeypatch.setattr(mask, "_stereo", lambda *_: depths)
    if "least_apart" in parameters:
        two = replace(depths, depth=depth_of_two(views))
        monkeypatch.setattr(mask, "_stereo", lambda *_: two)
    context = FakeContext()
    train, row = decided(context, views, **parameters)
    assert train is views
    assert row["value"] == "none"
    assert re.search(because, row["reason"])
    assert "mask.files" in row["reason"]
    assert row["reason"] in context.warnings[0]


def depth_of_two(views):
    """Depth [N, H, W] of the ball and one that half of the pictures show."""
    vertices, faces = icosphere(3, 0.4)
    beside = icosphere(3, 0.3)[0] + np.array([0.9, 0, 0], np.float32)
    both = np.concatenate([vertices, beside]).astype(np.float32)
    all_faces = np.concatenate([faces, faces + len(vertices)]).astype(np.int32)
    cameras = torch.from_numpy(views.intrinsics), torch.from_numpy(views.world_to_camera)
    return rasterize(torch.from_numpy(both), torch.from_numpy(all_faces), *cameras, 48, 48).depth.numpy()


def test_no_depth_at_all_is_told_and_views_go_on(ball, monkeypatch):
    views, depths, _ = ball
    monkeypatch.setattr(mask, "_stereo", lambda *_: replace(depths, depth=0 * depths.depth))
    context = FakeContext()
    train, row = decided(context, views)
    assert train is views
    assert "gave no surface" in row["reason"]
    assert mask.auto(context, views, p=mask.AutoParams(**SMALL)).depths is None
    assert len(context.warnings) == 2


def test_outlines_without_a_common_part_are_told_and_views_go_on(ball, monkeypatch):
    from exmesh_graph.masks import object as room

    def nothing(*_, **__):
        raise DataError("the silhouettes of 8 views have no common part")

    views, depths, _ = ball
    monkeypatch.setattr(mask, "_stereo", lambda *_: depths)
    monkeypatch.setattr(room, "visual_hull", nothing)
    train, row = decided(FakeContext(), views)
    assert train is views
    assert "no common part" in row["reason"]


def test_found_masks_are_no_input_of_what_is_scored():
    """Held-out views, the region and the scores come from the photographs as they were loaded, and from masks that a
    node of its own finds in them: what `masked` is told changes nothing of it."""
    from ruamel.yaml import YAML

    import exmesh_graph as ex

    nodes = ex.check(ROOT / "graphs" / "quickstart.yaml").nodes
    assert nodes["masked"].definition.type == "mask.auto"
    assert str(nodes["coarse"].inputs["views"]) == "@masked.train"
    for name in ("look", "score"):
        assert [str(nodes[name].inputs[port]) for port in ("views", "train")] == ["@views.test", "@views.train"], name
    assert str(nodes["rounds[1].progress"].inputs["views"]) == "@views.test"
    photos = YAML(typ="safe").load((ROOT / "graphs" / "photos.yaml").read_text())["nodes"]
    assert (photos["region"]["views"], photos["region"]["train"]) == ("@views.test", "@judged.train")
    assert photos["judged"] == {"type": "mask.auto", "views": "@views.train", "points": "@views.points"}


def test_the_depth_that_stereo_found_goes_on_with_the_views_that_it_belongs_to(ball, monkeypatch):
    views, depths, _ = ball
    poses = views.camera_to_world.copy()
    poses[2, :3, 3] += [0, 90, 0]
    away = replace(views, camera_to_world=poses)
    blind = np.where(np.arange(8)[:, None, None] == 2, np.float32(0), depths.depth)
    monkeypatch.setattr(mask, "_stereo", lambda *_: replace(depths, depth=blind))
    out = mask.auto(FakeContext(), away, p=mask.AutoParams(**SMALL, least_seen=0.5))
    assert out.train.names == out.depths.names == tuple(f"v{i}" for i in range(8) if i != 2)
    np.testing.assert_array_equal(out.depths.depth, depths.depth[[0, 1, 3, 4, 5, 6, 7]])
    out.depths.require_of(out.train, "here")


def test_masks_on_masks_are_refused(ball, tmp_path):
    views, depths, _ = ball
    masked = replace(views, alpha=(depths.depth > 0).astype(np.float32), has_masks=True)
    for name in views.names:
        write_image(tmp_path / f"{name}.png", np.ones((48, 48), np.float32))
    with pytest.raises(DataError, match="have masks already"):
        mask.files(FakeContext(tmp_path), masked, p=mask.FilesParams(path=tmp_path))
