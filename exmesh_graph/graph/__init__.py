"""The framework: typed nodes in a cached DAG. Knows nothing of 3-D."""

from exmesh_graph.graph.declare.components import Component, component
from exmesh_graph.graph.declare.node import REGISTRY, Context, NodeDef, facets, node
from exmesh_graph.params import Params, param

__all__ = ["REGISTRY", "Component", "Context", "NodeDef", "Params", "component", "facets", "node", "param"]
