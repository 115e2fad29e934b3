"""A graph with a repeat block, and patches written as they stand in a file."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from exmesh_graph.graph.language.check import Checked
from exmesh_graph.graph.variants.checked import check_variant

BASE = """
name: toy
params: {n: 2, five: 5}
nodes:
  a: {type: toy.const, value: 2}
  b: {type: toy.const, value: "${five}"}
  start: {type: toy.add, a: "@a.number", b: "@b.number"}
  rounds:
    repeat: "${n}"
    carry: {state: "@start.number"}
    nodes:
      step: {type: toy.step, state: "@carry.state", at: {1: {amount: 3}}, every: {2: {type: toy.leap}}}
      hop: {type: toy.step, state: "@step.state", amount: 10}
    next: {state: "@hop.state"}
  end: {type: toy.add, a: "@rounds.state", b: "@rounds[1].step.state"}
  shown: {type: toy.metrics, number: "@end.number"}
outputs: {end: "@end.number"}
"""


@pytest.fixture
def base() -> str:
    return BASE


@pytest.fixture
def patched(bench: Any) -> Callable[..., Checked]:
    """`patched("{set: a.value, to: 3}", ...)`: the graph above after these patches."""

    def build(*patches: str, text: str = BASE, sets: tuple[str, ...] = ()) -> Checked:
        lines = "".join(f"\n    - {patch}" for patch in patches) or " []"
        return check_variant(bench.write(f"{text}variants:\n  v:{lines}\n"), sets, bench.packs, "v")

    return build


@pytest.fixture
def refusal(patched: Callable[..., Checked]) -> Callable[..., Any]:
    """The one problem of patches that are refused."""
    from exmesh_graph.graph.problems import GraphErrors

    def build(*patches: str, text: str = BASE) -> Any:
        with pytest.raises(GraphErrors) as caught:
            patched(*patches, text=text)
        assert len(caught.value.problems) == 1, str(caught.value)
        return caught.value.problems[0]

    return build
