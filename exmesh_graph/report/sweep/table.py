"""The one table of a sweep: per variant every headline figure with its spread, seconds, and what is shared.

A variant is compared with the base of its own graph file, seed by seed: the difference is the mean over the seeds that
both have, and it exceeds the spread when it is larger than the sample standard deviation of these differences. Pairing
takes out what a seed does to both alike. With one repeat there is no spread and nothing is said.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from exmesh_graph.report.collect import collect, unique_labels
from exmesh_graph.report.contents import ReportFigure
from exmesh_graph.report.text import number

SCHEMA = "exmesh.sweep.v1"
BASE = "base"
_READY = ("hit", "done", "idle")


def sweep_table(
    record: Mapping[str, Any],
    members: Sequence[Mapping[str, Any]],
    load_artifact: Callable[[str], Any],
    failures: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """What sweep.json holds (docs/variants.md).

    record    the run record of the merged graph
    members   one graph each: {variant, file, repeat, seed, settings, doc, nodes: {own name: name in the merged graph}};
              the first of a file is its base
    failures  {node of the merged graph: message}
    """
    rows = {row["name"]: row for row in record["nodes"]}
    load = functools.cache(load_artifact)
    parts = [_part(member, record, rows, load, failures or {}) for member in members]
    for part, named in zip(parts, unique_labels([part["figures"] for part in parts]), strict=True):
        part["figures"] = {figure.label: figure for figure in named}
    bases = {(p["file"], p["repeat"]): p for p in parts if p["variant"] == BASE}
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for part in parts:
        base = bases.get((part["file"], part["repeat"]), part)
        theirs = {_result(rows[name]) for name in base["own"]}
        new = [name for name in part["own"] if _result(rows[name]) not in theirs]
        part["shared"] = len(part["own"]) - len(new)
        part["own_seconds"] = sum(rows[name]["seconds"] for name in new)
        groups.setdefault((part["file"], part["variant"]), []).append(part)
    variants = [_variant(group, groups.get((file, BASE), group)) for (file, _), group in groups.items()]
    figures = _columns(parts, variants)
    states = [row["state"] for row in rows.values()]
    return {
        "schema": SCHEMA,
        "run": record.get("id", ""),
        **{key: record.get(key, "") for key in ("graph", "command", "state")},
        "seconds": record.get("seconds"),
        "nodes": {"of_all_variants": sum(len(part["own"]) for part in parts), "after_sharing": len(rows),
                  "from_store": states.count("hit"), "run": states.count("done")},
        "figures": [{"label": f.label, "unit": f.unit, "better": f.better, "node": f.node} for f in figures],
        "variants": variants,
        "members": list(members),
    }  # fmt: skip


def label_of(row: Mapping[str, Any], several_files: bool) -> str:
    """The variant's name, with its file where the sweep spans several."""
    return f"{row['file']}/{row['variant']}" if several_files else str(row["variant"])


def verdict(figure: Mapping[str, Any], entry: Mapping[str, Any]) -> str:
    """better, worse, same (within the spread) or other (no direction is better) than the base; "" where unknown."""
    difference = entry.get("difference")
    if difference is None:
        return ""
    if difference == 0 or entry.get("exceeds") is False:
        return "same"
    if figure["better"] not in ("higher", "lower"):
        return "other"
    return "better" if (difference > 0) == (figure["better"] == "higher") else "worse"


def text_of(entry: Mapping[str, Any]) -> str:
    """`31.2 ± 0.1`, `yes`, `2 of 3`, or an en dash."""
    values = entry.get("values") or []
    if values and all(isinstance(value, bool) for value in values):
        return number(values[0]) if len(set(values)) == 1 else f"{sum(values)} of {len(values)}"
    mean, spread = entry.get("mean"), entry.get("spread")
    if mean is None:
        return "–"
    if spread:
        digits = max(0, 1 - math.floor(math.log10(spread)))  # two digits of the spread carry meaning
        return f"{mean:,.{digits}f} ± {spread:,.{digits}f}".replace(",", "\u202f")
    whole = isinstance(mean, float) and mean.is_integer() and all(isinstance(value, int) for value in values)
    return number(int(mean) if whole else mean)


def _columns(parts: Sequence[dict[str, Any]], variants: Sequence[Mapping[str, Any]]) -> list[ReportFigure]:
    """The figures in the order of the table: those that differ between variants first, those scored last first."""
    columns: dict[str, ReportFigure] = {}
    for part in parts:
        for label, figure in part["figures"].items():
            columns.setdefault(label, figure)

    def rank(figure: ReportFigure) -> tuple[bool, bool, float]:
        entries = [row["figures"][figure.label] for row in variants if figure.label in row["figures"]]
        same = not any(entry.get("difference") for entry in entries)
        return same, not figure.better, -(figure.after_seconds or 0.0)

    return sorted(columns.values(), key=rank)


