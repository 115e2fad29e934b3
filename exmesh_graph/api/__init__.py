"""The front door from Python, which `import exmesh_graph as ex` opens: run, check, plan, sweep, diff, call, Graph.

Each name is imported when it is first used: a command that only checks a graph does not wait for what runs one.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

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
           "Session", "Sweep", "UnknownPort", "Wire", "call", "check", "component", "diff", "open_run", "plan", "run",
           "sweep"]  # fmt: skip
_HOMES = {
    "api.builder": "Graph", "api.calling": "call", "api.differences": "Comparison diff", "api.opening": "check",
    "api.planning": "Plan plan", "api.results": "Metric NodeRun Run", "api.runs": "RunFailed open_run run",
    "api.sweeps": "Sweep sweep", "api.values": "Node Parameter UnknownPort Wire component",
    "graph.problems": "GraphErrors", "graph.session": "Session",
}  # fmt: skip
_HOME_OF = {name: f"exmesh_graph.{home}" for home, names in _HOMES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(importlib.import_module(_HOME_OF[name]), name)
    return value


def __dir__() -> list[str]:
    return __all__
