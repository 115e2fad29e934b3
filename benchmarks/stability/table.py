"""What a row is, and how rows are collected, run and printed."""

from __future__ import annotations

import importlib
import importlib.util
import math
import pkgutil
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from typing import NamedTuple


class Reached(NamedTuple):
    """A row's figure, reached in float32 and in float64 (or by an analytic value); None where one does not exist."""

    float32: float | None
    float64: float | None = None


@dataclass(frozen=True)
class Row:
    """One hazard.

    room       "raster", "texture", ...: the first words of the table, selected by --only
    hazard     what goes wrong elsewhere, and on which input
    figure     what is measured
    low, high  the figure must lie in [low, high], in both precisions
    measure    the function that reaches it; None for a row that belongs to another issue, named in `elsewhere`
    needs      modules without which the row cannot run (it is then shown as skipped, not as passed)
    slow       takes more than about a second: not part of --quick and of the tests
    """

    room: str
    hazard: str
    figure: str
    low: float
    high: float
    measure: Callable[[], Reached] | None
    needs: tuple[str, ...] = ()
    slow: bool = False
    elsewhere: str = ""

    @property
    def name(self) -> str:
        return f"{self.room}: {self.hazard}"

    @property
    def expected(self) -> str:
        if self.low == self.high:
            return f"= {self.high:g}"
        if math.isinf(self.low):
            return f"<= {self.high:g}"
        return f">= {self.low:g}" if math.isinf(self.high) else f"{self.low:g} .. {self.high:g}"


@dataclass(frozen=True)
class Outcome:
    """A row after its run; `verdict` is "pass", "miss", "skipped" or "elsewhere", `note` says why."""

    room: str
    hazard: str
    figure: str
    expected: str
    float32: float | None
    float64: float | None
    verdict: str
    note: str
    seconds: float


_ROWS: list[Row] = []


def row(
    room: str,
    hazard: str,
    figure: str,
    *,
    low: float = -math.inf,
    high: float = math.inf,
    needs: tuple[str, ...] = (),
    slow: bool = False,
) -> Callable[[Callable[[], Reached]], Callable[[], Reached]]:
    """Decorator: the function reaches the row's figure, `Reached(in float32, in float64 or analytically)`.

    @row("raster", "camera inside a closed surface", "share of uncovered pixels", high=0)
    def inside() -> Reached: ...
    """
    if math.isinf(low) and math.isinf(high):
        raise ValueError(f"{room}: {hazard}: a row without bounds cannot fail")

    def register(measure: Callable[[], Reached]) -> Callable[[], Reached]:
        _ROWS.append(Row(room, hazard, figure, low, high, measure, needs, slow))
        return measure

    return register


def elsewhere(room: str, hazard: str, figure: str, where: str) -> None:
    """A hazard whose subject is built or tested in another place: listed with that place, never counted as passed."""
    _ROWS.append(Row(room, hazard, figure, math.nan, math.nan, None, elsewhere=where))


def collect() -> list[Row]:
    """All rows of the modules `rows_*.py`, those of a room together."""
    package = importlib.import_module(__package__)
    for found in sorted(pkgutil.iter_modules(package.__path__), key=lambda m: m.name):
        if found.name.startswith("rows_"):
            importlib.import_module(f"{__package__}.{found.name}")
    names = [r.name for r in _ROWS]
    doubled = sorted({name for name in names if names.count(name) > 1})
    if doubled:
        raise ValueError(f"two stability rows of the same name: {', '.join(doubled)}")
    rooms = list(dict.fromkeys(r.room for r in _ROWS))
    return sorted(_ROWS, key=lambda r: rooms.index(r.room))


def run(row: Row) -> Outcome:
    """Run one row. A row that raises is a miss that says so."""
    began = time.perf_counter()
    reached, verdict, note = Reached(None), "", ""
    missing = [name for name in row.needs if importlib.util.find_spec(name) is None]
    if row.measure is None:
        verdict, note = "elsewhere", row.elsewhere
    elif missing:
        verdict, note = "skipped", f"needs {', '.join(missing)}"
    else:
        try:
            reached = row.measure()
        except Exception as error:  # the table must go on; the miss carries the message
            verdict, note = "miss", f"{type(error).__name__}: {error}"
        else:
            values = [value for value in reached if value is not None]
            verdict = "pass" if values and all(row.low <= value <= row.high for value in values) else "miss"
    seconds = time.perf_counter() - began
    return Outcome(row.room, row.hazard, row.figure, row.expected, *reached, verdict, note, seconds)


def show(outcomes: Iterable[Outcome]) -> str:
    """The table as text."""
    heads = ("room", "hazard", "figure", "expected", "float32", "float64", "")
    lines = [heads]
    for o in outcomes:
        last = o.verdict + (f" ({o.note})" if o.note else "")
        expected = "" if o.verdict == "elsewhere" else o.expected
        lines.append((o.room, o.hazard, o.figure, expected, _number(o.float32), _number(o.float64), last))
    widths = [max(len(line[k]) for line in lines) for k in range(len(heads) - 1)] + [0]
    return "\n".join("  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip() for line in lines)


def record(outcomes: Iterable[Outcome]) -> list[dict[str, object]]:
    """Plain values for JSON; figures that are not finite become text."""
    return [
        {k: repr(v) if isinstance(v, float) and not math.isfinite(v) else v for k, v in asdict(o).items()}
        for o in outcomes
    ]


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
