"""Loading this room's kernels."""

from __future__ import annotations

from functools import cache
from typing import Any

from exmesh_graph.gpu.warp_runtime import warp


@cache
def kernels() -> Any:
    """The module of Warp kernels, imported after `warp()` has been configured."""
    warp()
    from exmesh_graph.stage1 import kernels_terms

    return kernels_terms
