"""An asset under another light."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from exmesh_graph.io.envmaps import shift_columns
from exmesh_graph.types import Asset


def relit(asset: Asset, radiance: np.ndarray | None = None, *, rotation: float = 0.0, exposure: float = 0.0) -> Asset:
    """`asset` with its environment exchanged for `radiance` [h, w, 3] (canonical lat-long; None: its own).

    rotation   [rad], counter-clockwise about +Y seen from above: what shone from +Z shines from +X at pi/2
    exposure   [stops]: radiance is multiplied by 2^exposure
    """
    light = asset.environment if radiance is None else radiance
    return replace(asset, environment=turned(light, rotation) * np.float32(2.0**exposure))


def turned(radiance: np.ndarray, rotation: float) -> np.ndarray:
    """A canonical lat-long map [h, w, C] turned by `rotation` [rad] about +Y, as `relit` says.

    u falls with longitude, so texels move left by w rotation / 2 pi; linear between columns: rows keep their sums.
    """
    columns = rotation / (2 * math.pi) * radiance.shape[1]
    return shift_columns(np.asarray(radiance, np.float32), round(columns, 6))
