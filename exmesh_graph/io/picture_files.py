"""The files that the pictures and masks of a large set go into."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from exmesh_graph.io.images import linear_of_codes
from exmesh_graph.types.pictures import PictureFiles, integer_codes


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
