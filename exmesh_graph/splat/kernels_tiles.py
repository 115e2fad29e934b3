"""Warp kernels over the (Gaussian, tile) pairs: listing the tiles a Gaussian touches, summing what tiles said of it."""

# mypy: ignore-errors
# See kernels_camera.py.

import warp as wp

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

REAL = globals().get("REAL", wp.float32)


@wp.kernel
def list_tiles(
    order: wp.array(dtype=wp.int64),
    box: wp.array(dtype=wp.vec4i),
    first: wp.array(dtype=wp.int64),
    tile: int,
    across: int,
    tile_of: wp.array(dtype=wp.int32),
    gaussian_of: wp.array(dtype=wp.int32),
):
    """Per drawn Gaussian, nearest first: the tiles it touches, from slot `first[rank]` on."""
    rank = wp.tid()
    g = wp.int32(order[rank])
    b = box[g]
    slot = int(first[rank])
    for ty in range(b[1] / tile, b[3] / tile + 1):
        for tx in range(b[0] / tile, b[2] / tile + 1):
            tile_of[slot] = ty * across + tx
            gaussian_of[slot] = g
            slot += 1


@wp.kernel
def sum_slots(
    order: wp.array(dtype=wp.int64),
    first: wp.array(dtype=wp.int64),
    weights: wp.array(dtype=REAL),
    total: wp.array(dtype=REAL),
):
    """Per drawn Gaussian: the sum of its slots' weights."""
    rank = wp.tid()
    weight = REAL(0.0)
    for slot in range(int(first[rank]), int(first[rank + 1])):
        weight += weights[slot]
    total[int(order[rank])] = weight
