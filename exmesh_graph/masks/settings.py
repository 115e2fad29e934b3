"""What masks are made by: the parameters of the functions here, and of their nodes. Loads nothing heavy."""

from __future__ import annotations

from typing import Literal

from exmesh_graph.params import Params, param


class CutSettings(Params):
    """Of `outlines.masks_of_surface`."""

    side: int = param(
        400, ge=32, unit="px", doc="Longer side of the pictures in which outlines are first moved; of stereo too."
    )
    band: float = param(
        8.0,
        ge=1,
        le=64,
        unit="px",
        doc="How far an outline may move to an edge of the picture, at that size; in pictures below 256 less, to half.",
    )
    smoothness: float = param(
        2.0, ge=0, le=100, doc="Cost of a pixel of outline where the picture is flat; that of a wrong pixel is 1."
    )


class ObjectSettings(Params):
    """Of `object.object_of_depths`."""

    table: Literal["auto", "remove", "keep"] = param(
        "auto",
        doc="A plane that the object stands on: auto takes it away where it goes on beside the object; keep it, or "
        "take it away in any case (an error where there is none).",
    )
    resolution: int = param(128, ge=32, le=512, unit="voxels", doc="Along the diameter of what is looked at.")
    reach: float = param(
        1.3, ge=1, le=4, doc="How far is looked, in radii of the world's sphere, which is a guess without masks."
    )
    least_part: float = param(0.05, ge=0, le=1, doc="Parts apart from the largest stay from this share of its area on.")
    least_structure: float = param(
        0.006,
        ge=0,
        le=1,
        doc="Depth counts where display values vary by this deviation in 3 x 3 pixels: flat ones have a neighbour's.",
    )


class AgreementSettings(Params):
    """Of `agreement.agree`: what masks that were found must pass."""

    least_overlap: float = param(
        0.85,
        ge=0,
        le=1,
        doc="Median over the views of masks and their common shape, drawn back: intersection over union, or the part "
        "of the first masks that it covers, whichever is less.",
    )
    least_apart: float = param(
        0.8, ge=0, le=1, doc="Share of the surface amidst the views, less its table, that most of the views show."
    )
    least_seen: float = param(0.6, ge=0, le=1, doc="Share of the views that must show the object.")
    most_contradicted: float = param(
        0.2, ge=0, le=1, doc="Share of the views whose mask may be another than the common shape."
    )
