"""Appearance models of Stage I: what `stage1.init` and `stage1.refine` take as their `appearance`."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal

from exmesh_graph.graph import Component, component, param

if TYPE_CHECKING:
    from collections.abc import Callable

    from exmesh_graph.types import Carrier, Stage1State, Views


class Appearance(Component):
    """Base of the appearance models; `kind` is what a state that holds the model calls it."""

    kind: ClassVar[str] = ""

    def decided(self, views: Views, surface: Carrier, log: Callable[[str], None]) -> Appearance:
        """The model for these photographs of a rough surface: this one, unless it is a choice among others."""
        return self

    def begin(self, state: Stage1State, seed: int, device: str) -> Stage1State:
        """The state with this model's first values, read from its texture."""
        raise NotImplementedError


@component("appearance.uv_texture", version="1")
class UvTexture(Appearance):
    """The paper's RGB texture over the UV atlas; the default."""

    kind: ClassVar[str] = "uv_texture"

    def begin(self, state: Stage1State, seed: int, device: str) -> Stage1State:
        from dataclasses import replace

        return replace(state, appearance=self.kind, model={})


@component("appearance.directional", version="1", libraries=("torch", "warp-lang", "scipy"))
class Directional(Appearance):
    """The texture, and on each vertex a small residual that is a low harmonic of the direction of view, for gloss and
    lights that follow the camera; Stage II and exports see the texture alone."""

    kind: ClassVar[str] = "directional"
    order: Literal[1, 2] = param(2, doc="Highest order of the spherical harmonics: 3 or 8 functions.")
    shrinkage: float = param(0.1, ge=0, doc="Weight of the residual's mean square.")
    rate: float = param(1.0, gt=0, le=100, doc="Step of the residual over that of a texel.")

    def begin(self, state: Stage1State, seed: int, device: str) -> Stage1State:
        from exmesh_graph.stage1.appearance.state import directional

        return directional(state, order=self.order, shrinkage=self.shrinkage, rate=self.rate)


@component("appearance.auto", version="1", libraries=("torch", "warp-lang", "scipy", "OpenImageIO"))
class Auto(Appearance):
    """The texture alone; where parts of the object change their brightness much with the direction of view, as gloss
    and metal do, the texture with a directional residual, so that the shape does not have to explain it."""

    kind: ClassVar[str] = "auto"
    gloss: float = param(
        0.25, ge=0, unit="stops", doc="Robust deviation of a part's brightness between views from which on it is much."
    )

    def decided(self, views: Views, surface: Carrier, log: Callable[[str], None]) -> Appearance:
        from exmesh_graph.stage1.exposure import exposures

        spread = exposures(views, surface).spread
        much = spread >= self.gloss
        chosen = "a residual by direction beside the texture" if much else "the texture alone"
        log(
            f"appearance: {chosen}. Parts of the object differ by {spread:.2f} stops from view to view, "
            f"here {self.gloss:.2f} would be much."
        )
        return Directional() if much else UvTexture()


@component("appearance.per_vertex", version="1", libraries=("torch", "warp-lang", "scipy"))
class PerVertex(Appearance):
    """One colour per vertex, interpolated over the faces; splits interpolate it, and the texture is baked from it."""

    kind: ClassVar[str] = "per_vertex"

    def begin(self, state: Stage1State, seed: int, device: str) -> Stage1State:
        from exmesh_graph.stage1.appearance.state import per_vertex

        return per_vertex(state)


@component("appearance.per_face", version="1", libraries=("torch", "warp-lang", "scipy"))
class PerFace(Appearance):
    """One colour per face; parts of a split face keep it, and the texture is baked from it."""

    kind: ClassVar[str] = "per_face"

    def begin(self, state: Stage1State, seed: int, device: str) -> Stage1State:
        from exmesh_graph.stage1.appearance.state import per_face

        return per_face(state)


@component("appearance.mlp", version="1", libraries=("torch", "warp-lang", "scipy"))
class Mlp(Appearance):
    """A small network from place to colour (positional encoding, three layers); the texture is baked from it."""

    kind: ClassVar[str] = "mlp"
    frequencies: int = param(
        6, ge=0, le=12, unit="octaves", doc="Of the positional encoding; the first spans the object."
    )
    width: int = param(64, ge=4, le=512, unit="units", doc="Of the two hidden layers.")

    def begin(self, state: Stage1State, seed: int, device: str) -> Stage1State:
        from exmesh_graph.stage1.appearance.state import mlp

        return mlp(state, frequencies=self.frequencies, width=self.width, seed=seed, device=device)
