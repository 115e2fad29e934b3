"""exmesh-graph: multi-view photographs to relightable UV-PBR mesh assets, as a cached graph of typed nodes.

    import exmesh_graph as ex

    run = ex.run("graphs/quickstart.yaml", scene="my_scene", faces=20_000)
    run["settle"].state, run.metrics, run.asset, run.folder

What this page names is imported when it is first used, so that `import exmesh_graph` costs nothing.
"""

from __future__ import annotations

import importlib
import sys
from typing import TYPE_CHECKING, Any

from exmesh_graph.version import __version__

if TYPE_CHECKING:
    from exmesh_graph.api.builder import Graph
    from exmesh_graph.api.calling import call
    from exmesh_graph.api.differences import Comparison, diff
    from exmesh_graph.api.opening import check
    from exmesh_graph.api.planning import Plan, plan
    from exmesh_graph.api.results import Metric, NodeRun, Run
    from exmesh_graph.api.runs import RunFailed, open_run, run
    from exmesh_graph.api.sweeps import Sweep, sweep
    from exmesh_graph.api.values import Node, Parameter, UnknownPort, Wire, component
    from exmesh_graph.graph.problems import GraphErrors
    from exmesh_graph.graph.session import Session

__all__ = ["Comparison", "Graph", "GraphErrors", "Metric", "Node", "NodeRun", "Parameter", "Plan", "Run", "RunFailed",
           "Session", "Sweep", "UnknownPort", "Wire", "__version__", "call", "check", "component", "diff", "open_run",
           "plan", "run", "sweep"]  # fmt: skip
_HOMES = {
    "api.builder": "Graph", "api.calling": "call", "api.differences": "Comparison diff", "api.opening": "check",
    "api.planning": "Plan plan", "api.results": "Metric NodeRun Run", "api.runs": "RunFailed open_run run",
    "api.sweeps": "Sweep sweep", "api.values": "Node Parameter UnknownPort Wire component",
    "graph.problems": "GraphErrors", "graph.session": "Session",
}  # fmt: skip
_HOME_OF = {name: f"{__name__}.{home}" for home, names in _HOMES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOME_OF[name]), name)
    _show_in_notebooks()
    return value


def __dir__() -> list[str]:
    return __all__


def _show_in_notebooks() -> None:
    """Graphs, runs and wire types show themselves where IPython runs."""
    if "IPython" in sys.modules:
        from exmesh_graph.notebook import register

        register()


_show_in_notebooks()
