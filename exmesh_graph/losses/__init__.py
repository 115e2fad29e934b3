"""Image, silhouette and depth losses, and the sRGB curves: CPU or CUDA, whatever the inputs are on.

Images are [H, W, C] (or [H, W]); every loss is a scalar tensor, a mean over pixels and channels.
"""

from exmesh_graph.colour import display, linear_to_srgb, srgb_to_linear
from exmesh_graph.losses.dssim import (
    SSIM_WINDOW,
    Box,
    SsimTarget,
    d_ssim,
    mask_box,
    ssim,
    ssim_and_gradient,
    ssim_target,
)
from exmesh_graph.losses.image import l1, log_l1, pair_variation, pearson_depth, silhouette_bce

__all__ = [
    "SSIM_WINDOW",
    "Box",
    "SsimTarget",
    "d_ssim",
    "display",
    "l1",
    "linear_to_srgb",
    "log_l1",
    "mask_box",
    "pair_variation",
    "pearson_depth",
    "silhouette_bce",
    "srgb_to_linear",
    "ssim",
    "ssim_and_gradient",
    "ssim_target",
]
