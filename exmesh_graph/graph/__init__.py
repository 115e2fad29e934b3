"""The framework: typed nodes in a cached DAG. Knows nothing of 3-D."""

from exmesh_graph.graph.language.components import Component, component
from exmesh_graph.graph.node import REGISTRY, Context, NodeDef, Params, facets, node, param

__all__ = ["REGISTRY", "Component", "Context", "NodeDef", "Params", "component", "facets", "node", "param"]
