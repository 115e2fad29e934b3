"""scene.probe and the parameters it decides."""

import pytest
from exmesh_nodes import probe, stage2, transport
from pydantic import ValidationError

from exmesh_graph.errors import DataError
from exmesh_graph.shading.settings import BounceSettings, TransportSettings
from exmesh_graph.stage2.probe import scene as probe_scene
from exmesh_graph.stage2.probe import short
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import Decision, SceneNeeds, decided, with_decisions


def _needs(**values):
    return SceneNeeds({name: Decision(value, 1.0, 0.1, 1.1, "So.") for name, value in values.items()})


def test_the_node_decides_and_says_so(scene, monkeypatch):
    monkeypatch.setattr(probe_scene, "BASE_STEPS", 4)
    monkeypatch.setattr(probe_scene, "STEPS", 4)
    monkeypatch.setattr(probe_scene, "LONG_STEPS", 8)
    monkeypatch.setattr(probe_scene, "SKIES", (16,))
    monkeypatch.setattr(short, "TRANSPORT", short.TRANSPORT.replaced(points=100))
    monkeypatch.setattr(short, "SHORT", short.SHORT.replaced(environment_height=8))
    context = FakeContext()
    found = probe.probe(context, scene.asset, scene.train, p=probe.ProbeParams())
    assert found.needs.decisions["bounces"].value == 0  # an octahedron
    assert [row["name"] for row in found.decisions.values["decisions"]] == list(found.needs.decisions)
    assert any(line.startswith("metallic: ") for line in context.lines)
    steps, total = context.steps[-1]
    assert steps == total


def test_no_bounces_hand_the_direct_light_on(scene):
    context = FakeContext()
    light = transport.direct(context, scene.asset, p=TransportSettings(directions=16, points=20)).transport
    automatic = BounceSettings(bounces="auto")
    assert transport.bounce(context, light, _needs(bounces=0), p=automatic).transport is light
    assert transport.bounce(context, light, _needs(bounces=3), p=automatic).transport.bounces == 3
    assert transport.bounce(context, light, p=BounceSettings()).transport.bounces == 1
    with pytest.raises(DataError, match=r"bounces is auto[\s\S]*@probe.needs"):
        transport.bounce(context, light, p=automatic)


def test_the_fit_takes_what_was_decided(scene):
    context = FakeContext()
    light = transport.direct(context, scene.asset, p=TransportSettings(directions=16, points=20)).transport
    auto = stage2.FitParams(
        metallic="auto", texture_size="auto", environment_height="auto", iterations=2, corrections=0
    )
    needs = _needs(metallic=True, texture_size=64, environment_height=16)
    made = stage2.fit(context, scene.asset, scene.train, light, needs=needs, p=auto).asset
    assert made.metallic is not None
    assert made.base_color.shape == (64, 64, 3)
    assert made.environment.shape == (16, 32, 3)
    with pytest.raises(DataError, match="auto"):
        stage2.fit(context, scene.asset, scene.train, light, p=auto)


def test_the_monte_carlo_light_takes_its_technique():
    light = transport.MonteCarlo(technique="auto")
    assert with_decisions(light, _needs(technique="mis")).technique == "mis"
    with pytest.raises(DataError, match="technique is auto"):
        with_decisions(light, None)


def test_what_was_not_looked_at_is_said():
    with pytest.raises(DataError, match=r"nothing about normal_map[\s\S]*metallic"):
        decided("auto", _needs(metallic=True), "normal_map")
    assert decided(3, None, "bounces") == 3
    assert decided("mis", None, "technique") == "mis"


def test_a_decision_is_validated_like_a_value_in_the_graph():
    auto = BounceSettings(bounces="auto", secondary_material=False)
    assert with_decisions(auto, _needs(bounces=2)) == auto.replaced(bounces=2)
    with pytest.raises(ValidationError, match="less than or equal to 16"):
        with_decisions(auto, _needs(bounces=17))
    with pytest.raises(DataError, match="bounces is auto"):
        with_decisions(auto, None)
