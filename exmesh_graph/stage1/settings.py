"""What Stage I is told: the parameters of its solvers, which are also those of their nodes. Loads no torch."""

from __future__ import annotations

from typing import Literal

from exmesh_graph.params import Params, param


class RefineSettings(Params):
    """Of `refine.refine`."""

    iterations: int = param(500, ge=0, doc="Iterations of this round, one view each.")
    total_iterations: int = param(
        0, ge=0, doc="Length of the whole Stage I, over which learning rates decay; 0 = up to this round's end."
    )
    vertex_lr: float = param(
        0.02,
        ge=0,
        le=1,
        unit="mean edge lengths",
        doc="Length of a vertex's step at the start (mean edge of the round's mesh).",
    )
    vertex_decay: float = param(0.025, gt=0, le=1, doc="A vertex's step ends at this share of its start.")
    vertex_hold: float = param(
        0.27, ge=0, lt=1, doc="Of the schedule, how long a vertex's step stays as long as at the start."
    )
    evidence: float = param(
        0.0,
        ge=0,
        unit="of the median",
        doc="Without masks: vertices whose gradients are below this share of the median's take shorter steps. Where "
        "pictures are silent (blown out, dark, unpainted) Adam makes full steps of what little they say. 0: does not.",
    )
    gloss_firmness: float = param(
        0.0,
        ge=0,
        doc="How much firmer the surface is where it shines: smoothness pulls up to 1 + this times as much where its "
        "brightness changes from view to view (by 0.4 stops; from 0.15 on). Highlights that wander else end as dents. "
        "0: alike everywhere.",
    )
    texture_lr: float = param(0.02, ge=0, le=1, doc="Step of a texel at the start, in sRGB-encoded units.")
    texture_decay: float = param(0.05, gt=0, le=1, doc="A texel's step ends at this share of its start.")
    ssim_weight: float = param(
        0.2, ge=0, le=1, doc="Share of D-SSIM, (1 - SSIM) / 2, in the colour loss (lambda_ssim)."
    )
    silhouette: Literal["l1", "bce"] = param("l1", doc="Silhouette loss: l1, or the paper's cross-entropy.")
    silhouette_weight: float = param(5.0, ge=0, doc="Weight of the silhouette loss; unused without masks.")
    coverage_weight: float = param(
        1.0, ge=0, doc="Weight of what stays uncovered inside the region; used where one is wired."
    )
    hold_unseen: bool = param(
        True,
        doc="Vertices that fewer than two views show stay, and follow those around them when the round ends. "
        "Smoothness alone would bend what nothing is known of.",
    )
    deviation_weight: float = param(0.0, ge=0, doc="Weight of L_b, neighbours moving alike, in its scale-free form.")
    facing_weight: float = param(
        1.0, ge=0, doc="Weight of what shows a closed surface from behind: sides of thin sheets that changed places."
    )
    depth_weight: float = param(0.01, ge=0, doc="Weight of the depth correlation L_d; used where depths are wired.")
    gradient_decay: float = param(0.95, ge=0, lt=1, doc="beta_g of the vertices' gradient average (eq. 1).")
    uv_gradient: bool = param(True, doc="Let colour move vertices inside the silhouette too.")
    gains: bool = param(False, doc="Fit one factor per view and channel, for photographs of wandering exposure.")
    downscale: int = param(1, ge=1, le=16, doc="Work on pictures reduced by this factor.")
    memory_gib: float = param(
        4.0,
        ge=0,
        tuning=True,
        unit="GiB",
        doc="Memory for pictures ready to be compared; of a larger set the rest is made anew at each visit.",
    )
    fill_unseen: bool = param(True, doc="Fill texels that this round never touched from their neighbours.")


class PhotometricSettings(Params):
    """Of `photometric.sweep`."""

    passes: int = param(2, ge=0, le=20, doc="Sweeps over the mesh.")
    reach: float = param(3.0, gt=0, le=20, unit="mean edges", doc="Largest move of a pass inwards; outwards a quarter.")
    smoothness: float = param(0.03, gt=0, doc="Weight of neighbours moving alike against what the photographs say.")


class BalanceSettings(Params):
    """Of `exposure.balanced`."""

    exposure: Literal["auto", "on", "off"] = param(
        "auto", doc="Take exposure and white balance out of the views: where they wander, always, never."
    )
    wander: float = param(
        0.07, ge=0, unit="stops", doc="auto: least deviation of a view's brightness from its neighbours' that counts."
    )
    beyond_gloss: float = param(
        0.75,
        ge=0,
        doc="auto: the same, as a share of how parts of one view differ by gloss and shadows.",
    )
