"""Held-out photographs whose exposure wanders: one factor per photograph and channel is fitted on request, and said."""

from dataclasses import replace

import numpy as np
import pytest
from exmesh_nodes import evaluate

from exmesh_graph.evaluate.carrier import score_carrier
from exmesh_graph.evaluate.coverage import compare_views, surface_depths
from exmesh_graph.io.color import srgb_to_linear
from exmesh_graph.stage1.render import render_carrier
from exmesh_graph.testing import FakeContext, carrier, views
from exmesh_graph.types import Region, Views

FACTORS = ([1.0, 1.0, 1.0], [0.8, 0.7, 0.9], [0.9, 0.9, 0.6])


def photographs() -> Views:
    """Of a ball, each under an exposure of its own."""
    seen = views(carrier(), 3, 48, split="test")
    shown, alpha = render_carrier(carrier(), seen)
    taken = shown * np.array(FACTORS, np.float32)[:, None, None, :]
    linear = srgb_to_linear(np.clip(taken / np.maximum(alpha, 1e-6)[..., None], 0, 1)) * alpha[..., None]
    return replace(seen, images=linear.astype(np.float32), alpha=alpha)


def test_the_factors_are_found_and_said():
    seen = photographs()
    fixed = score_carrier(carrier(), seen).values
    fitted = score_carrier(carrier(), seen, exposure="fitted").values
    assert fitted["held_out"]["psnr"] > fixed["held_out"]["psnr"] + 10
    assert fitted["held_out"]["psnr_as_exposed"] == pytest.approx(fixed["held_out"]["psnr"])
    assert fitted["headline"][0]["label"] == "Held-out PSNR, Stage I, exposure fitted"
    assert fixed["held_out"]["exposure"] == "as it is"
    for name, factors in zip(seen.names, FACTORS, strict=True):
        assert fitted["held_out"]["exposures_per_view"][name] == pytest.approx(factors, abs=0.02)


def test_without_masks_only_what_counts_and_is_covered_has_a_say():
    seen = photographs()
    bare = replace(
        seen, images=seen.images + 0.3 * (1 - seen.alpha[..., None]), alpha=np.ones_like(seen.alpha), has_masks=False
    )
    depth = surface_depths(carrier(), seen)
    inside = (depth > 0) & (seen.alpha == 1)
    region = Region(seen.names, inside, np.where(inside, depth - 0.1, 0), np.where(inside, depth + 0.1, 0), "depth")
    shown, alpha = render_carrier(carrier(), bare, blended=False)
    found = compare_views(list(shown), list(alpha), carrier(), bare, range(3), region, "fitted")
    assert found.exposures is not None
    np.testing.assert_allclose(found.exposures, FACTORS, atol=0.02)
    assert min(found.psnr) > 35


def test_deleting_surface_gains_nothing_by_its_exposure():
    """What remains could be fitted better alone; what is missing costs more than that."""
    seen = photographs()
    whole = score_carrier(carrier(), seen, exposure="fitted").values["held_out"]["psnr"]
    faces, _ = np.split(np.arange(len(carrier().faces)), [9 * len(carrier().faces) // 10])
    fewer = replace(carrier(), faces=carrier().faces[faces], uv_faces=carrier().uv_faces[faces])
    assert score_carrier(fewer, seen, exposure="fitted").values["held_out"]["psnr"] < whole


def test_the_node_takes_it(tmp_path):
    out = evaluate.stage1(FakeContext(tmp_path), carrier(), photographs(), p=evaluate.Stage1Params(exposure="fitted"))
    assert "exposures_per_view" in out.metrics.values["held_out"]
