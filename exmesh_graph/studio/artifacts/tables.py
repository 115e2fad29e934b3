"""Artifacts as tables, figures, curves, cameras and points."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from exmesh_graph.report.collect import curves_of
from exmesh_graph.studio.artifacts.shelf import Arrays, NoArtifact
from exmesh_graph.studio.values import plain
from exmesh_graph.types import Artifact, Metrics, PlanarGaussians, PointCloud, SceneNeeds, Transport

_DECISION = ("name", "value", "gain", "error", "cost", "seconds_ratio", "reason")
_Y0 = 0.28209479177387814  # 1 / (2 sqrt(pi)), the first spherical harmonic
MOST_POINTS = (20_000, 200_000, 2_000_000)
"""Points in the levels of a cloud."""


def table_of(value: Artifact) -> dict[str, Any]:
    """A table: decisions of a probe, what the rays of a transport met. Raises NoArtifact where there is none."""
    if isinstance(value, Transport):
        return {"columns": ["what", "value", "unit"], "rows": transport_facts(value), "note": ""}
    if isinstance(value, SceneNeeds):
        made = [{"name": name, **asdict(one)} for name, one in value.decisions.items()]
        note = ", ".join(f"{name} {figure:.4g}" for name, figure in value.geometry.items())
        return _table(made, note)
    rows: list[Any] = [*decision_rows(value.values)] if isinstance(value, Metrics) else []
    if not rows:
        raise NoArtifact(f"{value.type_name} has no table")
    return _table(rows, "")


def decision_rows(values: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """What a Metrics artifact says under `decisions`."""
    told = values.get("decisions")
    return [one for one in told if isinstance(one, Mapping)] if isinstance(told, list) else []


def figures_of(values: Mapping[str, Any]) -> dict[str, Any]:
    """Headline figures, and all named numbers below them."""
    headline = [dict(one) for one in values.get("headline") or () if isinstance(one, Mapping)]
    return {"headline": plain(headline), "values": plain(_without_lists(values))}


def curve_facts(values: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Histories of a Metrics artifact."""
    return [{"name": c.name, "axis": c.axis, "x": c.positions, "y": c.values} for c in curves_of(values, "")]


def transport_facts(light: Transport) -> list[list[Any]]:
    """[what, value, unit] of a transport."""
    import numpy as np

    rays = len(light.directions) * max(len(light.points), 1)
    sky = int(np.unpackbits(light.visible).sum()) if light.visible.size < 1 << 28 else 0
    return [
        ["surface points", len(light.points), ""], ["directions", len(light.directions), ""],
        ["rays that see the sky", round(100 * sky / rays, 2), "%"],
        ["rays that meet the mesh", round(100 * len(light.hit_point) / rays, 2), "%"],
        ["bounces", light.bounces, ""], ["steps along an edge, at most", int(light.steps.max(initial=0)), ""],
        ["light from the mesh carries its colour", bool(light.secondary_material), ""],
        ["weights of the bounce", 0 if light.gather_weight is None else len(light.gather_weight), ""],
    ]  # fmt: skip


def camera_facts(arrays: Arrays) -> dict[str, Any]:
    """Cameras of views: OpenCV axes, row-major, in the normalised world."""
    import numpy as np

    shape = arrays.shapes()["alpha"]
    poses, lenses = arrays.whole("camera_to_world"), arrays.whole("intrinsics")
    cameras = [
        {"name": str(name), "camera_to_world": [float(x) for x in pose.reshape(-1)],
         "intrinsics": [float(x) for x in lens.reshape(-1)], "width": shape[2], "height": shape[1]}
        for name, pose, lens in zip(arrays.meta()["names"], poses, lenses, strict=True)
    ]  # fmt: skip
    reach = float(np.linalg.norm(poses[:, :3, 3], axis=1).max()) if len(poses) else 1.0
    return {"cameras": cameras, "center": [0.0, 0.0, 0.0], "radius": 1.0, "reach": reach}


def point_rows(value: Artifact, level: int) -> bytes:
    """uint32 count, uint32 floats a point, then float32 rows: x y z, r g b (display), of Gaussians also the standard
    deviations along their two axes, the opacity, and 0. Chosen evenly where a level has fewer than all.
    """
    import numpy as np

    if isinstance(value, PlanarGaussians):
        colours = np.clip(0.5 + _Y0 * value.sh[:, 0], 0, 1)
        wide = np.exp(np.sort(value.scales, axis=1)[:, 1:])
        opacity = 1 / (1 + np.exp(-value.opacities))
        rows = np.column_stack([value.means, colours, wide, opacity, np.zeros(len(value))])
    elif isinstance(value, PointCloud):
        rows = np.column_stack([value.points, value.colours])
    elif isinstance(value, Transport):
        sky = np.unpackbits(value.visible, axis=1, bitorder="little").mean(axis=1)
        rows = np.column_stack([value.points, np.repeat(sky[:, None], 3, axis=1)])
    else:
        raise NoArtifact(f"{value.type_name} has no points")
    most = MOST_POINTS[min(level, len(MOST_POINTS) - 1)]
    if len(rows) > most:
        rows = rows[np.linspace(0, len(rows) - 1, most).astype(np.int64)]
    return struct.pack("<II", *rows.shape) + np.ascontiguousarray(rows, "<f4").tobytes()


def _table(rows: list[Any], note: str) -> dict[str, Any]:
    columns = [name for name in _DECISION if any(name in row for row in rows)]
    return {"columns": columns, "rows": [[plain(row.get(name)) for name in columns] for row in rows], "note": note}


def _without_lists(value: Any) -> Any:
    """Named values without histories, which are curves."""
    if isinstance(value, Mapping):
        told = {str(key): _without_lists(item) for key, item in value.items() if key != "headline"}
        return {key: item for key, item in told.items() if item is not None and item != {}}
    if isinstance(value, list):
        return value if len(value) <= 4 and all(not isinstance(item, Mapping | list) for item in value) else None
    return value
