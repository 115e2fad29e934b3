"""No figure gets better by surface that goes, nor by a sheet: the sample with masks, without, and with masks of the
training views alone; the true asset and a poor one.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.blender import true_asset
from benchmarks.coarse_work import hull, load_scene
from benchmarks.metric_attacks import (
    _clustered,
    _picked,
    _random,
    figures,
    gains,
    poor_asset,
    settings_of,
    sheets,
    with_sheet,
    without,
)
from exmesh_graph.evaluate.coverage import compare_views, surface_depths
from exmesh_graph.stage2 import render
from exmesh_graph.types import Region

pytestmark = pytest.mark.thorough  # all of them, for what they share costs most

BARE = ["without masks", "training masks"]  # of the held-out views
SAMPLE = Path(__file__).parents[2] / "graphs" / "samples" / "spot"


@pytest.fixture(scope="module")
def scene():
    """The sample at 64 x 64: three held-out views and one light to relight with; and its views as a Case."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # the tensors are small: more threads only wait for one another
    loaded, case = load_scene(SAMPLE, 4, 0)
    light = sorted(loaded.truth.relit)[0]
    truth = replace(loaded.truth, relit={light: loaded.truth.relit[light]})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(render, "render_transport", partial(render.render_transport, points=300))
        yield replace(loaded, test=loaded.test.subset([1, 4, 6]), truth=truth), case
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def settings(scene):
    """By name."""
    cases = settings_of(scene[0].test, scene[0].train, scene[0].truth, quick=True)
    return {case.name: replace(case, samples=1000) for case in cases}


@pytest.fixture(scope="module")
def assets(scene):
    """The true surface, maps and light; and a coarse hull with the photographs' colours under white light."""
    true = true_asset(scene[0].truth)
    return {
        "true": replace(true, texture=np.clip(true.base_color, 0, 1) ** (1 / 2.2)),
        "poor": poor_asset(scene[0].train, hull(scene[1], 32), texels=64),
    }


@pytest.fixture(scope="module")
def base(assets, settings):
    """(asset, setting) -> figures of the whole asset, computed once."""
    known = {}

    def of(name, masks):
        if (name, masks) not in known:
            known[name, masks] = figures(assets[name], settings[masks])
        return known[name, masks]

    return of


@pytest.mark.parametrize("masks", ["with masks", *BARE])
@pytest.mark.parametrize("name", ["true", "poor"])
def test_no_figure_gets_better_by_faces_that_go(assets, settings, base, name, masks):
    asset = assets[name]
    assert gains(base(name, masks), figures(without(asset, _clustered(asset, 0.3, 0)), settings[masks])) == {}
    for gone in (_random(asset, 0.05, 0), _in_sight(asset, settings[masks].test, 0.3)):
        after = figures(without(asset, gone), settings[masks])
        assert gains(base(name, masks), after) == {}
        assert after["Held-out PSNR"][0] < base(name, masks)["Held-out PSNR"][0] - 0.3


def _in_sight(asset, views, share):
    """The faces nearest to where each view meets the mesh first."""
    middle = asset.vertices[asset.faces].mean(axis=1)
    places = [middle[np.linalg.norm(middle - eye, axis=1).argmin()] for eye in views.camera_to_world[:, :3, 3]]
    away = np.linalg.norm(middle[:, None] - np.stack(places), axis=-1).min(axis=1)
    return away <= np.quantile(away, share)


@pytest.mark.parametrize("masks", ["with masks", *BARE])
@pytest.mark.parametrize(("name", "kind"), [("true", "wall"), ("poor", "floor"), ("poor", "roof out of sight")])
def test_no_figure_gets_better_by_a_sheet(assets, settings, base, name, kind, masks):
    asset, setting = assets[name], settings[masks]
    sheet = sheets(asset, setting.test)[kind]
    assert gains(base(name, masks), figures(with_sheet(asset, sheet, setting), setting)) == {}


@pytest.mark.parametrize("masks", BARE)
@pytest.mark.parametrize("kind", ["floor", "wall"])
def test_no_figure_of_half_an_asset_gets_better_by_a_sheet_behind(assets, settings, kind, masks):
    setting = settings[masks]
    half = without(assets["poor"], _random(assets["poor"], 0.5, 0))
    sheet = sheets(half, setting.test)[kind]
    assert gains(figures(half, setting), figures(with_sheet(half, sheet, setting), setting)) == {}


@pytest.mark.parametrize("masks", BARE)
@pytest.mark.parametrize("name", ["true", "poor"])
def test_not_even_faces_picked_by_the_photographs_pay(assets, settings, base, name, masks):
    asset, setting = assets[name], settings[masks]
    gone = _picked(asset, setting)
    assert 0 < gone.mean() < 0.5
    assert gains(base(name, setting.name), figures(without(asset, gone), setting)) == {}


def test_without_masks_no_pixel_gets_better_by_what_goes(assets, settings):
    """Whatever is drawn and whichever pixels lose their surface: random pictures, dark photographs too."""
    asset, plain = assets["true"], settings["without masks"]
    depth = surface_depths(asset, plain.test)  # where the photographs' own depth errs, deletion may well mend a pixel
    near, far = (np.where(depth > 0, depth + shift, 0).astype(np.float32) for shift in (-0.1, 0.1))
    region = Region(plain.test.names, depth > 0, near, far)
    rng = np.random.default_rng(0)
    for level in (0.02, 1.0):
        views = replace(plain.test, images=plain.test.images * np.float32(level))
        ours = [rng.random((*views.alpha.shape[1:], 3)).astype(np.float32) for _ in range(len(views))]
        whole = compare_views(ours, list(views.alpha), asset, views, range(len(views)), region)
        fewer = without(asset, _random(asset, 0.3, 0))
        less = compare_views(ours, list(views.alpha), fewer, views, range(len(views)), region)
        assert all(a >= b for a, b in zip(whole.psnr, less.psnr, strict=True))
        assert np.mean(less.covered) < np.mean(whole.covered)


@pytest.mark.parametrize(("masks", "share", "beside"), [("without masks", 0.4, 0.1), ("training masks", 0.7, 0.01)])
def test_the_region_of_the_stripped_sample_lies_on_the_object(settings, masks, share, beside):
    true, found = settings["with masks"].test.alpha > 0.5, settings[masks].region.inside
    assert (found & true).sum() > share * true.sum()
    assert (found & ~true).sum() < beside * found.sum()
