"""Appearance models of Stage I: what `stage1.init` takes as its `appearance`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from exmesh_graph.graph import Component, component, param

if TYPE_CHECKING:
    from exmesh_graph.types import Stage1State


class Appearance(Component):
    """Base of the appearance models."""

    def begin(self, state: Stage1State, seed: int, device: str) -> Stage1State:
        """The state with this model's first values, read from its texture."""
        raise NotImplementedError


@component("appearance.uv_texture", version="1")
class UvTexture(Appearance):
    """The paper's RGB texture over the UV atlas; the default."""

    def begin(self, state: Stage1State, seed: int, device: str) -> Stage1State:
        return state


@component("appearance.per_vertex", version="1", libraries=("torch", "warp-lang", "scipy"))
class PerVertex(Appearance):
    """One colour per vertex, interpolated over the faces; splits interpolate it, and the texture is baked from it."""

    def begin(self, state: Stage1State, seed: int, device: str) -> Stage1State:
        from exmesh_graph.stage1.appearance.state import per_vertex

        return per_vertex(state)


@component("appearance.per_face", version="1", libraries=("torch", "warp-lang", "scipy"))
class PerFace(Appearance):
    """One colour per face; parts of a split face keep it, and the texture is baked from it."""

    def begin(self, state: Stage1State, seed: int, device: str) -> Stage1State:
        from exmesh_graph.stage1.appearance.state import per_face

        return per_face(state)


@component("appearance.mlp", version="1", libraries=("torch", "warp-lang", "scipy"))
class Mlp(Appearance):
    """A small network from place to colour (positional encoding, three layers); the texture is baked from it."""

    frequencies: int = param(
        6, ge=0, le=12, unit="octaves", doc="Of the positional encoding; the first spans the object."
    )
    width: int = param(64, ge=4, le=512, unit="units", doc="Of the two hidden layers.")

    def begin(self, state: Stage1State, seed: int, device: str) -> Stage1State:
        from exmesh_graph.stage1.appearance.state import mlp

        return mlp(state, frequencies=self.frequencies, width=self.width, seed=seed, device=device)
