"""Settings that were given in units of the normalised world, as the paper's are, brought to mean edge lengths."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.types import Stage1State
from exmesh_graph.types.edges import edges_of

Settings = TypeVar("Settings", bound=RefineSettings)


def in_edge_lengths(settings: Settings, state: Stage1State, *, step: bool = True, deviation: bool = True) -> Settings:
    """`settings` for the mesh of `state`, where vertex_lr (`step`) and deviation_weight were given in world units.

    With the mean edge l, a step of vertex_lr is vertex_lr / l edges long, and L_b of squared world units is l^2 times
    L_b of squared edges. A step is an edge long at most, so that a mesh finer than the rate stays a mesh.
    """
    ends = state.vertices.astype(np.float64)[edges_of(state.faces).vertices]
    length = float(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean()) if len(ends) else 1.0
    changes = {}
    if step:
        changes["vertex_lr"] = min(settings.vertex_lr / length, 1.0)
    if deviation:
        changes["deviation_weight"] = settings.deviation_weight * length**2
    return settings.replaced(**changes)
