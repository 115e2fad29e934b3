"""Where the fit starts: base colour from Stage I's texture, the rest neutral (paper, section 5)."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F

from exmesh_graph.losses import srgb_to_linear
from exmesh_graph.shading.envmap import parameter_of
from exmesh_graph.torch_setup import tensor_of

#: The logit's usable range: a texel that starts at exactly 0 or 1 could never leave it.
MARGIN = 0.02


def resize_texture(texture: np.ndarray, size: int) -> torch.Tensor:
    """`texture` [R, R, C] at size x size texels, float32: area average down, bilinear up."""
    image = tensor_of(np.asarray(texture, np.float32)).permute(2, 0, 1)[None]
    if image.shape[-1] != size or image.shape[-2] != size:
        image = F.interpolate(image, (size, size), mode="bilinear", align_corners=False, antialias=True)
    return image[0].permute(1, 2, 0).contiguous()


def logit(value: torch.Tensor) -> torch.Tensor:
    """Inverse of the sigmoid, for values kept `MARGIN` away from its ends."""
    inside = value.clamp(MARGIN, 1 - MARGIN)
    return torch.log(inside / (1 - inside))


def initial_base_color(texture: np.ndarray, size: int, source: str) -> torch.Tensor:
    """Linear base colour [size, size, 3]: the appearance under an environment of radiance 1, or mid-gray."""
    if source == "gray":
        return torch.full((size, size, 3), 0.5)
    return srgb_to_linear(resize_texture(texture, size).clamp(0, 1))


def initial_environment(height: int, level: float = 1.0, device: torch.device | str = "cpu") -> torch.Tensor:
    """Parameters of a uniform white environment of radiance `level`; under 1, base colour equals appearance."""
    return parameter_of(torch.full((height, 2 * height, 3), level, device=device))
