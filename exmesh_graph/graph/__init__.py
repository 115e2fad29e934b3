"""The framework: typed nodes in a cached DAG. Knows nothing of 3-D."""

from exmesh_graph.graph.declare.node import Component, Context, NodeDef, component, facets, node, was
from exmesh_graph.graph.declare.packs import load_packs
from exmesh_graph.params import Params, param

__all__ = ["Component", "Context", "NodeDef", "Params", "component", "facets", "load_packs", "node", "param", "was"]
