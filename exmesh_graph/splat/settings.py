"""What the fit of planar Gaussians is told, and their depth maps: parameters of the solvers and of their nodes.

The solvers take any object with these attributes and import this module for types only, so that the room needs no more
than torch, numpy and Warp.
"""

from __future__ import annotations

from typing import Literal

from exmesh_graph.params import Params, param


class PgsrSettings(Params):
    """Of `pgsr.pgsr` and `fit.fit`; the schedule is in shares of `iterations`, rates are those of an iteration."""

    iterations: int = param(1500, ge=1, doc="Length of the fit, one view each; every schedule is a share of it.")
    start: Literal["auto", "points", "hull", "random"] = param(
        "auto",
        doc="points wired in, in the visual hull of the masks, or at random in the unit sphere; auto: the first of "
        "these that there is.",
    )
    count: int = param(20000, ge=1, doc="Gaussians at the start (hull, random).")
    max_gaussians: int = param(40000, ge=1, doc="Gaussians at most.")
    wrong_masks: int = param(0, ge=0, unit="views", was="dissent", doc="Masks that may be wrong at a point (hull).")
    degree: int = param(3, ge=0, le=3, doc="Degree of the spherical harmonics at the end.")
    ssim_weight: float = param(0.2, ge=0, le=1, doc="Share of 1 - SSIM in the colour loss.")
    mask_weight: float = param(0.2, ge=0, doc="Weight of coverage against the mask, where there is one.")
    flatten_weight: float = param(100.0, ge=0, doc="Weight of the Gaussians' mean thickness, in world units.")
    normal_weight: float = param(0.015, ge=0, doc="Weight of rendered normals agreeing with rendered depth.")
    geometric_weight: float = param(0.03, ge=0, doc="Weight of depth agreeing with a neighbouring view's.")
    photometric_weight: float = param(0.15, ge=0, doc="Weight of patches correlating with a neighbouring view's.")
    geometry_from: float = param(0.25, ge=0, le=1, doc="Share of the iterations after which these three act.")
    samples: int = param(4096, ge=1, unit="pixels", doc="Pixels compared with the neighbour in an iteration.")
    mean_rate: float = param(2e-3, gt=0, doc="Step of the means at the start, in world units.")
    mean_decay: float = param(0.01, gt=0, le=1, doc="The means' step ends at this share of its start.")
    scale_rate: float = param(0.005, ge=0, doc="Step of the scales' logarithms.")
    rotation_rate: float = param(0.002, ge=0, doc="Step of the quaternions.")
    opacity_rate: float = param(0.05, ge=0, doc="Step of the opacities' logits.")
    colour_rate: float = param(0.005, ge=0, doc="Step of the colour; that of higher harmonics is a twentieth.")
    densify: float = param(
        2e-4,
        gt=0,
        doc="Mean screen gradient above which a Gaussian is doubled or split; a picture is 2 wide, over the views that "
        "saw it.",
    )
    densify_absolute: float = param(8e-4, gt=0, doc="The same for the sum of its absolute values over the pixels.")
    densify_from: float = param(0.08, ge=0, le=1, doc="Share of the iterations after the first round of splitting.")
    densify_to: float = param(0.6, ge=0, le=1, doc="Share of the iterations after the last round of splitting.")
    densify_rounds: int = param(15, ge=0, doc="Rounds of splitting and pruning; 0: none.")
    min_opacity: float = param(0.01, ge=0, lt=1, doc="A round prunes fainter Gaussians.")
    reset_at: float = param(0.0, ge=0, lt=1, doc="Share of the iterations at which opacities are reset; 0: never.")
    gains: bool = param(False, doc="Fit one factor per view and channel, for photographs of wandering exposure.")
    downscale: int = param(1, ge=1, le=16, doc="Work on pictures reduced by this factor.")


class DepthSettings(Params):
    """Of `depths.depth_maps`: what is dropped."""

    surface: Literal["middle", "blended"] = param(
        "middle", doc="Plane of the Gaussian at which half of the light is gone, or all planes blended."
    )
    incidence: float = param(80.0, gt=0, le=90, unit="degrees", doc="Drop planes seen at more than this angle.")
    agreeing: int = param(1, ge=0, unit="views", doc="Neighbours that must show the same point; 0: none asked.")
    tolerance: float = param(0.01, gt=0, le=1, doc="How far those may be off, as a share of the depth.")
    outward: float = param(
        0.5, ge=0, le=4, unit="px", doc="Added along the surface's normal: a fit shrinks the object by about so much."
    )
