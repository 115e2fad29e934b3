"""Appearance models of Stage I: what `stage1.init` takes as its `appearance`."""

from __future__ import annotations

from exmesh_graph.graph import Component, component


class Appearance(Component):
    """Base of the appearance models."""


@component("appearance.uv_texture", version="1")
class UvTexture(Appearance):
    """The paper's RGB texture over the UV atlas; the default."""
