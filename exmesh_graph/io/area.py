"""Pictures at a fraction of their size, and the files that a large set of them goes into."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.images import linear_of_codes
from exmesh_graph.types.pictures import PictureFiles, integer_codes


def downscale_area(image: np.ndarray, factor: int, where: Path | str = "") -> np.ndarray:
    """Exact mean over factor x factor blocks of [H, W] or [H, W, C]; DataError unless factor divides H and W."""
    if factor == 1:
        return image
    height, width = image.shape[:2]
    if height % factor or width % factor:
        fits = [f for f in range(2, 17) if height % f == 0 and width % f == 0]
        raise DataError(
            f"{width} x {height} pixels cannot be reduced by {factor}", where=str(where),
            expected="a factor that divides width and height", fix=f"downscale: one of {fits or [1]}",
        )  # fmt: skip
    blocks = image.reshape(height // factor, factor, width // factor, factor, *image.shape[2:])
    # numpy's mean over two axes walks through memory in short steps; sums in float64 are exact in any order
    rows = blocks[:, 0].astype(np.float64)
    for k in range(1, factor):
        rows += blocks[:, k]
    total = rows[:, :, 0]
    for k in range(1, factor):
        total = total + rows[:, :, k]
    return (total / factor**2).astype(np.float32)


class Files(NamedTuple):
    """Where pictures and masks of a large set go."""

    images: PictureFiles
    alpha: PictureFiles

    @classmethod
    def of(cls, count: int, height: int, width: int) -> Files:
        kinds = (np.dtype(np.uint8), np.dtype(np.uint16))
        curves = {kind.str: linear_of_codes(kind) for kind in kinds}
        lines = {kind.str: np.arange(np.iinfo(kind).max + 1, dtype=np.float32) / np.float32(np.iinfo(kind).max)
                 for kind in kinds}  # fmt: skip
        return cls(PictureFiles((count, height, width, 3), curves), PictureFiles((count, height, width), lines))

    def put(self, number: int, rgb: np.ndarray, alpha: np.ndarray, codes: np.ndarray | None) -> None:
        coverage = integer_codes(alpha)
        if codes is not None and codes.shape[2] == 3 and coverage is not None and (alpha < 1).any():
            same = coverage.dtype == codes.dtype  # a mask beside an opaque picture
            codes = np.dstack([codes, coverage]) if same else None
        self.images.put(number, rgb, codes)
        self.alpha.put(number, alpha, coverage)
