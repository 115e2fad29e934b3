"""How wire types, graphs and runs show themselves in a notebook: formatters that load what they need when used.

Every output is HTML that stands alone and works offline; `repr` says the same in a line.
"""

from __future__ import annotations

import functools
import importlib
import sys
import weakref
from typing import Any

#: (module, class) -> what makes its HTML; named by text, so that nothing is imported for it.
SHOWN = {
    ("exmesh_graph.types.artifact", "Artifact"): "values.artifact_html",
    ("exmesh_graph.graph.language.check", "Checked"): "runs.checked_html",
    ("exmesh_graph.api.builder", "Graph"): "runs.graph_html",
    ("exmesh_graph.api.results", "Run"): "runs.run_html",
    ("exmesh_graph.api.results", "NodeRun"): "runs.node_html",
    ("exmesh_graph.api.planning", "Plan"): "runs.plan_html",
    ("exmesh_graph.api.sweeps", "Sweep"): "runs.sweep_html",
    ("exmesh_graph.api.differences", "Comparison"): "runs.difference_html",
}

_taught: weakref.WeakSet[Any] = weakref.WeakSet()


def register(shell: Any = None) -> bool:
    """Teach the running IPython to show the project's objects; False where there is none."""
    ipython = sys.modules.get("IPython")
    shell = shell or (ipython.get_ipython() if ipython else None)
    if shell is None:
        return False
    html = shell.display_formatter.formatters["text/html"]
    if html not in _taught:  # once: what a user sets afterwards stands
        _taught.add(html)
        for (module, name), function in SHOWN.items():
            html.for_type_by_name(module, name, functools.partial(_show, function))
    if (progress := sys.modules.get("exmesh_graph.api.progress")) is not None and progress.notebook is None:
        from exmesh_graph.notebook.runs import Cells

        progress.notebook = Cells()  # type: ignore[attr-defined]
    return True


def load_ipython_extension(shell: Any) -> None:
    """For `%load_ext exmesh_graph.notebook` where the project was imported before IPython."""
    register(shell)


def _show(function: str, value: Any) -> str | None:
    module, _, name = function.partition(".")
    show = getattr(importlib.import_module(f"{__name__}.{module}"), name)
    return show(value)  # type: ignore[no-any-return]