def _part(
    member: Mapping[str, Any],
    record: Mapping[str, Any],
    rows: Mapping[str, Mapping[str, Any]],
    load: Callable[[str], Any],
    failures: Mapping[str, str],
) -> dict[str, Any]:
    """One graph of the sweep with its figures, read out of the record of the merged run."""
    names = {own: name for own, name in member["nodes"].items() if name in rows}
    back = {name: own for own, name in names.items()}
    resolved = (record.get("resolved") or {}).get("nodes") or {}
    nodes, inputs = [], {}
    for own, name in names.items():
        outputs = {p: o for p, o in (rows[name].get("outputs") or {}).items() if o["type"] == "Metrics"}
        nodes.append({**rows[name], "name": own, "outputs": outputs})
        wires = (resolved.get(name) or {}).get("inputs") or {}
        inputs[own] = {"inputs": {port: _renamed(wire, back) for port, wire in wires.items()}}
    figures = collect({"nodes": nodes, "resolved": {"nodes": inputs}}, load).figures
    state, reason = _state(names, rows, failures)
    return {**member, "own": set(names.values()), "figures": figures, "state": state, "reason": reason,
            "seconds": sum(rows[name]["seconds"] for name in names.values())}  # fmt: skip


def _result(row: Mapping[str, Any]) -> str:
    """What tells one result from another: the key, since other nodes may come to the same one (equal inputs)."""
    return str(row.get("key") or row["name"])


def _renamed(wire: str, back: Mapping[str, str]) -> str:
    node, _, port = str(wire).removeprefix("@").rpartition(".")
    return f"@{back.get(node, node)}.{port}"


def _state(
    names: Mapping[str, str], rows: Mapping[str, Mapping[str, Any]], failures: Mapping[str, str]
) -> tuple[str, str]:
    """(state, reason) of one graph; a fault upstream is told by the node that has it."""
    bad = {own: rows[name] for own, name in names.items() if rows[name]["state"] not in _READY}
    if not bad:
        return "done", ""
    for own, row in bad.items():
        if row["state"] == "failed":
            lines = failures.get(row["name"], "failed").splitlines()
            return "failed", f"{own}: {'; '.join(line.strip() for line in lines)}"
    own, row = next(iter(bad.items()))
    return "unfinished", f"{own}: {row['state']}"


def _variant(group: Sequence[dict[str, Any]], base: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """One line of the table: the repeats of a variant together."""
    first, faulty = group[0], [part for part in group if part["state"] != "done"]
    labels = list(dict.fromkeys(label for part in group for label in part["figures"]))
    figures = {label: _compared(label, group, base, is_base=group is base) for label in labels}
    seconds = [part["seconds"] for part in group]
    return {
        "variant": first["variant"],
        "file": first["file"],
        "doc": first.get("doc", ""),
        "settings": dict(first["settings"]),
        "state": faulty[0]["state"] if faulty else "done",
        "reason": faulty[0]["reason"] if faulty else "",
        "figures": figures,
        "seconds": {"mean": _mean(seconds), "spread": _spread(seconds),
                    "own": _mean([part["own_seconds"] for part in group])},
        "nodes": len(first["own"]),
        "shared": first["shared"],
        "repeats": [
            {"seed": part["seed"], "state": part["state"], "reason": part["reason"], "seconds": part["seconds"],
             "figures": {label: figure.value for label, figure in part["figures"].items()}}
            for part in group
        ],
    }  # fmt: skip


def _compared(label: str, group: Sequence[dict[str, Any]], base: Sequence[dict[str, Any]], *, is_base: bool) -> Any:
    figures = [part["figures"][label] for part in group if label in part["figures"]]
    values = [figure.value for figure in figures]
    if not all(isinstance(value, int | float) for value in values):
        return {"mean": values[0] if len(set(values)) == 1 else None, "values": values}
    numbers = [float(value) for value in values]
    yes_no = all(isinstance(value, bool) for value in values)
    entry = {"mean": _mean(numbers), "spread": _spread(numbers), "values": values,
             "after_seconds": _mean([figure.after_seconds or 0.0 for figure in figures])}  # fmt: skip
    theirs = {part["repeat"]: part["figures"][label].value for part in base if label in part["figures"]}
    pairs = [(part["figures"][label].value, theirs[part["repeat"]]) for part in group
             if label in part["figures"] and part["repeat"] in theirs]  # fmt: skip
    if yes_no or is_base or not pairs or not all(isinstance(value, int | float) for _, value in pairs):
        return entry
    apart = [float(mine) - float(other) for mine, other in pairs]
    difference, noise = _mean(apart), _spread(apart)
    exceeds = None if noise is None else abs(difference) > noise
    return {**entry, "difference": difference, "difference_spread": noise, "exceeds": exceeds}


def _mean(values: Sequence[float]) -> float:
    same = len(set(values)) == 1  # then without a rounding error, which would look like a spread
    return values[0] if same else math.fsum(values) / len(values)


def _spread(values: Sequence[float]) -> float | None:
    """Sample standard deviation; None for a single value."""
    if len(values) < 2:
        return None
    mean = _mean(values)
    return math.sqrt(math.fsum((value - mean) ** 2 for value in values) / (len(values) - 1))
