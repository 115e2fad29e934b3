"""Which surface casts light in a score: the object and its table do, a sheet that the pictures refute does not."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from exmesh_graph import testing
from exmesh_graph.evaluate.asset import score_asset
from exmesh_graph.evaluate.casting import casting_faces, casting_share
from exmesh_graph.evaluate.settings import Quality
from exmesh_graph.stage2 import render
from exmesh_graph.stage2.render import render_transport, render_views
from exmesh_graph.types import Mesh, Region

SQUARE = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]], np.float32)
SHEETS = {
    "a floor": SQUARE * 1.5 - [0, 1.05, 0],
    "a roof": SQUARE * 3 + [0, 6, 0],
    "a wall": (SQUARE * 1.5)[:, [0, 2, 1]] - [0, 0, 1.05],
    "a patch that hovers": SQUARE * 0.05 + [0, 0.8, 0],
    "one from the middle outwards": SQUARE * 2,
}


@pytest.fixture(scope="module")
def ball():
    return testing.asset(roughness=0.3)


@pytest.fixture(scope="module")
def views(ball):
    return testing.views(ball, split="test")


def with_sheet(asset, corners):
    """The asset and a square of its first texel."""
    first = len(asset.vertices)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32) + first
    return replace(
        asset,
        vertices=np.concatenate([asset.vertices, np.asarray(corners, np.float32)]),
        faces=np.concatenate([asset.faces, faces]),
        uv_faces=np.concatenate([asset.uv_faces, np.zeros((2, 3), np.int32)]),
    )


def unmasked(views):
    return replace(views, alpha=np.ones_like(views.alpha), has_masks=False)


def region_of(surface, views):
    """The region that the true depth of `surface` gives."""
    depth = testing.depth_maps(Mesh(surface.vertices, surface.faces), views).depth
    near, far = (np.where(depth > 0, depth + shift, 0).astype(np.float32) for shift in (-0.1, 0.1))
    return Region(views.names, depth > 0, near, far)


@pytest.mark.parametrize("sheet", SHEETS)
@pytest.mark.parametrize("masks", [True, False], ids=["masks", "no masks"])
def test_the_object_casts_light_and_a_sheet_does_not(ball, views, sheet, masks):
    seen_by, region = (views, None) if masks else (unmasked(views), region_of(ball, views))
    assert casting_faces(ball, seen_by, region) is None
    both = with_sheet(ball, SHEETS[sheet])
    casts = casting_faces(both, seen_by, region)
    assert casts[:-2].all()
    assert not casts[-2:].any()
    assert casting_share(ball, None) == 1
    assert 0 < casting_share(both, casts) < 1


def test_a_table_whose_depth_the_photographs_confirm_casts_light(ball, views):
    standing = with_sheet(ball, SQUARE * 0.8 - [0, 0.62, 0])
    region = region_of(standing, views)
    assert casting_faces(standing, unmasked(views), region) is None
    casts = casting_faces(with_sheet(standing, SHEETS["a roof"]), unmasked(views), region)
    assert casts[:-2].all()
    assert not casts[-2:].any()


def test_faces_that_cast_no_light_are_seen_and_change_nothing_else(ball, views):
    both = with_sheet(ball, SHEETS["a floor"])
    casts = np.arange(len(both.faces)) < len(ball.faces)
    camera = views.intrinsics[:2], views.camera_to_world[:2], 48, 48
    settings = {"bounces": 1, "supersampling": 1, "specular_samples": 4}

    def picture(asset, which):
        return render_views(
            asset, *camera, transport=render_transport(asset, 1, 64, 400, casts=which), casts=which, **settings
        )

    alone, added, shading = picture(ball, None), picture(both, casts), picture(both, None)
    inside = alone.alpha > 0
    np.testing.assert_array_equal(added.images[inside], alone.images[inside])
    assert np.abs(shading.images[inside] - alone.images[inside]).max() > 0.01
    assert (added.alpha > 0).sum() > 1.2 * inside.sum()


def test_no_figure_without_masks_moves_by_a_sheet_that_shades_only(ball, views, monkeypatch):
    """An asset under light that is too bright would gain by a floor that keeps some of it off."""
    monkeypatch.setattr(render, "render_transport", partial(render_transport, points=300))
    bright = replace(ball, environment=ball.environment * np.float32(1.6))
    region, quality = region_of(ball, views), Quality(directions=64, bounces=1, specular_samples=2)

    def figures(asset):
        return score_asset(asset, unmasked(views), max_views=2, quality=quality, region=region).values["held_out"]

    both = with_sheet(bright, SHEETS["a floor"])
    before, after = figures(bright), figures(both)
    assert abs(after["psnr"] - before["psnr"]) < 1e-6
    assert abs(after["ssim"] - before["ssim"]) < 1e-6
    assert after["shares"]["leaked"] > before["shares"]["leaked"]
    assert before["casting"] == 1 > after["casting"]
    monkeypatch.setattr("exmesh_graph.evaluate.asset.casting_faces", lambda *_: None)
    assert figures(both)["psnr"] > before["psnr"] + 0.05
