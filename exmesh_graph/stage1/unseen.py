"""Vertices that hardly a photograph shows: they stay, and at the end of a round follow what is around them.

Only smoothness would move them, and Adam makes full steps of its small gradients: the foot of a vase, flat at the
start, ends as a dome that nothing speaks for.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.sparse import coo_matrix, diags_array
from scipy.sparse.linalg import spsolve

from exmesh_graph.stage1.appearance.model import Surface
from exmesh_graph.targets import Targets

_VIEWS = 2
_LOOSE = 1e-9  # weight of staying where nothing around is seen


def unseen(surface: Surface, targets: Targets) -> torch.Tensor:
    """bool [V]: vertices whose faces show in fewer than two views, for one alone cannot tell how far away they are; in
    none, where there is but one."""
    views = targets.shown(surface.vertices, surface.faces).vertices.sum(dim=0)
    return views < min(_VIEWS, len(targets))


def followed(vertices: np.ndarray, before: np.ndarray, held: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """The vertices float32 [V, 3], of which those `held` (bool [V]) are moved along from where they were `before`.

    edges int [E, 2], undirected, each once. Their displacement is the mean of their neighbours', so nowhere larger than
    that of what is seen around them; a flat part whose rim turns stays flat.
    """
    moved = vertices.astype(np.float64) - before
    if not held.any() or not np.abs(moved[~held]).any():
        return vertices
    count = len(vertices)
    ends = np.concatenate([edges, edges[:, ::-1]])
    beside = coo_matrix((np.ones(len(ends)), tuple(ends.T)), shape=(count, count)).tocsr()[held]
    degree = diags_array(np.asarray(beside.sum(axis=1)).ravel() + _LOOSE)
    found = spsolve((degree - beside[:, held]).tocsc(), beside[:, ~held] @ moved[~held])
    result = vertices.copy()
    result[held] = (before[held] + found.reshape(-1, 3)).astype(vertices.dtype)
    return result
