"""Toy nodes with several outputs: a solver that also tells its history."""

from __future__ import annotations

from typing import NamedTuple

from exmesh_graph.graph import Context, Params, node, param
from exmesh_graph.types import Metrics
from toy_pack.nodes import NoParams, Number, NumberOut


class SolvedOut(NamedTuple):
    number: Number
    history: Metrics


@node("toy.solve", version="1")
def solve(ctx: Context, number: Number, *, p: NoParams) -> SolvedOut:
    """Half of a number, and how it came to that."""
    return SolvedOut(Number(number.value / 2), Metrics({"steps": [number.value, number.value / 2]}))


class CutParams(Params):
    parts: int = param(3, ge=0, doc="How many.")


class PartsOut(NamedTuple):
    parts: list[Number]
    count: Number


class PiecesOut(NamedTuple):
    wrong: list[Number]


@node("toy.cut", version="1")
def cut(ctx: Context, number: Number, *, p: CutParams) -> PartsOut:
    """As many parts as a number says, or the parameter where it is 0: 1, 2, 3, ..."""
    count = int(number.value) or p.parts
    return PartsOut([Number(float(n)) for n in range(1, count + 1)], Number(float(count)))


class MaybeOut(NamedTuple):
    above: Number | None
    below: Number | None


class MaybeParams(Params):
    limit: float = param(0.0, doc="Above it, or not.")


@node("toy.maybe", version="1")
def maybe(ctx: Context, number: Number, *, p: MaybeParams) -> MaybeOut:
    """The number, at the one output or at the other."""
    return MaybeOut(number, None) if number.value > p.limit else MaybeOut(None, number)


@node("toy.wrong_list", version="1")
def wrong_list(ctx: Context, *, p: NoParams) -> PiecesOut:
    """A list that holds something else."""
    return PiecesOut([1.0])  # type: ignore[list-item]


@node("toy.gather", version="1")
def gather(ctx: Context, numbers: list[Number], more: tuple[Number, ...] | None = None, *, p: NoParams) -> NumberOut:
    """The numbers read as digits, so that their order counts; -1 where `more` was left out."""
    value = 0.0
    for number in (*numbers, *(more if more is not None else (Number(-1.0),))):
        value = 10 * value + number.value
    return NumberOut(Number(value))
