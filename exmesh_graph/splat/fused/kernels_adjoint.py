"""Warp kernels that carry a picture's gradient back to its Gaussians. CPU only: each calls a native snippet."""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

from exmesh_graph.splat.fused.native_adjoint import ADAM, GRADIENTS
from exmesh_graph.splat.fused.native_blend import BLEND_ADJOINT
from exmesh_graph.splat.fused.native_eight import BLOCK

wp.set_module_options({"enable_backward": False})

GAUSSIANS = wp.constant(BLOCK)
"""Gaussians of an item."""


@wp.func_native(BLEND_ADJOINT)
def _blend_adjoint(
    item: int,
    tiles: int,
    spread: int,
    start: wp.array(dtype=int),
    entries: wp.array(dtype=int),
    records: wp.array(dtype=float),
    box: wp.array(dtype=int),
    tile: int,
    across: int,
    height: int,
    width: int,
    weights: wp.array(dtype=float),
    left: wp.array(dtype=float),
    last: wp.array(dtype=int),
    to_colour: wp.array(dtype=float),
    to_alpha: wp.array(dtype=float),
    to_normal: wp.array(dtype=float),
    to_distance: wp.array(dtype=float),
    slots: wp.array(dtype=float),
): ...


@wp.kernel
def blend_adjoint(
    first: int,
    tiles: int,
    spread: int,
    start: wp.array(dtype=int),
    entries: wp.array(dtype=int),
    records: wp.array(dtype=float),
    box: wp.array(dtype=int),
    tile: int,
    across: int,
    height: int,
    width: int,
    weights: wp.array(dtype=float),
    left: wp.array(dtype=float),
    last: wp.array(dtype=int),
    to_colour: wp.array(dtype=float),
    to_alpha: wp.array(dtype=float),
    to_normal: wp.array(dtype=float),
    to_distance: wp.array(dtype=float),
    slots: wp.array(dtype=float),
):
    """Per slot of a tile that shows something the gradient in its record.

    dL/d(rgb, normal, distance), sums over its pixels of s = dL/dln alpha times 1, u, v, u^2, u v, v^2 (from the mean),
    and of |L d/du|, |L d/dv|; slots of weight 0 are left.
    """
    _blend_adjoint(
        first + wp.tid(),
        tiles,
        spread,
        start,
        entries,
        records,
        box,
        tile,
        across,
        height,
        width,
        weights,
        left,
        last,
        to_colour,
        to_alpha,
        to_normal,
        to_distance,
        slots,
    )


@wp.func_native(GRADIENTS)
def _gradients(
    block: int,
    block_size: int,
    count: int,
    first_slot: wp.array(dtype=int),
    slot_weights: wp.array(dtype=float),
    slots: wp.array(dtype=float),
    weight: wp.array(dtype=float),
    records: wp.array(dtype=float),
    thin: float,
    means: wp.array(dtype=float),
    scales: wp.array(dtype=float),
    rotations: wp.array(dtype=float),
    opacities: wp.array(dtype=float),
    sh: wp.array(dtype=float),
    stored: int,
    degree: int,
    camera: wp.array(dtype=float),
    height: int,
    width: int,
    to_means: wp.array(dtype=float),
    to_scales: wp.array(dtype=float),
    to_rotations: wp.array(dtype=float),
    to_opacities: wp.array(dtype=float),
    to_sh: wp.array(dtype=float),
    on_screen: wp.array(dtype=float),
): ...


@wp.kernel
def gradients(
    first: int,
    count: int,
    first_slot: wp.array(dtype=int),
    slot_weights: wp.array(dtype=float),
    slots: wp.array(dtype=float),
    weight: wp.array(dtype=float),
    records: wp.array(dtype=float),
    thin: float,
    means: wp.array(dtype=float),
    scales: wp.array(dtype=float),
    rotations: wp.array(dtype=float),
    opacities: wp.array(dtype=float),
    sh: wp.array(dtype=float),
    stored: int,
    degree: int,
    camera: wp.array(dtype=float),
    height: int,
    width: int,
    to_means: wp.array(dtype=float),
    to_scales: wp.array(dtype=float),
    to_rotations: wp.array(dtype=float),
    to_opacities: wp.array(dtype=float),
    to_sh: wp.array(dtype=float),
    on_screen: wp.array(dtype=float),
):
    """Sums of each Gaussian's slots, in their order, carried back to its parameters; 0 where it was not seen."""
    _gradients(
        first + wp.tid(),
        GAUSSIANS,
        count,
        first_slot,
        slot_weights,
        slots,
        weight,
        records,
        thin,
        means,
        scales,
        rotations,
        opacities,
        sh,
        stored,
        degree,
        camera,
        height,
        width,
        to_means,
        to_scales,
        to_rotations,
        to_opacities,
        to_sh,
        on_screen,
    )


