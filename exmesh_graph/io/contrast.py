"""Pictures of even contrast, in which features are as many in the dark and on smooth paint as elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter

from exmesh_graph.io.images import read_raw, write_image

#: Of the longer side: spread of the neighbourhood whose mean and deviation are made alike.
REACH = 1 / 60
#: Deviation of a neighbourhood afterwards, and what is added to it before (display values): noise alone stays faint.
DEVIATION, FLOOR = 0.18, 0.03


def even_pictures(images: Sequence[Path], folder: Path, threads: int) -> None:
    """Gray pictures of even contrast by the same names into `folder`, which is made. Raises DataError naming a file."""
    folder.mkdir()

    def made(image: Path) -> None:
        write_image(folder / image.name, even_contrast(_gray(read_raw(image))))

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(made, images))


def even_contrast(gray: np.ndarray) -> np.ndarray:
    """(v - mean) / (deviation + floor) of display values [H, W] in [0, 1], mean and deviation of a neighbourhood.

    The mean goes to 1/2, and the deviation to 0.18 where it was far above `FLOOR`.
    """
    reach = REACH * max(gray.shape)
    off = gray - gaussian_filter(gray, reach)
    deviation = np.sqrt(gaussian_filter(off**2, reach) + FLOOR**2)
    return np.clip(0.5 + DEVIATION * off / deviation, 0, 1)


def _gray(codes: np.ndarray) -> np.ndarray:
    """Display values [H, W] in [0, 1] of codes [H, W, C]: the mean of the colours."""
    colours = codes[..., :3] if codes.shape[2] > 2 else codes[..., :1]
    top = np.iinfo(codes.dtype).max if codes.dtype.kind == "u" else 1
    return np.asarray(colours.mean(axis=2, dtype=np.float64) / top)
