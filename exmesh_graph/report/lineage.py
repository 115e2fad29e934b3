"""Who feeds whom in a run, what a result cost until it was there, and repeat blocks folded into one node."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

_ROUND = re.compile(r"^(?P<block>.+)\[(?P<round>\d+)\]\.(?P<inner>.+)$")


def edges_between(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    """(producer, consumer) pairs of a run record, in order, each once.

    Inputs are wires "@node.port", with each node's entry or under `resolved.nodes`.
    """
    resolved = (record.get("resolved") or {}).get("nodes") or {}
    known = {entry["name"] for entry in record["nodes"]}
    edges: dict[tuple[str, str], None] = {}
    for entry in record["nodes"]:
        inputs = entry.get("inputs") or resolved.get(entry["name"], {}).get("inputs") or {}
        for wire in inputs.values():
            producer = str(wire).removeprefix("@").rpartition(".")[0]
            if producer in known:
                edges[producer, entry["name"]] = None
    return list(edges)


def cumulative_seconds(nodes: Sequence[tuple[str, float]], edges: Sequence[tuple[str, str]]) -> dict[str, float]:
    """Seconds of all that a node depends on, its own not counted: what its input cost.

    `nodes` are (name, seconds) in the order of execution. A node without a known input counts all before it.
    """
    sources: dict[str, set[str]] = {}
    for producer, consumer in edges:
        sources.setdefault(consumer, set()).add(producer)
    seconds = dict(nodes)
    ancestors: dict[str, set[str]] = {}
    spent: dict[str, float] = {}
    before = 0.0
    for name, own in nodes:
        direct = sources.get(name, set())
        ancestors[name] = set(direct).union(*(ancestors.get(node, set()) for node in direct))
        spent[name] = sum(seconds[node] for node in ancestors[name]) if direct else before
        before += own
    return spent


def fold_name(name: str) -> str:
    """`rounds[3].refine` -> `rounds.refine`: the node of a repeat block, whatever its round."""
    match = _ROUND.match(name)
    return f"{fold_name(match['block'])}.{match['inner']}" if match else name


def fold_edges(edges: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """Edges between folded nodes, without those that carry state from one round to the next."""
    folded: dict[tuple[str, str], None] = {}
    for producer, consumer in edges:
        a, b = _ROUND.match(producer), _ROUND.match(consumer)
        next_round = a and b and a["block"] == b["block"] and a["round"] != b["round"]
        pair = (fold_name(producer), fold_name(consumer))
        if not next_round and pair[0] != pair[1]:
            folded[pair] = None
    return list(folded)


def fold_loops(edges: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """The folded edges that carry state from one round to the next."""
    folded: dict[tuple[str, str], None] = {}
    for producer, consumer in edges:
        a, b = _ROUND.match(producer), _ROUND.match(consumer)
        if a and b and a["block"] == b["block"] and a["round"] != b["round"]:
            folded[fold_name(producer), fold_name(consumer)] = None
    return list(folded)
