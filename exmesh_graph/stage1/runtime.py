"""Loading this room's kernels."""

from __future__ import annotations

from functools import cache
from typing import Any

from exmesh_graph.gpu.warp_runtime import warp


@cache
def kernels() -> Any:
    """The module of Warp kernels of images, imported after `warp()` has been configured."""
    warp()
    from exmesh_graph.stage1 import kernels_terms

    return kernels_terms


@cache
def vertex_kernels() -> Any:
    """The module of Warp kernels of vertices and faces."""
    warp()
    from exmesh_graph.stage1 import kernels_vertices

    return kernels_vertices
