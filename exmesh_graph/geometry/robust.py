"""Medians over views, of which some show nothing."""

from __future__ import annotations

import numpy as np
import torch

from exmesh_graph.gpu.warp_runtime import launch


def robust(colours: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(median [P, C], 1.4826 times the median absolute deviation [P], count [P]) of colours [K, P, C] that are no NaN.

    The deviation is that of the channels' mean: the standard deviation of normal errors. NaN where there is none. A
    point is NaN in all channels of a view, or in none. Float32 colours of at most 64 views take a kernel, on this
    thread.
    """
    from exmesh_graph.geometry.kernels_robust import MOST, medians

    views, points, channels = colours.shape
    if views > MOST or colours.dtype != np.float32 or not colours.size:
        return plain(colours)
    middle, deviation = np.full((points, channels), np.nan, np.float32), np.full(points, np.nan, np.float32)
    count = np.zeros(points, np.int64)
    flat = (torch.from_numpy(part.reshape(-1)) for part in (np.ascontiguousarray(colours), middle, deviation, count))
    launch(medians, points, 0, views, points, channels, *flat)
    return middle, deviation, count


def plain(colours: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `robust`, in numpy."""
    count = np.isfinite(colours[..., 0]).sum(axis=0)
    middle = np.stack([_median(colours[..., c], count) for c in range(colours.shape[-1])], axis=-1)
    return middle, 1.4826 * _median(np.abs(colours - middle).mean(axis=-1), count), count


def _median(values: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Over the first axis [K, P] of the `count` [P] that are no NaN: these are sorted first."""
    ordered = np.sort(values, axis=0)
    low, high = (np.clip(row, 0, None)[None] for row in ((count - 1) // 2, count // 2))
    high = np.minimum(high, len(values) - 1)
    return (np.take_along_axis(ordered, low, 0)[0] + np.take_along_axis(ordered, high, 0)[0]) / 2
