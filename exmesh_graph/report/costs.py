"""What the parts of the method cost: seconds and peak memory per stage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from exmesh_graph.report.collect import Node

#: Stage of a node by the family of its type; families of other packs form stages of their own.
_STAGES = {
    "data": "data", "init": "start", "prior": "start", "appearance": "Stage I", "regulariser": "Stage I",
    "stage1": "Stage I", "mesh": "Stage I", "uv": "Stage I", "transport": "Stage II", "scene": "Stage II",
    "stage2": "Stage II", "export": "export", "evaluate": "scoring", "benchmark": "scoring",
}  # fmt: skip


def stage_costs(nodes: Sequence[Node]) -> list[dict[str, Any]]:
    """[{stage, seconds, peak_memory, nodes}] in the order the stages begin.

    peak_memory is the largest of the stage's nodes, in bytes; only the processor's memory is counted. Seconds are those
    of the executions that made the results, also where this run took them from the store.
    """
    rows: dict[str, dict[str, Any]] = {}
    for node in nodes:
        family = node.type.partition(".")[0]
        stage = _STAGES.get(family, family)
        row = rows.setdefault(stage, {"stage": stage, "seconds": 0.0, "peak_memory": 0, "nodes": 0})
        row["seconds"] += node.seconds
        row["peak_memory"] = max(row["peak_memory"], node.peak_rss)
        row["nodes"] += 1
    return list(rows.values())
