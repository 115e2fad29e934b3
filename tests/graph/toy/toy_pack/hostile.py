"""Nodes that change what is not theirs: inputs behind numpy's back, buffers that they gave away, files of inputs."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import field_validator

from exmesh_graph.errors import DataError
from exmesh_graph.graph import Context, Params, node, param
from exmesh_graph.types import Files
from toy_pack.nodes import NoParams, Number, NumberOut, Series, SeriesOut

_BUFFER: dict[int, Any] = {}


class SizeParams(Params):
    size: int = param(100_000, ge=1, doc="Elements.")
    value: float = param(1.0, doc="Of each element.")


class SpotParams(Params):
    index: int = param(0, ge=0, doc="Element to write into.")
    fail: bool = param(False, doc="Raise afterwards.")


class DegreeParams(Params):
    angle: float = param(90.0, doc="In degrees; the validator turns it into half of it.")

    @field_validator("angle")
    @classmethod
    def _half(cls, value: float) -> float:
        return value / 2


class FolderParams(Params):
    path: Path = param(doc="A folder of numbers.")


@node("toy.large", version="1")
def large(ctx: Context, number: Number, *, p: SizeParams) -> SeriesOut:
    """An array of one value."""
    import numpy as np

    return SeriesOut(Series(np.full(p.size, p.value, np.float32)))


@node("toy.reuse", version="1")
def reuse(ctx: Context, number: Number, *, p: SizeParams) -> SeriesOut:
    """An array in a buffer that the next call writes into."""
    import numpy as np

    buffer = _BUFFER.setdefault(p.size, np.zeros(p.size, np.float32))
    buffer[:] = p.value
    return SeriesOut(Series(buffer[:]))


@node("toy.spot", version="1")
def spot(ctx: Context, series: Series, *, p: SpotParams) -> NumberOut:
    """Writes into one element of its input as native code does."""
    import ctypes

    ctypes.cast(series.data.ctypes.data, ctypes.POINTER(ctypes.c_float))[p.index] = 99.0
    if p.fail:
        raise DataError("failed after writing")
    return NumberOut(Number(0.0))


@node("toy.total", version="1")
def total(ctx: Context, series: Series, *, p: NoParams) -> NumberOut:
    """The sum of an array."""
    return NumberOut(Number(float(series.data.sum(dtype=float))))


@node("toy.deface", version="1")
def deface(ctx: Context, files: Files, *, p: NoParams) -> NumberOut:
    """Writes into a file of its input."""
    path = files.root / files.main
    path.chmod(0o644)
    path.write_text("9.0")
    return NumberOut(Number(0.0))


@node("toy.degrees", version="1")
def degrees(ctx: Context, *, p: DegreeParams) -> NumberOut:
    """What its validator made of the angle."""
    return NumberOut(Number(p.angle))


def numbers_in(p: FolderParams) -> dict[str, Path]:
    return {path.name: path for path in sorted(p.path.glob("*.txt"))}


@node("toy.sum_folder", version="1", sources=numbers_in)
def sum_folder(ctx: Context, *, p: FolderParams) -> NumberOut:
    """The sum of the numbers in a folder; a file `grow` in it makes it grow before it is read."""
    if (p.path / "grow").exists():
        (p.path / "late.txt").write_text("100")
    return NumberOut(Number(sum(float(path.read_text()) for path in sorted(p.path.glob("*.txt")))))


class PathsParams(Params):
    what: list[tuple[Path, float]] | Literal["studio", "sunset"] | None = param(None, doc="Built in, or files.")


@node("toy.paths", version="1", sources=lambda p: {})
def paths(ctx: Context, *, p: PathsParams) -> NumberOut:
    """Nothing of what it is told."""
    return NumberOut(Number(0.0))
