"""No figure gets better by surface that goes, nor by a sheet: the sample with its masks and without."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.blender import true_asset
from benchmarks.metric_attacks import (
    _clustered,
    _picked,
    _random,
    _sheets,
    figures,
    gains,
    settings_of,
    with_sheet,
    without,
)
from exmesh_graph.evaluate.coverage import compare_views
from exmesh_graph.io.blender import load_blender
from exmesh_graph.io.settings import BlenderOptions
from exmesh_graph.stage2 import render

SAMPLE = Path(__file__).parents[2] / "graphs" / "samples" / "spot"


@pytest.fixture(scope="module")
def subject():
    """(the true asset, with masks, without, the figures of both) at 64 x 64."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # the tensors are small: more threads only wait for one another
    scene = load_blender(SAMPLE, BlenderOptions(downscale=4))
    asset = true_asset(scene.truth)
    asset = replace(asset, texture=np.clip(asset.base_color, 0, 1) ** (1 / 2.2))
    cases = settings_of(scene.test, scene.train, scene.truth, quick=True)
    masked, plain = (replace(case, samples=4000) for case in cases)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(render, "render_transport", partial(render.render_transport, points=300))
        yield asset, masked, plain, {id(s): figures(asset, s) for s in (masked, plain)}
    torch.set_num_threads(threads)


@pytest.mark.parametrize("masks", [True, False], ids=["masks", "no masks"])
def test_deleting_faces_raises_no_figure(subject, masks):
    asset, masked, plain, base = subject
    setting = masked if masks else plain
    for gone in (_random(asset, 0.05, 0), _random(asset, 0.95, 2), _clustered(asset, 0.3, 0)):
        after = figures(without(asset, gone), setting)
        assert gains(base[id(setting)], after) == {}
        assert after["Held-out PSNR"][0] < base[id(setting)]["Held-out PSNR"][0] - 1


@pytest.mark.parametrize("masks", [True, False], ids=["masks", "no masks"])
def test_a_sheet_raises_no_figure(subject, masks):
    asset, masked, plain, base = subject
    setting = masked if masks else plain
    holed = without(asset, _random(asset, 0.5, 0))
    before = figures(holed, setting)
    for corners in _sheets(setting.test).values():
        assert gains(base[id(setting)], figures(with_sheet(asset, corners, setting), setting)) == {}
        assert gains(before, figures(with_sheet(holed, corners, setting), setting)) == {}


def test_without_masks_not_even_faces_picked_by_the_photographs_pay(subject):
    asset, _, plain, base = subject
    gone = _picked(asset, plain)
    assert 0 < gone.mean() < 0.5
    assert gains(base[id(plain)], figures(without(asset, gone), plain)) == {}


def test_without_masks_no_pixel_gets_better_by_what_goes(subject):
    """Whatever is drawn and whichever pixels lose their surface: random pictures, dark photographs too."""
    asset, _, plain, _ = subject
    rng = np.random.default_rng(0)
    for level in (0.02, 1.0):
        views = replace(plain.test, images=plain.test.images * np.float32(level))
        ours = [rng.random((*views.alpha.shape[1:], 3)).astype(np.float32) for _ in range(len(views))]
        whole = compare_views(ours, list(views.alpha), asset, views, range(len(views)), plain.region)
        fewer = without(asset, _random(asset, 0.3, 0))
        less = compare_views(ours, list(views.alpha), fewer, views, range(len(views)), plain.region)
        assert all(a >= b for a, b in zip(whole.psnr, less.psnr, strict=True))
        assert np.mean(less.covered) < np.mean(whole.covered)


def test_the_region_of_the_stripped_sample_lies_on_the_object(subject):
    _, masked, plain, _ = subject
    true, found = masked.test.alpha > 0.5, plain.region.inside
    assert (found & true).sum() > 0.4 * true.sum()
    assert (found & ~true).sum() < 0.1 * found.sum()
