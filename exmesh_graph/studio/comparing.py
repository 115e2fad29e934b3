"""Sweeps and pairs of runs: tables of figures, what differs, and which artifacts belong side by side."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from exmesh_graph.api.differences import Comparison, Side
from exmesh_graph.errors import ExmeshError
from exmesh_graph.report.collect import collect
from exmesh_graph.report.contents import fields_of
from exmesh_graph.report.sweep.table import text_of, verdict


def sweep_facts(folder: Path) -> dict[str, Any] | None:
    """The table of a finished sweep; None where there is none yet."""
    table = _read(folder / "sweep.json")
    if table is None:
        return None
    figures = {one["label"]: one for one in table["figures"]}
    rows = []
    for row in table["variants"]:
        cells = {
            label: {**entry, "text": text_of(entry), "verdict": verdict(figures[label], entry),
                    "unit": figures[label]["unit"], "better": figures[label]["better"]}
            for label, entry in row["figures"].items()
            if label in figures
        }  # fmt: skip
        rows.append({
            "variant": row["variant"], "file": row["file"], "doc": row.get("doc", ""), "state": row["state"],
            "reason": row["reason"], "figures": cells, "seconds": row["seconds"]["mean"],
            "own_seconds": row["seconds"]["own"], "shared": row["shared"], "nodes": row["nodes"],
            "repeats": len(row["repeats"]), "settings": row["settings"],
        })  # fmt: skip
    members = [{"variant": one["variant"], "repeat": one["repeat"], "nodes": one["nodes"]} for one in table["members"]]
    return {"labels": list(figures), "figures": list(figures.values()), "rows": rows, "members": members}


def headline_of(folder: Path, record: Mapping[str, Any], load: Callable[[str], Any]) -> dict[str, Any]:
    """The headline figures of a run: its report's, or before there is one those of the Metrics that are there."""
    told = _read(folder / "report.json")
    if told is not None:
        return {"headline": told.get("headline") or {}, "seconds": told.get("seconds") or {}, "final": True}
    nodes = [{**row, "outputs": {p: o for p, o in (row.get("outputs") or {}).items() if o["type"] == "Metrics"}}
             for row in record.get("nodes", ())]  # fmt: skip
    try:
        report = collect({**record, "nodes": nodes}, load)
    except (ExmeshError, KeyError, TypeError, ValueError):
        return {"headline": {}, "seconds": {}, "final": False}
    headline = {one.label: fields_of(one, "label", "over") for one in report.headline}
    return {"headline": headline, "seconds": report.data["seconds"], "final": False}


def pair_facts(old: Path, new: Path) -> dict[str, Any]:
    """Two runs side by side: sentences, figures of both, and the outputs of each node in both.

    Raises ExmeshError where one has no record.
    """
    sides = Side(old), Side(new)
    rows = [{row["name"]: row for row in _read(folder / "run.json", {})["nodes"]} for folder in (old, new)]
    before, after = (side.figures() for side in sides)
    figures = [
        {"label": label, "a": before.get(label, {}).get("value"), "b": after.get(label, {}).get("value"),
         "unit": (after.get(label) or before.get(label) or {}).get("unit", ""),
         "better": (after.get(label) or before.get(label) or {}).get("better", "")}
        for label in dict.fromkeys([*before, *after])
    ]  # fmt: skip
    nodes = []
    for name in dict.fromkeys([*rows[0], *rows[1]]):
        a, b = (side.get(name) or {} for side in rows)
        nodes.append({"name": name, "same": bool(a.get("key")) and a.get("key") == b.get("key"),
                      "a": a.get("outputs") or {}, "b": b.get("outputs") or {}})  # fmt: skip
    return {"lines": Comparison(*sides).lines(), "figures": figures, "nodes": nodes}


def _read(path: Path, default: Any = None) -> Any:
    with contextlib.suppress(OSError, ValueError):
        return json.loads(path.read_text(encoding="utf-8"))
    return default
