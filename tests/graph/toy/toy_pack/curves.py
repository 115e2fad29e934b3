"""Toy components: curves that plug into a node which evaluates them."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from exmesh_graph.graph import Component, Context, Params, component, facets, node, param
from exmesh_graph.params import Auto, Takes
from toy_pack.helpers import sign_of
from toy_pack.nodes import Number, NumberOut, Series, Whole


class Curve(Component):
    """What a port of type Curve takes."""

    def value(self, x: float) -> float:
        """The curve at x."""
        raise NotImplementedError


class Noise(Component):
    """Another kind of component, which is no curve."""


@component("curve.line", version="1")
class Line(Curve):
    """slope * x."""

    slope: float = param(1.0, ge=-10, le=10, unit="per x", doc="Rise per x.")
    chunk: int = param(1, ge=1, doc="Cannot change the result.", tuning=True)

    def value(self, x: float) -> float:
        return self.slope * x


@component("curve.sign", version="1")
class Sign(Curve):
    """The sign of x, from a helper module."""

    def value(self, x: float) -> float:
        return sign_of(x)


@component("curve.sum", version="1")
class Sum(Curve):
    """Two curves added; the second is optional."""

    first: Curve
    second: Curve | None = None
    scale: float = param(1.0, doc="Multiplies the sum.")

    def value(self, x: float) -> float:
        rest = 0.0 if self.second is None else self.second.value(x)
        return self.scale * (self.first.value(x) + rest)


@component("curve.steep", version="1")
class Steep(Curve):
    """A line whose slope the node may decide that it plugs into."""

    slope: Annotated[int, Field(ge=1), Auto("inner")] = param(1, doc="Rise per x.")

    def value(self, x: float) -> float:
        return self.slope * x


@component("noise.none", version="1")
class NoNoise(Noise):
    """No noise."""


class NoParams(Params):
    pass


@node("toy.evaluate", version="1")
def evaluate(
    ctx: Context, number: Number, curve: Curve, extra: Curve | Noise | None = None, *, p: NoParams
) -> NumberOut:
    """The curve at a number, plus the extra curve."""
    more = extra.value(number.value) if isinstance(extra, Curve) else 0.0
    return NumberOut(Number(curve.value(number.value) + more))


@node("toy.either", version="1")
def either(
    ctx: Context, item: Annotated[Whole | Series, facets(split="train")] | None = None, *, p: NoParams
) -> NumberOut:
    """A whole number or a series, of the training split where they have one."""
    if item is None:
        return NumberOut(Number(0.0))
    return NumberOut(Number(item.value if isinstance(item, Whole) else float(item.data.sum())))


class CountedParams(Params):
    count: Annotated[int, Field(ge=1, le=9), Auto("judge")] = param(1, doc="How many.")
    flag: Annotated[bool, Auto("judge")] = param(False, doc="Whether.")


@node("toy.counted", version="1")
def counted(ctx: Context, judge: Number | None = None, *, p: CountedParams) -> NumberOut:
    """The count, or what the judge says."""
    return NumberOut(judge if judge is not None and str(p.count) == "auto" else Number(float(p.count)))


@node("toy.mixed", version="1")
def mixed(ctx: Context, item: Number | Curve, inner: Number | None = None, *, p: NoParams) -> NumberOut:
    """A number as it is, or a curve at another number."""
    if isinstance(item, Curve):
        return NumberOut(Number(item.value(0.0 if inner is None else inner.value)))
    return NumberOut(item)


class LeaningParams(Params):
    lean: Annotated[bool, Auto("judge"), Takes("ground")] = param(False, doc="Whether to lean on the ground.")


@node("toy.leaning", version="1")
def leaning(ctx: Context, judge: Number | None = None, ground: Number | None = None, *, p: LeaningParams) -> NumberOut:
    """The ground's number, or 0."""
    return NumberOut(ground if p.lean and ground is not None else Number(0.0))
