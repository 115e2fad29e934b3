"""The settings of a refinement."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from exmesh_graph.stage1.regularise import Bilaplacian, Smoothness


@dataclass(frozen=True)
class RefineSettings:
    """Settings of `refine`; meanings and units are those of the node `stage1.refine`. `smoothness` is its L_s."""

    iterations: int = 500
    total_iterations: int = 0
    vertex_lr: float = 0.08
    vertex_decay: float = 0.00625
    texture_lr: float = 0.02
    texture_decay: float = 0.05
    ssim_weight: float = 0.2
    silhouette: Literal["l1", "bce"] = "l1"
    silhouette_weight: float = 5.0
    coverage_weight: float = 1.0
    smoothness: Smoothness = field(default_factory=Bilaplacian)
    deviation_weight: float = 0.0
    depth_weight: float = 0.0
    gradient_decay: float = 0.95
    uv_gradient: bool = True
    gains: bool = False
    downscale: int = 1
    fill_unseen: bool = True
