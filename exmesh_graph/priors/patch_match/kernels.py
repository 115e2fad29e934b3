"""The kernel of the propagation. Import through `propagate`."""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

from exmesh_graph.priors.patch_match.native import ROW

wp.set_module_options({"enable_backward": False})


@wp.func_native(ROW)
def _row(
    view: int,
    row: int,
    colour: int,
    height: int,
    width: int,
    stride: int,
    sources: int,
    best: int,
    radius: int,
    step: int,
    trials: int,
    refresh: int,
    turn: int,
    numbers: wp.array(dtype=float),
    bounds: wp.array(dtype=float),
    matrices: wp.array(dtype=float),
    chosen: wp.array(dtype=int),
    ref: wp.array(dtype=float),
    packed: wp.array(dtype=int),
    inside: wp.array(dtype=int),
    found: wp.array(dtype=float),
    state: wp.array(dtype=float),
): ...


@wp.kernel
def propagate_rows(
    first: int,
    colour: int,
    height: int,
    width: int,
    stride: int,
    sources: int,
    best: int,
    radius: int,
    step: int,
    trials: int,
    refresh: int,
    turn: int,
    numbers: wp.array(dtype=float),
    bounds: wp.array(dtype=float),
    matrices: wp.array(dtype=float),
    chosen: wp.array(dtype=int),
    ref: wp.array(dtype=float),
    packed: wp.array(dtype=int),
    inside: wp.array(dtype=int),
    found: wp.array(dtype=float),
    state: wp.array(dtype=float),
):
    """Row (first + tid) mod height of view (first + tid) / height: its pixels of `colour` take better planes.

    They read pixels of the other colour alone, which no item of this launch writes. Layouts: `native`.
    """
    item = first + wp.tid()
    _row(
        item // height, item % height, colour, height, width, stride, sources, best, radius, step, trials, refresh,
        turn, numbers, bounds, matrices, chosen, ref, packed, inside, found, state,
    )  # fmt: skip
