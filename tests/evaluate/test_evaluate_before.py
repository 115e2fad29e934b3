"""A finished asset beside the Stage I texture that it began with: what counts as worse, and what is said."""

from types import SimpleNamespace

import numpy as np
import pytest

from exmesh_graph.evaluate.before import set_beside


def _values(db, exposure="as it is"):
    per_view = {f"{k:03d}": value for k, value in enumerate(db)}
    return {"held_out": {"psnr": float(np.mean(db or [0])), "psnr_per_view": per_view, "exposure": exposure}}


def _asset(maps, texture=8):
    return SimpleNamespace(base_color=np.zeros((maps, maps, 3)), texture=np.zeros((texture, texture, 3)))


def test_a_clear_fall_is_told_with_its_cause():
    found = set_beside(_values([30.0, 31.0, 32.1]), _values([31.0, 32.1, 33.0]), _asset(4))
    assert found["worse"]
    assert found["gain"] == pytest.approx(-1.0, abs=1e-9)
    assert found["error"] == pytest.approx(np.std([-1.0, -1.1, -0.9], ddof=1) / np.sqrt(3))
    assert "4 texels a side, the texture 8" in found["warning"]
    assert "maps are as fine" in set_beside(_values([30.0]), _values([31.0]), _asset(8))["warning"]


def test_noise_small_falls_and_gains_are_not_worse():
    for now in ([29.0, 33.0, 31.0, 30.0], [30.95, 31.95, 32.95, 29.95], [35.0, 35.0, 35.0, 35.0]):
        found = set_beside(_values(now), _values([31.0, 32.0, 33.0, 30.0]), _asset(4))
        assert not found["worse"]
        assert "warning" not in found


def test_only_views_that_both_scored_by_one_rule_count():
    assert set_beside(_values([30.0, 10.0]), _values([30.0]), _asset(4))["views"] == 1
    assert set_beside(_values([]), _values([30.0]), _asset(4)) == {}
    assert set_beside(_values([30.0]), _values([40.0], "fitted"), _asset(4)) == {}


def test_colours_that_change_with_the_direction_are_beside_the_texture_baked_from_them():
    before = _values([33.0, 34.0])
    before["held_out"]["psnr_baked"] = 31.5
    found = set_beside(_values([32.0, 33.0]), before, _asset(8))
    assert found["gain"] == pytest.approx(1.0)
    assert not found["worse"]
