"""The front door from Python, which `import exmesh_graph as ex` opens: run, check, plan, open_run, call, Graph."""

from exmesh_graph.api.builder import Graph
from exmesh_graph.api.call import call
from exmesh_graph.api.opening import checked_graph as check
from exmesh_graph.api.results import Figure, NodeRun, Run
from exmesh_graph.api.runs import RunFailed, open_run, plan, run
from exmesh_graph.api.scope import Node, UnknownPort
from exmesh_graph.api.values import Parameter, Wire, component

__all__ = [
    "Figure",
    "Graph",
    "Node",
    "NodeRun",
    "Parameter",
    "Run",
    "RunFailed",
    "UnknownPort",
    "Wire",
    "call",
    "check",
    "component",
    "open_run",
    "plan",
    "run",
]
