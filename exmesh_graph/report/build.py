"""Writing `report.json` and `report.html` at the end of a run.

Nothing heavy is imported here: the report is also written after a run that took everything from the store.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from exmesh_graph.report.collect import Report, collect
from exmesh_graph.report.page import render_page


def build_report(run_folder: Path, run_record: Mapping[str, Any], load_artifact: Callable[[str], Any]) -> Path:
    """Write `report.json` and the self-contained `report.html` into `run_folder`; return the path of the page.

    run_record     what the run recorded; `nodes` is required, all else is optional (docs/report.md):
                   nodes     [{name, type, state, seconds, outputs {port: {type, digest, bytes}}, warnings [text],
                             peak_rss bytes}]; seconds are those of the execution that made the result, also
                             where this run took it from the store
                   resolved  {nodes: {name: {inputs: {port: "@node.port"}}}}
                   id, graph (its name), file, command, state, seconds, machine
    load_artifact  digest -> the value; called for outputs of type Metrics and Gallery only
    """
    report = collect(run_record, load_artifact, run_name=run_folder.name)
    text = json.dumps(report.as_json(), indent=1, ensure_ascii=False, allow_nan=False)
    _replace(run_folder / "report.json", text + "\n")
    page = run_folder / "report.html"
    _replace(page, render_page(report))
    return page


def _replace(path: Path, text: str) -> None:
    """A reader sees the old file or the new one, never half of it."""
    partial = path.with_name(f".{path.name}.partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)


__all__ = ["Report", "build_report"]
