"""Faults of a graph as the page shows them: with the node and the port that they belong to."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

from exmesh_graph.errors import ExmeshError
from exmesh_graph.graph.problems import GraphErrors, Problem, without_rounds
from exmesh_graph.studio.values import EDIT, shown_path

_SUBJECT = re.compile(r"(?:variant [^:]*: )?(?:node )?([A-Za-z_][\w.\[\]-]*)(?::| has| cannot| is)")
_PLACE = re.compile(r" \([^()]*(?:\([^()]*\)[^()]*)*\)")


def fault_facts(problem: Problem, nodes: Collection[str], folder: Path) -> dict[str, Any]:
    """PROBLEM of the contract; `nodes` are the folded names that there are."""
    node, port = _ends(problem, nodes)
    where = problem.where
    edit = where.file is not None and where.file.name == EDIT
    return {
        "code": problem.code, "what": problem.what, "node": node, "port": port, "wire": _PLACE.sub("", problem.wire),
        "file": shown_path(where.file, folder), "line": 0 if edit else where.line,
        "where": f"edit {where.line}" if edit and where.line else "an edit" if edit or where.file is None
                 else f"{shown_path(where.file, folder)}:{where.line}",
        "expected": problem.expected, "found": problem.found, "nearest": list(problem.nearest), "fix": problem.fix,
        "rounds": problem.rounds,
    }  # fmt: skip


def error_facts(error: ExmeshError, nodes: Collection[str] = (), folder: Path = Path()) -> dict[str, Any]:
    """The `error` of the contract."""
    problems = error.problems if isinstance(error, GraphErrors) else ()
    told = [fault_facts(problem, nodes, folder) for problem in problems]
    if told:
        first = told[0]
        return {"code": error.code, "what": first["what"], "where": first["where"], "expected": first["expected"],
                "fix": first["fix"], "problems": told}  # fmt: skip
    return {"code": error.code, "what": error.what, "where": error.where, "expected": error.expected,
            "fix": error.fix, "problems": []}  # fmt: skip


def _ends(problem: Problem, nodes: Collection[str]) -> tuple[str, str]:
    """The node that a problem belongs to, and its port where there is one: by the wire, else by how it is said."""
    words: list[str] = []
    if " -> " in problem.wire:
        words.append(problem.wire.rpartition(" -> ")[2].partition(" (")[0])
    if match := _SUBJECT.match(problem.what):
        words.append(match[1])
    for word in words:
        node, port = _split(without_rounds(word).removeprefix("@"), nodes)
        if node:
            return node, port or _named_port(problem.what, node)
    return "", ""


def _split(word: str, nodes: Collection[str]) -> tuple[str, str]:
    if word in nodes:
        return word, ""
    node, _, port = word.rpartition(".")
    return (node, port) if node in nodes else ("", "")


def _named_port(what: str, node: str) -> str:
    found = re.search(r"(?:the input|the parameter) (\w+)", what)
    if found:
        return found[1]
    after = re.match(re.escape(node) + r"(?:\[\d+\])?: (\w+)(?: is|:)", without_rounds(what))
    return after[1] if after else ""


def counted(problems: Iterable[dict[str, Any]]) -> dict[str, int]:
    """How many faults each node has."""
    counts: dict[str, int] = {}
    for problem in problems:
        if problem["node"]:
            counts[problem["node"]] = counts.get(problem["node"], 0) + 1
    return counts
