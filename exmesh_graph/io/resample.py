"""Colours of pictures between their pixels; a place is (row, column), 0 in the middle of the first pixel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import torch

_MARGIN = 12
"""Pixels beyond a picture in which a spline still follows its edge, to 1e-7 of what changes there."""


def bilinear(picture: np.ndarray, places: np.ndarray) -> np.ndarray:
    """float32 [..., C] of a picture float32 [H, W, C] at places [2, ...].

    NaN outside the middles of the outer pixels, and beside a pixel that is NaN. On this thread; `map_coordinates` of
    SciPy is the plain form.
    """
    import torch

    from exmesh_graph.gpu.warp_runtime import launch
    from exmesh_graph.io.kernels_resample import look_up

    height, width, channels = picture.shape
    found = np.full((*places.shape[1:], channels), np.nan, np.float32)
    if found.size:
        flat = torch.from_numpy(np.ascontiguousarray(picture, np.float32).reshape(-1))
        at, into = _listed(places), torch.from_numpy(found.reshape(-1))
        launch(look_up, len(at), 0, height, width, channels, flat, at, into)
    return found


def cubic(picture: np.ndarray, places: np.ndarray) -> np.ndarray:
    """float32 [..., C] of the cubic spline through a picture float32 [H, W, C] at places [2, ...] (Unser, Aldroubi and
    Eden 1993). The picture's edges go on outside.

    On this thread; `map_coordinates` of SciPy with `order=3, mode="nearest"` is the plain form.
    """
    import torch

    from exmesh_graph.gpu.warp_runtime import launch
    from exmesh_graph.io.kernels_resample import look_up_smoothly, spline_lines

    padded = np.pad(np.asarray(picture, np.float32), ((_MARGIN, _MARGIN), (_MARGIN, _MARGIN), (0, 0)), mode="edge")
    height, width, channels = padded.shape
    found = np.empty((*places.shape[1:], channels), np.float32)
    if found.size:
        flat, row = torch.from_numpy(padded.reshape(-1)), width * channels
        launch(spline_lines, row, 0, height, row, row, 0, flat)
        launch(spline_lines, height * channels, 0, width, channels, channels, row, flat)
        at, into = _listed(places), torch.from_numpy(found.reshape(-1))
        launch(look_up_smoothly, len(at), 0, height, width, channels, _MARGIN, flat, at, into)
    return found


def _listed(places: np.ndarray) -> torch.Tensor:
    """float64 [P, 2] of [2, ...]."""
    import torch

    return torch.from_numpy(np.ascontiguousarray(places.reshape(2, -1).T, np.float64))
