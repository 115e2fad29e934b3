"""Gains per view, a known light, what each texel is known from, HDR beside LDR."""

import dataclasses

import numpy as np
import pytest
import torch

from exmesh_graph.errors import DataError
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.gains import Exposure
from exmesh_graph.stage2.gbuffer import Evidence
from exmesh_graph.stage2.init import neutral_asset
from exmesh_graph.stage2.result import texel_confidence
from exmesh_graph.stage2.settings import DecompositionSettings, StartSettings
from exmesh_graph.types.state import load_state, save_state

SETTINGS = DecompositionSettings(
    environment_height=8, iterations=160, material_rate=0.2, environment_rate=0.3, indirect_ramp=5, corrections=1,
    correction_samples=4, ssim_weight=0.0, material_weight=0.01, environment_weight=0.005,
    exposure=True,
)  # fmt: skip


def _exposed(views, gains):
    return dataclasses.replace(views, images=views.images * np.float32(gains)[:, None, None, None])


@pytest.mark.slow
def test_steps_of_exposure_are_found_and_do_not_reach_the_materials(carrier, train_views, transport):
    gains = np.array([1, 1, 1.6, 1, 0.6, 1, 1.2, 1])
    said = []
    asset, curves = fit(carrier, _exposed(train_views, gains), transport, SETTINGS, log=said.append)
    line = next(message for message in said if message.startswith("exposure"))
    found = np.array([float(part.split()[1]) for part in line.removeprefix("exposure found: ").split(", ")])
    assert np.median(found) == pytest.approx(1, abs=1e-3)
    np.testing.assert_allclose(found, gains, rtol=0.06)
    blind, plain = fit(carrier, _exposed(train_views, gains), transport, SETTINGS.replaced(exposure=False))
    assert np.mean(curves["image"][-5:]) < 0.5 * np.mean(plain["image"][-5:])
    seen = asset.seen
    even, _ = fit(carrier, train_views, transport, SETTINGS.replaced(exposure=False))

    def apart(other):
        ratio = other.base_color[seen] / even.base_color[seen]
        return np.abs(ratio / np.median(ratio) - 1).mean()

    assert apart(asset) < apart(blind)


@pytest.mark.thorough
def test_the_gains_are_part_of_a_checkpoint(carrier, train_views, transport, tmp_path):
    class CutOff(Exception):
        pass

    def checkpoint(now, state):
        if now == 12:
            save_state(tmp_path, state)
            raise CutOff

    settings = SETTINGS.replaced(iterations=24)
    views = _exposed(train_views, [1, 1, 1.6, 1, 0.6, 1, 1.2, 1])
    whole, _ = fit(carrier, views, transport, settings)
    with pytest.raises(CutOff):
        fit(carrier, views, transport, settings, checkpoint=checkpoint)
    again, _ = fit(carrier, views, transport, settings, resumed=(12, load_state(tmp_path)))
    assert again.base_color.tobytes() == whole.base_color.tobytes()


def test_gains_rest_at_first_and_ignore_what_is_dark_or_cut_off(carrier, train_views, transport):
    model = Decomposition(carrier, train_views, transport, SETTINGS, "cpu")
    buffer, exposure = model.buffers[0], Exposure(8)
    exposure.follow(buffer, buffer.target * 0.5, 0.01)
    assert float(exposure.gain(0)) == 1
    half = buffer.target * 0.5
    half[:20] *= 100  # highlights that the rendering has elsewhere
    for _ in range(40):
        exposure.follow(buffer, half * (exposure.logs[0]).exp(), 0.5)
    assert float(exposure.logs[0].exp()) == pytest.approx(2, rel=0.01)
    before = exposure.logs
    exposure.follow(dataclasses.replace(buffer, clipped=torch.ones_like(buffer.clipped)), half, 0.5)
    exposure.follow(buffer, half * 0, 0.5)
    assert torch.equal(before, exposure.logs)


def test_a_known_light_is_kept(carrier, train_views, transport, true_asset):
    settings = SETTINGS.replaced(environment_height=16, exposure=False, keep_light=True, iterations=60)
    with pytest.raises(DataError, match="keep_light keeps the start's environment"):
        Decomposition(carrier, train_views, transport, settings, "cpu")
    start = dataclasses.replace(
        neutral_asset(carrier, StartSettings(base_color="gray")), environment=true_asset.environment
    )
    asset, curves = fit(carrier, train_views, transport, settings, start=start)
    np.testing.assert_allclose(asset.environment, true_asset.environment, rtol=1e-5, atol=1e-5)
    error = np.abs(asset.base_color[asset.seen] / true_asset.base_color[asset.seen] - 1)
    assert np.median(error) < 0.1  # no common factor is left open
    assert curves["image"][-1] < 0.5 * curves["image"][0]


def test_confidence_grows_with_pixels_views_and_facing_and_is_0_where_texels_were_filled(
    carrier, train_views, transport
):
    asset, _ = fit(carrier, train_views, transport, SETTINGS.replaced(iterations=2, corrections=0))
    assert (asset.confidence[~asset.seen] == 0).all()
    assert (asset.confidence[asset.seen] > 0).all()
    assert asset.confidence.max() < 1
    few, _ = fit(
        carrier,
        dataclasses.replace(
            train_views, **{n: getattr(train_views, n)[:2] for n in ("names", "images", "alpha", "intrinsics",
                                                                    "camera_to_world")}
        ),
        transport,
        SETTINGS.replaced(iterations=2, corrections=0),
    )  # fmt: skip
    both = asset.seen & few.seen
    assert (few.confidence[both] <= asset.confidence[both] + 1e-6).mean() > 0.95

    def of(weight, cosine, views):
        return float(texel_confidence(Evidence(*(torch.tensor([float(x)]) for x in (weight, cosine, views)))))

    assert of(1, 1, 1) == pytest.approx(0.25)
    assert of(1, 1, 1) < of(4, 1, 1) < of(4, 1, 3)
    assert of(4, 0.2, 3) == pytest.approx(0.2 * of(4, 1, 3))
    assert of(0, 0, 0) == 0


@pytest.mark.slow
def test_hdr_photographs_hold_highlights_that_8_bit_ones_lose(carrier, train_views, transport, true_asset):
    """The same bright scene as floats and as 8-bit files: both fit, and the floats find the sun's side brighter."""
    bright = _exposed(train_views, [2.5] * 8)
    cut = dataclasses.replace(bright, images=np.minimum(bright.images, bright.alpha[..., None]), clipped=True)
    assert (cut.images < bright.images).mean() > 0.02
    settings = SETTINGS.replaced(exposure=False)
    skies = [fit(carrier, views, transport, settings)[0].environment for views in (bright, cut)]
    # the brightest value: over the median, which the albedo's scale moves too, the two differ by a hundredth
    assert skies[0].max() > 1.1 * skies[1].max()
    blind = dataclasses.replace(cut, clipped=False)  # an EXR that was clipped before: its top is taken for the truth
    dull = fit(carrier, blind, transport, settings)[0].environment
    assert dull.max() < 0.9 * skies[1].max()
