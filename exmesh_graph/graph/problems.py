"""Where a value was written, and everything that is wrong with a graph, collected before any of it is reported.

Invariant: a check never stops at its first finding; `Problems.raise_if_any` reports all of them at once.
"""

from __future__ import annotations

import contextlib
import difflib
import functools
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn

from exmesh_graph.errors import GraphError


@dataclass(frozen=True)
class Where:
    """A line of a graph file; `file` is None for the command line, `via` is where a sub-graph is used."""

    file: Path | None
    line: int = 0
    via: Where | None = None

    def __str__(self) -> str:
        if self.file is None:
            return "command line"
        place = f"{_shown(self.file, os.getcwd())}:{self.line}"
        return place if self.via is None else f"{place} (used at {self.via})"

    @property
    def base(self) -> Path:
        """The folder that relative paths written here start from."""
        return Path.cwd() if self.file is None else self.file.parent


@functools.lru_cache(maxsize=256)
def _shown(file: Path, folder: str) -> str:
    shown = os.path.relpath(file, folder)
    return str(file) if shown.startswith(".." + os.sep + "..") else shown


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong: code, place, both ends of the wire, expected and found, candidates, fix."""

    code: str
    where: Where
    what: str
    wire: str = ""
    expected: str = ""
    found: str = ""
    nearest: tuple[str, ...] = ()
    fix: str = ""
    rounds: int = 1

    def __str__(self) -> str:
        more = f" (and in {self.rounds - 1} more rounds)" if self.rounds > 1 else ""
        told = {label: getattr(self, label) for label in ("wire", "expected", "found", "nearest", "fix")}
        told["nearest"] = ", ".join(self.nearest)
        lines = [f"    {label}: {text}" for label, text in told.items() if text]
        return "\n".join([f"{self.where}: [{self.code}] {self.what}{more}", *lines])


class GraphErrors(GraphError):
    """Every problem of a graph at once."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))


@dataclass
class Problems:
    """A growing list of problems; the same finding in several unrolled rounds is kept once, with a count."""

    noted: dict[tuple[str, ...], Problem] = field(default_factory=dict)

    def add(self, code: str, where: Where, what: str, *, nearest: Iterable[str] = (), **more: Any) -> None:
        """Note one problem; `more` are Problem's wire, expected, found and fix."""
        key = (code, str(where), without_rounds(what))
        seen = self.noted.get(key) or Problem(code, where, what, nearest=tuple(nearest), rounds=0, **more)
        self.noted[key] = replace(seen, rounds=seen.rounds + 1)

    @contextlib.contextmanager
    def caught(self) -> Iterator[None]:
        """Note what is raised in here, and go on after it."""
        try:
            yield
        except GraphErrors as error:
            self.noted.update({(p.code, str(p.where), p.what): p for p in error.problems})

    def __bool__(self) -> bool:
        return bool(self.noted)

    def raise_if_any(self) -> None:
        """Raise GraphErrors with all problems, in the order of the file."""
        if self.noted:
            order = sorted(self.noted.values(), key=lambda p: (str(p.where.file), p.where.line))
            raise GraphErrors(order)


def fail(code: str, where: Where, what: str, *, nearest: Iterable[str] = (), **more: Any) -> NoReturn:
    """Raise at once: for files so broken that nothing after this place can be judged."""
    raise GraphErrors([Problem(code, where, what, nearest=tuple(nearest), **more)])


def nearest(name: str, candidates: Iterable[str], count: int = 3) -> list[str]:
    """The candidates that look most like `name`, best first."""
    names = list(dict.fromkeys(candidates))
    close = difflib.get_close_matches(name, names, n=count, cutoff=0.55)
    tails = [c for c in names if c.rsplit(".", 1)[-1] == name.rsplit(".", 1)[-1] and c not in close]
    return (close + tails)[:count]


def closest(name: object, candidates: Iterable[str]) -> list[str]:
    """The candidates that look most like `name`; all of them where none does."""
    names = list(dict.fromkeys(candidates))
    return nearest(str(name), names) or names


def in_short(words: Sequence[str], at_most: int) -> str:
    """The first of many, and how many more there are."""
    return ", ".join(words[:at_most]) + (f" and {len(words) - at_most} more" if len(words) > at_most else "")


def without_rounds(text: str) -> str:
    """`rounds[3].refine` -> `rounds.refine`."""
    return re.sub(r"\[\d+\]", "", text)
