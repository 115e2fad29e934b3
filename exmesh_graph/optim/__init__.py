"""Adam, learning rates over time, and the order of the views."""

from exmesh_graph.optim.adam import EPSILON, FIRST, SECOND, Adam, Bounds, adam_step
from exmesh_graph.optim.schedule import decayed, view_at

__all__ = ["EPSILON", "FIRST", "SECOND", "Adam", "Bounds", "adam_step", "decayed", "view_at"]
