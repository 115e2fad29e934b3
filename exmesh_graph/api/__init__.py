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
    from exmesh_graph.api.node import Node, UnknownPort
    from exmesh_graph.api.opening import check
    from exmesh_graph.api.results import Metric, NodeRun, Run
    from exmesh_graph.api.runs import Plan, RunFailed, open_run, plan, run
    from exmesh_graph.api.sweeps import Sweep, sweep
    from exmesh_graph.api.values import Parameter, Wire, component
    from exmesh_graph.graph.problems import GraphErrors
    from exmesh_graph.graph.session import Session

_HOMES = {
    "Graph": "exmesh_graph.api.builder",
    "call": "exmesh_graph.api.calling",
    "Comparison": "exmesh_graph.api.differences",
    "diff": "exmesh_graph.api.differences",
    "Node": "exmesh_graph.api.node",
    "UnknownPort": "exmesh_graph.api.node",
    "check": "exmesh_graph.api.opening",
    "Metric": "exmesh_graph.api.results",
    "NodeRun": "exmesh_graph.api.results",
    "Run": "exmesh_graph.api.results",
    "Plan": "exmesh_graph.api.runs",
    "RunFailed": "exmesh_graph.api.runs",
    "open_run": "exmesh_graph.api.runs",
    "plan": "exmesh_graph.api.runs",
    "run": "exmesh_graph.api.runs",
    "Sweep": "exmesh_graph.api.sweeps",
    "sweep": "exmesh_graph.api.sweeps",
    "Parameter": "exmesh_graph.api.values",
    "Wire": "exmesh_graph.api.values",
    "component": "exmesh_graph.api.values",
    "GraphErrors": "exmesh_graph.graph.problems",
    "Session": "exmesh_graph.graph.session",
}
__all__ = [
    "Comparison",
    "Graph",
    "GraphErrors",
    "Metric",
    "Node",
    "NodeRun",
    "Parameter",
    "Plan",
    "Run",
    "RunFailed",
    "Session",
    "Sweep",
    "UnknownPort",
    "Wire",
    "call",
    "check",
    "component",
    "diff",
    "open_run",
    "plan",
    "run",
    "sweep",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(importlib.import_module(_HOMES[name]), name)
    return value


def __dir__() -> list[str]:
    return __all__
