"""The memory that a fit announces: it follows sizes and budget, and counts what the buffers really take."""

import pytest

from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.memory import buffer_budget, plan_memory
from exmesh_graph.stage2.settings import DecompositionSettings

SETTINGS = DecompositionSettings(environment_height=8, iterations=2)


def test_the_plan_counts_the_buffers_and_follows_the_budget(carrier, train_views, transport):
    plan = plan_memory(carrier, train_views, transport, SETTINGS, before=2**30)
    buffers = Decomposition(carrier, train_views, transport, SETTINGS, "cpu").buffers
    assert plan.parts["view buffers"] == pytest.approx(sum(buffers.sizes), rel=0.25)
    assert plan.held == plan.views == 8
    assert plan.total == 2**30 + sum(plan.parts.values())
    mapped = SETTINGS.replaced(normal_map=True)
    bent = plan_memory(carrier, train_views, transport, mapped)
    vectors = Decomposition(carrier, train_views, transport, mapped, "cpu").light.vectors
    entries = sum(matrix.values().numel() for matrix in vectors.gather)
    added = vectors.transfer.numel() * 4 + 12 * entries
    assert bent.parts["light transport"] - plan.parts["light transport"] == pytest.approx(added, rel=0.05)
    assert bent.parts["maps and their optimiser"] > plan.parts["maps and their optimiser"]
    tight = plan_memory(
        carrier, train_views, transport, SETTINGS.replaced(memory_gib=0.5 * sum(buffers.sizes) / 2**30), before=2**30
    )
    assert 0 < tight.held < 8
    assert tight.total < plan.total
    assert "made at each visit" in str(tight)
    assert "made at each visit" not in str(plan)
    large = plan_memory(carrier, train_views, transport, SETTINGS.replaced(texture_size=2048))
    assert large.parts["maps and their optimiser"] > 5 * plan.parts["maps and their optimiser"]
    assert large.figures()["total"] == pytest.approx(large.total / 2**30, abs=1e-3)


@pytest.mark.parametrize(("free", "budget"), [(3.0, 4.0), (20.0, 10.0), (0.0, 4.0)])
def test_without_a_bound_half_of_what_is_free_is_taken(monkeypatch, free, budget):
    monkeypatch.setattr("exmesh_graph.stage2.memory.memory_to_spare", lambda: int(free * 2**30))
    assert buffer_budget(SETTINGS) == budget * 2**30
    assert buffer_budget(SETTINGS.replaced(memory_gib=0.5)) == 2**29
    assert buffer_budget(SETTINGS.replaced(memory_gib=0)) == 0


def test_a_bound_is_a_number_or_auto():
    with pytest.raises(ValueError, match="memory_gib"):
        DecompositionSettings(memory_gib=-1)
    with pytest.raises(ValueError, match="memory_gib"):
        DecompositionSettings(memory_gib="much")
