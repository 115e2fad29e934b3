"""The front door from Python, which `import exmesh_graph as ex` opens: run, check, plan, open_run, call, Graph."""

from exmesh_graph.api.builder import Graph
from exmesh_graph.api.call import call
from exmesh_graph.api.differences import Comparison, diff
from exmesh_graph.api.node import Node, UnknownPort
from exmesh_graph.api.opening import check
from exmesh_graph.api.results import Figure, NodeRun, Run
from exmesh_graph.api.runs import Plan, RunFailed, open_run, plan, run
from exmesh_graph.api.sweeps import Sweep, sweep
from exmesh_graph.api.values import Parameter, Wire, component
from exmesh_graph.graph.problems import GraphErrors
from exmesh_graph.graph.session import Session

__all__ = [
    "Comparison",
    "Figure",
    "Graph",
    "GraphErrors",
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
