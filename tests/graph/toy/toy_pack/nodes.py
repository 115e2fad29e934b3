"""A node pack for the tests of the framework: numbers instead of meshes."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple, Self

from exmesh_graph.errors import DataError
from exmesh_graph.graph import Context, Params, facets, node, param
from exmesh_graph.types import Artifact, Files, Metrics, load_arrays, save_arrays
from toy_pack.helpers import sign_of

if TYPE_CHECKING:
    import numpy as np


@dataclass(frozen=True, eq=False)
class Number(Artifact):
    """A number with a split, as views have one."""

    type_name: ClassVar[str] = "Number"
    value: float
    split: str = "train"

    def facets(self) -> dict[str, Any]:
        return {"split": self.split, "positive": self.value > 0}

    def save(self, folder: Path) -> None:
        text = json.dumps({"value": self.value.hex(), "split": self.split})
        (folder / "number.json").write_text(text)

    @classmethod
    def load(cls, folder: Path) -> Self:
        raw = json.loads((folder / "number.json").read_text())
        return cls(float.fromhex(raw["value"]), raw["split"])


@dataclass(frozen=True, eq=False)
class Whole(Number):
    """A whole number: fits where a Number is asked for."""

    type_name: ClassVar[str] = "Whole"


@dataclass(frozen=True, eq=False)
class Series(Artifact):
    """An array, to watch memory and in-place changes."""

    type_name: ClassVar[str] = "Series"
    data: np.ndarray

    def save(self, folder: Path) -> None:
        save_arrays(folder, {"data": self.data})

    @classmethod
    def load(cls, folder: Path) -> Self:
        return cls(load_arrays(folder)[0]["data"])


class NumberOut(NamedTuple):
    number: Number


class WholeOut(NamedTuple):
    number: Whole


class SplitOut(NamedTuple):
    train: Annotated[Number, facets(split="train")]
    test: Annotated[Number, facets(split="test")]


class StateOut(NamedTuple):
    state: Number


class MetricsOut(NamedTuple):
    metrics: Metrics


class FilesOut(NamedTuple):
    files: Files


class SeriesOut(NamedTuple):
    series: Series


class ConstParams(Params):
    value: float = param(1.0, ge=-1000, le=1000, unit="apples", doc="The number.")
    threads: int = param(1, ge=1, doc="Cannot change the result.", tuning=True)
    label: str = param("", doc="Free text.", was="text")


class NoParams(Params):
    pass


class FileParams(Params):
    path: Path = param(doc="A text file with a number.")


class StepParams(Params):
    amount: float = param(1.0, doc="Added to the state.")


class LeapParams(Params):
    factor: float = param(2.0, doc="Multiplies the state.")


class SlowParams(Params):
    seconds: float = param(0.1, ge=0, unit="s", doc="How long to take.")
    steps: int = param(10, ge=1, doc="Progress steps.")


@node("toy.const", version="1", was="toy.constant")
def const(ctx: Context, *, p: ConstParams) -> NumberOut:
    """A constant."""
    return NumberOut(Number(p.value))


@node("toy.whole", version="1")
def whole(ctx: Context, *, p: ConstParams) -> WholeOut:
    """A constant without its fraction."""
    return WholeOut(Whole(float(int(p.value))))


def number_file(p: FileParams) -> dict[str, Path]:
    if not p.path.is_file():
        raise DataError("no such number file", where=str(p.path))
    return {"number": p.path}


@node("toy.file", version="1", sources=number_file)
def read(ctx: Context, *, p: FileParams) -> NumberOut:
    """A number out of a file."""
    return NumberOut(Number(float(p.path.read_text())))


@node("toy.split", version="1")
def split(ctx: Context, number: Number, *, p: NoParams) -> SplitOut:
    """A number as train and as test."""
    return SplitOut(Number(number.value, "train"), Number(number.value, "test"))


@node("toy.add", version="1")
def add(ctx: Context, a: Number, b: Number | None = None, *, p: NoParams) -> NumberOut:
    """a + b."""
    return NumberOut(Number(a.value + (0.0 if b is None else b.value)))


@node("toy.subtract", version="1")
def subtract(ctx: Context, a: Number, b: Number, *, p: NoParams) -> NumberOut:
    """a - b."""
    return NumberOut(Number(a.value - b.value))


@node("toy.sign", version="1")
def sign(ctx: Context, number: Number, *, p: NoParams) -> NumberOut:
    """1 or -1: many inputs, few outputs."""
    return NumberOut(Number(sign_of(number.value)))


@node("toy.train_only", version="1")
def train_only(ctx: Context, number: Annotated[Number, facets(split="train")], *, p: NoParams) -> NumberOut:
    """Wants a train number."""
    return NumberOut(Number(number.value))


@node("toy.whole_only", version="1")
def whole_only(ctx: Context, number: Whole, *, p: NoParams) -> WholeOut:
    """Wants a whole number."""
    return WholeOut(Whole(number.value))


@node("toy.liar", version="1")
def liar(ctx: Context, number: Number, *, p: NoParams) -> SplitOut:
    """Breaks its promise on the split."""
    return SplitOut(Number(number.value, "test"), Number(number.value, "test"))


@node("toy.step", version="1")
def step(ctx: Context, state: Number, *, p: StepParams) -> StateOut:
    """state + amount."""
    return StateOut(Number(state.value + p.amount))


@node("toy.leap", version="1")
def leap(ctx: Context, state: Number, *, p: LeapParams) -> StateOut:
    """state * factor."""
    return StateOut(Number(state.value * p.factor))


@node("toy.seeded", version="1", deterministic=True)
def seeded(ctx: Context, number: Number, *, p: NoParams) -> NumberOut:
    """number + seed."""
    return NumberOut(Number(number.value + ctx.seed))


@node("toy.slow", version="1")
def slow(ctx: Context, number: Number, *, p: SlowParams) -> NumberOut:
    """Takes its time, with progress."""
    for index in range(p.steps):
        time.sleep(p.seconds / p.steps)
        ctx.progress(index + 1, p.steps, loss=1.0 / (index + 1))
    return NumberOut(Number(number.value))


@node("toy.fail", version="1")
def fail(ctx: Context, number: Number, *, p: ConstParams) -> NumberOut:
    """Fails when its input is not above `value`."""
    ctx.warn("about to compare")
    if number.value <= p.value:
        raise DataError("the number is too small", where="toy", expected=f"above {p.value}", fix="raise it")
    return NumberOut(Number(number.value))


@node("toy.metrics", version="1")
def metrics(ctx: Context, number: Number, *, p: NoParams) -> MetricsOut:
    """The number as a figure."""
    return MetricsOut(Metrics({"value": number.value}))


@node("toy.score", version="1")
def score(ctx: Context, number: Number, *, p: NoParams) -> MetricsOut:
    """The number as a headline figure."""
    figure = {"label": "Value", "value": number.value, "unit": "apples", "better": "higher"}
    return MetricsOut(Metrics({"headline": [figure]}))


@node("toy.folder", version="1")
def folder(ctx: Context, number: Number, *, p: NoParams) -> FilesOut:
    """The number as files."""
    root = ctx.scratch / "out"
    (root / "parts").mkdir(parents=True)
    (root / "number.txt").write_text(str(number.value))
    (root / "parts" / "half.txt").write_text(str(number.value / 2))
    return FilesOut(Files(root, main="number.txt"))


@node("toy.read_folder", version="1")
def read_folder(ctx: Context, files: Files, *, p: NoParams) -> NumberOut:
    """Reads the files back."""
    return NumberOut(Number(float((files.root / files.main).read_text())))


@node("toy.series", version="1")
def series(ctx: Context, number: Number, *, p: NoParams) -> SeriesOut:
    """An array."""
    import numpy as np

    return SeriesOut(Series(np.full(1000, number.value, dtype=np.float32)))


@node("toy.scribble", version="1")
def scribble(ctx: Context, series: Series, *, p: NoParams) -> SeriesOut:
    """Writes into its input, around numpy's write protection."""
    import ctypes

    ctypes.memset(series.data.ctypes.data, 0, series.data.nbytes)
    return SeriesOut(Series(series.data.copy()))


@node("toy.meddle", version="1")
def meddle(ctx: Context, metrics: Metrics, *, p: NoParams) -> MetricsOut:
    """Writes into a dict of its input, where numpy protects nothing."""
    metrics.values["value"] = 1506.0
    return MetricsOut(Metrics(dict(metrics.values)))


class HeadlineParams(Params):
    headline: Any = param(doc="Of the metrics, sound or not.")


@node("toy.headline", version="1")
def headline(ctx: Context, *, p: HeadlineParams) -> MetricsOut:
    """Metrics with a headline of any shape."""
    return MetricsOut(Metrics({"headline": p.headline}))


@node("toy.test_number", version="1")
def test_number(ctx: Context, *, p: NoParams) -> NumberOut:
    """A number of the test split, not promised as such."""
    return NumberOut(Number(1.0, "test"))


class ShiftParams(Params):
    by: float = param(1.0, doc="Added to the number.")


@node("toy.shift", version="1")
def shift(ctx: Context, number: Number, *, p: ShiftParams) -> NumberOut:
    """number + by."""
    return NumberOut(Number(number.value + p.by))
