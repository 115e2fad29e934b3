"""LPIPS (Zhang et al. 2018, "The Unreasonable Effectiveness of Deep Features", eq. 1) with VGG-16, version 0.1.

d = sum over five layers of the mean over pixels of w . (f1 - f2)^2, where f are the features after ReLU 1_2, 2_2, 3_3,
4_3 and 5_3, scaled to unit length over the channels (+ 1e-10), and w >= 0 one weight per channel. Inputs are display
values in [0, 1]; they become 2x - 1, then (x - shift) / scale per channel, as the weights were trained.

The weights are not part of this package. They come from a safetensors file the user makes once (docs/metrics.md), with
torchvision's names for the convolutions (features.0.weight, ...) and lin0.model.1.weight to lin4.model.1.weight of
the LPIPS release.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as functional

from exmesh_graph.errors import NumericsError
from exmesh_graph.evaluate.metrics.weights import BLOCKS, check_lpips

_SHIFT, _SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)


class Lpips:
    """The distance, with its weights read once. `lpips(image, reference)` takes display values [H, W, 3] in [0, 1]."""

    def __init__(self, weights: dict[str, torch.Tensor]) -> None:
        self.weights = {name: tensor.detach().float() for name, tensor in weights.items()}

    @classmethod
    def from_file(cls, path: Path | str | None) -> Lpips:
        """Read the weights. MissingLibraryError without a file, or for one that lacks a tensor or has another form."""
        from safetensors.torch import load_file

        return cls(load_file(str(check_lpips(path))))

    def __call__(self, image: np.ndarray, reference: np.ndarray) -> float:
        """LPIPS of two images; 0 for equal ones. NumericsError for shapes that differ and values outside [0, 1]."""
        if image.shape != reference.shape or image.ndim != 3 or image.shape[2] != 3:
            raise NumericsError(f"cannot compare images of shapes {image.shape} and {reference.shape}",
                                expected="[H, W, 3] both")  # fmt: skip
        for values in (image, reference):
            if not (np.isfinite(values).all() and values.min() >= -1e-4 and values.max() <= 1 + 1e-4):
                raise NumericsError(
                    f"LPIPS was given values from {values.min():g} to {values.max():g}",
                    expected="display values in [0, 1] (sRGB), not linear light, bytes or [-1, 1]",
                )
        with torch.no_grad():
            first, second = (self._features(x) for x in (image, reference))
            total = 0.0
            for layer, (a, b) in enumerate(zip(first, second, strict=True)):
                weight = self.weights[f"lin{layer}.model.1.weight"]
                total += float(functional.conv2d((_unit(a) - _unit(b)) ** 2, weight).mean())
        return total

    def _features(self, image: np.ndarray) -> list[torch.Tensor]:
        x = torch.from_numpy(np.ascontiguousarray(image, np.float32)).permute(2, 0, 1)[None]
        x = (2 * x - 1 - torch.tensor(_SHIFT)[:, None, None]) / torch.tensor(_SCALE)[:, None, None]
        layers = []
        for block, indices in enumerate(BLOCKS):
            if block:
                x = functional.max_pool2d(x, 2)
            for index in indices:
                kernel, bias = self.weights[f"features.{index}.weight"], self.weights[f"features.{index}.bias"]
                x = functional.relu(functional.conv2d(x, kernel, bias, padding=1))
            layers.append(x)
        return layers


def _unit(features: torch.Tensor) -> torch.Tensor:
    return features / (features.norm(dim=1, keepdim=True) + 1e-10)
