"""The files that the pictures and masks of a large set go into."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from exmesh_graph.io.images import linear_of_codes
from exmesh_graph.types import Views
from exmesh_graph.types.pictures import PictureFiles, integer_codes, too_large

Picture = tuple[np.ndarray, np.ndarray, np.ndarray | None]
"""Linear colour times alpha float32 [H, W, 3], alpha float32 [H, W], and the file's codes where they are unchanged."""


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


def with_pictures(views: Views, pictures: Iterable[Picture], height: int, width: int) -> Views:
    """The views with these pictures of `height` x `width`, one for each view in order; a large set goes into files."""
    if too_large(len(views), height, width):
        files = Files.of(len(views), height, width)
        for number, picture in enumerate(pictures):
            files.put(number, *picture)
        return replace(views, images=files.images.stack(), alpha=files.alpha.stack())
    made = list(pictures)
    return replace(views, images=np.stack([rgb for rgb, _, _ in made]), alpha=np.stack([alpha for _, alpha, _ in made]))
