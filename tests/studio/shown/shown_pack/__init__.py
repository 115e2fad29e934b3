"""Nodes that make things to look at in a second: an asset of any size, Gaussians."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from pydantic import Field

from exmesh_graph.graph import Context, Params, node
from exmesh_graph.types import Asset, PlanarGaussians


class AssetParams(Params):
    side: int = Field(default=20, ge=2, description="Vertices along a side.")
    maps: int = Field(default=64, ge=4, description="Texels along a side of the maps.")
    height: float = Field(default=0.1, description="Of the waves.")


class CloudParams(Params):
    count: int = Field(default=5000, ge=1, description="Gaussians.")


class AssetOut(NamedTuple):
    asset: Asset


class CloudOut(NamedTuple):
    gaussians: PlanarGaussians


@node("shown.asset", version="1")
def asset(ctx: Context, *, p: AssetParams) -> AssetOut:
    """A waved square with noise in its maps."""
    x, y = np.meshgrid(np.linspace(0, 1, p.side), np.linspace(0, 1, p.side))
    at = np.arange(p.side**2, dtype=np.int32).reshape(p.side, p.side)
    a, b, c, d = at[:-1, :-1].ravel(), at[:-1, 1:].ravel(), at[1:, 1:].ravel(), at[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    flat = np.stack([x.ravel(), y.ravel()], 1).astype(np.float32)
    waves = (p.height * np.sin(20 * flat[:, :1]) * np.cos(17 * flat[:, 1:])).astype(np.float32)
    dice, size = np.random.default_rng(1), (p.maps, p.maps)
    light = np.ones((16, 32, 3), np.float32)
    light[2:5, 4:9] = 20
    return AssetOut(Asset(
        vertices=np.concatenate([flat - 0.5, waves], 1), faces=faces, uvs=flat, uv_faces=faces,
        texture=dice.random((*size, 3), np.float32), base_color=dice.random((*size, 3), np.float32),
        roughness=dice.random(size, np.float32), normal=np.full((*size, 3), (0, 0, 1), np.float32),
        seen=np.ones(size, bool), environment=light,
    ))  # fmt: skip


@node("shown.cloud", version="1")
def cloud(ctx: Context, *, p: CloudParams) -> CloudOut:
    """Gaussians on a sphere."""
    dice = np.random.default_rng(2)
    means = dice.normal(size=(p.count, 3)).astype(np.float32)
    means /= np.linalg.norm(means, axis=1, keepdims=True)
    turns = dice.normal(size=(p.count, 4)).astype(np.float32)
    return CloudOut(PlanarGaussians(
        means=means, scales=np.full((p.count, 3), -4, np.float32), rotations=turns,
        opacities=np.full(p.count, 3, np.float32), sh=dice.normal(size=(p.count, 1, 3)).astype(np.float32),
    ))  # fmt: skip