@wp.func_native(ADAM)
def _adam_step(
    block: int,
    block_size: int,
    count: int,
    first_slot: wp.array(dtype=int),
    slot_weights: wp.array(dtype=float),
    slots: wp.array(dtype=float),
    weight: wp.array(dtype=float),
    records: wp.array(dtype=float),
    thin: float,
    means: wp.array(dtype=float),
    scales: wp.array(dtype=float),
    rotations: wp.array(dtype=float),
    opacities: wp.array(dtype=float),
    sh: wp.array(dtype=float),
    stored: int,
    degree: int,
    camera: wp.array(dtype=float),
    height: int,
    width: int,
    m_means: wp.array(dtype=float),
    m_scales: wp.array(dtype=float),
    m_rotations: wp.array(dtype=float),
    m_opacities: wp.array(dtype=float),
    m_sh: wp.array(dtype=float),
    v_means: wp.array(dtype=float),
    v_scales: wp.array(dtype=float),
    v_rotations: wp.array(dtype=float),
    v_opacities: wp.array(dtype=float),
    v_sh: wp.array(dtype=float),
    steps: wp.array(dtype=float),
    bias: wp.array(dtype=float),
    rates: wp.array(dtype=float),
    epsilon: float,
    half_width: float,
    gradient_sums: wp.array(dtype=float),
    views: wp.array(dtype=float),
    most_weight: wp.array(dtype=float),
): ...


@wp.kernel
def adam_step(
    first: int,
    count: int,
    first_slot: wp.array(dtype=int),
    slot_weights: wp.array(dtype=float),
    slots: wp.array(dtype=float),
    weight: wp.array(dtype=float),
    records: wp.array(dtype=float),
    thin: float,
    means: wp.array(dtype=float),
    scales: wp.array(dtype=float),
    rotations: wp.array(dtype=float),
    opacities: wp.array(dtype=float),
    sh: wp.array(dtype=float),
    stored: int,
    degree: int,
    camera: wp.array(dtype=float),
    height: int,
    width: int,
    m_means: wp.array(dtype=float),
    m_scales: wp.array(dtype=float),
    m_rotations: wp.array(dtype=float),
    m_opacities: wp.array(dtype=float),
    m_sh: wp.array(dtype=float),
    v_means: wp.array(dtype=float),
    v_scales: wp.array(dtype=float),
    v_rotations: wp.array(dtype=float),
    v_opacities: wp.array(dtype=float),
    v_sh: wp.array(dtype=float),
    steps: wp.array(dtype=float),
    bias: wp.array(dtype=float),
    rates: wp.array(dtype=float),
    epsilon: float,
    half_width: float,
    gradient_sums: wp.array(dtype=float),
    views: wp.array(dtype=float),
    most_weight: wp.array(dtype=float),
):
    """A step of Adam (`optimiser.GaussianAdam`) of each Gaussian that was seen, and what `density.Density` keeps of it.

    `thin` is the gradient in a Gaussian's thickness; `bias` 1 - b1^t, 1 - b2^t by t; `rates` of means, scales,
    rotations, opacities, colour and higher harmonics.
    """
    _adam_step(
        first + wp.tid(),
        GAUSSIANS,
        count,
        first_slot,
        slot_weights,
        slots,
        weight,
        records,
        thin,
        means,
        scales,
        rotations,
        opacities,
        sh,
        stored,
        degree,
        camera,
        height,
        width,
        m_means,
        m_scales,
        m_rotations,
        m_opacities,
        m_sh,
        v_means,
        v_scales,
        v_rotations,
        v_opacities,
        v_sh,
        steps,
        bias,
        rates,
        epsilon,
        half_width,
        gradient_sums,
        views,
        most_weight,
    )
