"""Settings of the fit, with the schedule as shares of its length."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FitSettings:
    """How planar Gaussians are fitted; meanings and units are those of the node `init.pgsr`.

    Rates are per iteration: mean_rate in world units at the start (decaying to a hundredth), the others as in 3DGS.
    Shares are of `iterations`. Gradients of `densify` are of the mean in normalised device coordinates (a picture is 2
    wide), averaged over the views that saw it, and `densify_absolute` of their absolute sums over pixels.
    """

    iterations: int = 1500
    max_gaussians: int = 40000
    degree: int = 3
    ssim_weight: float = 0.2
    mask_weight: float = 0.2
    flatten_weight: float = 100.0
    normal_weight: float = 0.015
    geometric_weight: float = 0.03
    photometric_weight: float = 0.15
    geometry_from: float = 0.25
    samples: int = 4096
    mean_rate: float = 2e-3
    mean_decay: float = 0.01
    scale_rate: float = 0.005
    rotation_rate: float = 0.002
    opacity_rate: float = 0.05
    colour_rate: float = 0.005
    densify: float = 2e-4
    densify_absolute: float = 8e-4
    densify_from: float = 0.08
    densify_to: float = 0.6
    densify_rounds: int = 15
    reset_at: float = 0.0
    min_opacity: float = 0.01
    gains: bool = False

    def rounds(self) -> tuple[int, ...]:
        """Iterations after which Gaussians are split and pruned."""
        first, last = self.densify_from * self.iterations, self.densify_to * self.iterations
        gap = (last - first) / max(self.densify_rounds - 1, 1)
        return tuple(sorted({max(1, round(first + i * gap)) for i in range(self.densify_rounds)}))

    def active_degree(self, iteration: int) -> int:
        """Harmonics in use: a degree more with each fifth of the iterations."""
        return min(self.degree, 5 * iteration // max(self.iterations, 1))
