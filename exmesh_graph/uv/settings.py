"""Settings of atlases: parameters of the nodes that make them, declared once. Imports nothing heavy."""

from __future__ import annotations

from exmesh_graph.params import Params, param


class AtlasSettings(Params):
    """What every atlas needs (`uv.unwrap`)."""

    padding: int = param(4, ge=0, le=64, unit="texels", doc="Space kept free between charts.")
    cut_nonmanifold: bool = param(
        True, doc="Cut a non-manifold mesh open where it is, with a warning, instead of refusing it."
    )


class DiscSettings(AtlasSettings):
    """Charts that are nearly flat discs of our own (`uv.layout`)."""

    bend: float = param(
        0.45,
        gt=0.0,
        lt=1.0,
        doc="How far a chart may bend, 1 - |mean normal|^2: more, fewer and more stretched charts.",
    )


class XatlasSettings(AtlasSettings):
    """The charts of xatlas (`uv.xatlas_charts`)."""

    max_cost: float = param(2.0, gt=0.0, le=64.0, doc="xatlas: larger gives fewer and more stretched charts.")
    chart_iterations: int = param(1, ge=1, le=8, doc="xatlas: rounds of chart growing.")
    max_seconds: float = param(
        120.0,
        gt=0.0,
        unit="s",
        doc="When xatlas is not done by then, uv.unwrap's charts take its place, with a warning.",
    )
