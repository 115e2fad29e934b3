"""Toy nodes with several outputs: a solver that also tells its history."""

from __future__ import annotations

from typing import NamedTuple

from exmesh_graph.graph import Context, node
from exmesh_graph.types import Metrics
from toy_pack.nodes import NoParams, Number


class SolvedOut(NamedTuple):
    number: Number
    history: Metrics


@node("toy.solve", version="1")
def solve(ctx: Context, number: Number, *, p: NoParams) -> SolvedOut:
    """Half of a number, and how it came to that."""
    return SolvedOut(Number(number.value / 2), Metrics({"steps": [number.value, number.value / 2]}))
