"""stage2.retouch: a finished asset's materials and light, fitted again on the shape that it has now."""

from dataclasses import replace

import numpy as np
import pytest
from exmesh_nodes import stage2
from pydantic import ValidationError

from exmesh_graph.errors import DataError
from exmesh_graph.stage2.settings import RetouchSettings
from exmesh_graph.testing import FakeContext, asset, carrier, sky, views
from exmesh_graph.types import Asset, Decision, Metrics, SceneNeeds

SHORT = {"directions": 64, "points": 800, "correction_samples": 4}


def ball(**changes):
    """A ball that shines, under a sky of one bright, broad side, and what is known of it."""
    return asset(carrier(rings=12, sectors=16), **{"roughness": 0.3, "environment": sky(16), **changes})


def retouched(of, p, needs=None):
    return stage2.retouch(FakeContext(node="retouch", seed=3), of, views(ball(), 8, 48), needs, p=p)


def test_none_leaves_the_asset():
    one = ball()
    same, history = retouched(one, stage2.RetouchParams(iterations=0))
    assert same is one
    assert history.values == {}


def test_materials_come_nearer_and_maps_and_sky_keep_their_sizes():
    found, history = retouched(
        ball(roughness=0.5), stage2.RetouchParams(iterations=150, corrections=1, material_weight=0.01, **SHORT)
    )
    assert isinstance(history, Metrics)
    curve = history.values["curves"]["psnr"]
    assert np.mean(curve[-3:]) > np.mean(curve[:3]) + 0.5
    one = ball()
    assert found.base_color.shape == one.base_color.shape
    assert found.environment.shape == one.environment.shape
    assert np.abs(found.roughness - 0.3)[found.seen].mean() < 0.15


def test_the_probe_says_how_often_light_bounces():
    needs = SceneNeeds({"bounces": Decision(1, 1.0, 0.1, 1.0, "")})
    p = stage2.RetouchParams(iterations=2, corrections=0, bounces="auto", **SHORT)
    assert isinstance(retouched(ball(), p, needs)[0], Asset)
    with pytest.raises(DataError, match="bounces"):
        retouched(ball(), p, SceneNeeds({}))


def test_what_the_asset_has_is_modelled_at_its_sizes():
    one = ball()
    settings = RetouchSettings(palette_width=0.2).of(one)
    assert (settings.texture_size, settings.environment_height) == (len(one.base_color), len(one.environment))
    assert (settings.metallic, settings.normal_map, settings.palette_width) == (False, False, 0.2)
    metal = replace(one, metallic=np.full_like(one.roughness, 0.5))
    assert RetouchSettings().of(metal).metallic
    p = stage2.RetouchParams(iterations=2, corrections=0, **SHORT)
    assert retouched(metal, p)[0].metallic is not None
    assert retouched(one, p)[0].metallic is None


@pytest.mark.parametrize("bad", [{"iterations": -1}, {"material_rate": 0}, {"metallic": True}])
def test_bad_parameters_are_refused(bad):
    with pytest.raises(ValidationError):
        stage2.RetouchParams(**bad)
