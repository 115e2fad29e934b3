# mypy: ignore-errors
"""Warp kernel of the packer. Import only after `exmesh_graph.gpu.warp_runtime.warp()` has configured Warp."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def first_free(
    taken: wp.array2d(dtype=wp.uint8),
    cells: wp.array(dtype=wp.vec2i),
    columns: int,
    lowest: wp.array(dtype=int),
):
    """Lowest place (row * columns + column) at which none of `cells` (row, column) is taken: minimum into lowest[0]."""
    place = wp.tid()
    if place > lowest[0]:  # a lower place is known: never wrong, only saves time
        return
    row = place // columns
    column = place - row * columns
    for k in range(cells.shape[0]):
        cell = cells[k]
        if taken[row + cell[0], column + cell[1]] != wp.uint8(0):
            return
    wp.atomic_min(lowest, 0, place)
