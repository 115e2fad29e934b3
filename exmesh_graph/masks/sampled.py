"""Colours of pictures between their pixels."""

from __future__ import annotations

import numpy as np
import torch

from exmesh_graph.gpu.warp_runtime import launch


def sampled(picture: np.ndarray, places: np.ndarray) -> np.ndarray:
    """float32 [..., C] of a picture float32 [H, W, C] at places [2, ...], rows and columns as of `pinhole`: bilinear.

    NaN outside the middles of the outer pixels, and beside a pixel that is NaN. On this thread; `map_coordinates` of
    SciPy is the plain form.
    """
    from exmesh_graph.masks.kernels import look_up

    height, width, channels = picture.shape
    at = np.ascontiguousarray(np.moveaxis(places, 0, -1), np.float64)
    found = np.full((*at.shape[:-1], channels), np.nan, np.float32)
    if found.size:
        flat = torch.from_numpy(np.ascontiguousarray(picture, np.float32).reshape(-1))
        launch(
            look_up, found.size // channels, 0, height, width, channels, flat, torch.from_numpy(at.reshape(-1, 2)),
            torch.from_numpy(found.reshape(-1)),
        )  # fmt: skip
    return found
