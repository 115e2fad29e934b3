"""Loading this room's kernels."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

from exmesh_graph.gpu.warp_runtime import warp

if TYPE_CHECKING:
    import torch


@cache
def kernels(of: Literal["visibility", "cover", "texture", "silhouette", "paint"] = "visibility") -> Any:
    """A module of Warp kernels, imported after `warp()` has been configured.

    By plain imports: a module imported by a computed name would be missing from the code fingerprints of nodes.
    """
    warp()
    if of == "cover":
        from exmesh_graph.raster import kernels_cover

        return kernels_cover
    if of == "paint":
        from exmesh_graph.raster import kernels_paint

        return kernels_paint
    if of == "texture":
        from exmesh_graph.raster import kernels_texture

        return kernels_texture
    if of == "silhouette":
        from exmesh_graph.raster import kernels_silhouette

        return kernels_silhouette
    from exmesh_graph.raster import kernels as kernels_visibility

    return kernels_visibility


def each_view(projected: torch.Tensor, *pictures: torch.Tensor) -> Iterator[tuple[torch.Tensor, ...]]:
    """The tensors of one view after the other: of each of a batch (`projected` [N, V, 3]), or of the one there is."""
    return zip(projected, *pictures, strict=True) if projected.dim() == 3 else iter([(projected, *pictures)])
