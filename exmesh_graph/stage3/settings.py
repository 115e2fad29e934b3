"""What the third stage is told: the parameters of its solver, which are also those of its node. Loads no torch."""

from __future__ import annotations

from exmesh_graph.params import Params, param


class ReshapeSettings(Params):
    """Of `reshape.reshape`."""

    iterations: int = param(300, ge=0, doc="Iterations, one view each; 0: the asset stays as it is.")
    vertex_lr: float = param(0.008, ge=0, le=1, unit="mean edge lengths", doc="Length of a vertex's step at the start.")
    vertex_decay: float = param(0.18, gt=0, le=1, doc="A vertex's step ends at this share of its start.")
    texture_lr: float = param(0.0027, ge=0, le=1, doc="Step of a texel at the start, in sRGB-encoded units.")
    texture_decay: float = param(0.37, gt=0, le=1, doc="A texel's step ends at this share of its start.")
    ssim_weight: float = param(0.2, ge=0, le=1, doc="Share of D-SSIM, (1 - SSIM) / 2, in the colour loss.")
    silhouette_weight: float = param(5.0, ge=0, doc="Weight of the silhouette loss; unused without masks.")
    gains: bool = param(False, doc="Fit one factor per view and channel, for photographs of wandering exposure.")
    evidence: float = param(
        0.0,
        ge=0,
        unit="of the median",
        doc="Without masks: vertices whose gradients are below this share of the median's take shorter steps. 0: no.",
    )
    lobe_samples: int = param(16, ge=1, le=1024, doc="Rays of a vertex's specular lobe, per view, before the start.")
    memory_gib: float = param(
        4.0,
        ge=0,
        tuning=True,
        unit="GiB",
        doc="Memory for pictures ready to be compared; of a larger set the rest is made anew at each visit.",
    )
