"""An edit as a user states it: region, operation, value, checked and carried out."""

from __future__ import annotations

import numpy as np

from exmesh_graph.edit.settings import EditParams
from exmesh_graph.edit.texels import ball_region, decal, edited, mask_region
from exmesh_graph.errors import DataError
from exmesh_graph.io.images import read_mask, read_photo
from exmesh_graph.types import Asset, Frame, Mesh, Views
from exmesh_graph.uv.surface import TexelSurface, texel_surface


def apply_edit(
    asset: Asset, settings: EditParams, views: Views | None = None, frame: Frame | None = None, *, where: str = ""
) -> tuple[Asset, np.ndarray]:
    """The edited asset and the weight [R, R] of the edit in each texel.

    The region is the product of what is given: mask, ball, the picture's own alpha; the whole atlas without any. With
    `frame`, `center` and `radius` are in scene units. Raises DataError for settings that contradict each other.
    """
    _check(settings, views, where)
    surface = texel_surface(asset, len(asset.base_color))
    weight = np.ones(asset.roughness.shape, np.float32)
    if settings.mask is not None:
        weight = weight * mask_region(read_mask(settings.mask), len(weight))
    ball = _ball(asset, settings, views, frame)
    if ball is not None:
        weight = weight * ball_region(surface, ball[0], ball[1], settings.feather)
    value = np.asarray(settings.value, np.float32)
    if settings.operation == "paint":
        painted, alpha = _painted(settings, surface, ball)
        weight = weight * alpha
        value = painted if settings.channel == "base_color" else painted.mean(axis=-1, keepdims=True)
    return edited(asset, settings.channel, weight, settings.operation, value), weight


def picked_point(mesh: Mesh, views: Views, view: str, pixel: tuple[float, float]) -> np.ndarray:
    """float64 [3], normalised world: where the ray through `pixel` (x right, y down; centres at +0.5) of `view` meets
    the mesh. Raises DataError for a view that does not exist, a pixel outside it and a ray that misses.
    """
    from exmesh_graph.rays import make_ray_tracer

    if view not in views.names:
        some = ", ".join(views.names[:8]) + (", ..." if len(views.names) > 8 else "")
        raise DataError(f"there is no view {view!r}", expected=f"one of {some}", fix="correct `view`")
    if not (0 <= pixel[0] <= views.width and 0 <= pixel[1] <= views.height):
        raise DataError(
            f"pixel ({pixel[0]:g}, {pixel[1]:g}) lies outside view {view}",
            expected=f"0 to {views.width}, 0 to {views.height}",
            fix="correct `pixel`: x to the right, y down, from the upper left corner",
        )
    number = views.names.index(view)
    pose = views.camera_to_world[number]
    in_camera = np.linalg.solve(views.intrinsics[number], np.array([*pixel, 1.0]))
    direction = pose[:3, :3] @ in_camera
    direction /= np.linalg.norm(direction)
    origin = pose[:3, 3]
    hits = make_ray_tracer(mesh.vertices, mesh.faces).closest_hit(origin[None], direction[None])
    distance = float(hits.t[0])
    if not np.isfinite(distance):
        raise DataError(
            f"pixel ({pixel[0]:g}, {pixel[1]:g}) of view {view} does not show the mesh",
            expected=f"a pixel on the object, in {views.width} x {views.height}",
            fix="correct `pixel`: x to the right, y down, from the upper left corner",
        )
    return origin + distance * direction


def _ball(
    asset: Asset, settings: EditParams, views: Views | None, frame: Frame | None
) -> tuple[np.ndarray, float] | None:
    """Middle and radius of the ball in normalised units."""
    if settings.radius == 0:
        return None
    scale = 1.0 if frame is None else float(np.cbrt(np.linalg.det(frame.scene_from_normalised[:3, :3])))
    if settings.pixel is not None:
        assert views is not None
        return picked_point(asset, views, settings.view, settings.pixel), settings.radius / scale
    center = np.asarray(settings.center, float)
    if frame is not None:
        center = np.linalg.solve(frame.scene_from_normalised, np.append(center, 1.0))[:3]
    return center, settings.radius / scale


def _painted(
    settings: EditParams, surface: TexelSurface, ball: tuple[np.ndarray, float] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Straight linear colour [R, R, 3] and alpha [R, R] of the picture at each texel."""
    assert settings.picture is not None
    photo = read_photo(settings.picture)
    layers = np.concatenate([photo.rgb, photo.alpha[..., None]], axis=-1)
    if ball is not None:
        laid = decal(surface, layers, ball[0], ball[1])
    else:
        laid = np.stack([mask_region(layers[..., c], surface.position.shape[0]) for c in range(4)], axis=-1)
    return laid[..., :3] / np.maximum(laid[..., 3:], 1e-6), laid[..., 3]


def _check(settings: EditParams, views: Views | None, where: str) -> None:
    """Raise DataError for what contradicts itself or is not enough."""
    operation, value = settings.operation, settings.value
    paint, picked = operation == "paint", settings.pixel is not None
    placed = picked or settings.center is not None
    least = "no less than 0" if operation == "scale" else "from 0 to 1 (base_color: linear RGB)"
    outside = any(number < 0 or (number > 1 and operation == "set") for number in value)
    for wrong, message, fix in (
        (paint and settings.picture is None,
         "nothing to paint with", "set `picture`, or operation: set with a `value`"),
        (not paint and settings.picture is not None,
         f"`picture` does nothing with operation: {operation}", "set operation: paint"),
        (not paint and not value, f"operation: {operation} has no `value`", "give one number, or three for base_color"),
        (paint and value, "`value` does nothing with operation: paint", "take it away, or set operation: set"),
        (outside, f"`value` {value} is out of range", f"give numbers {least}"),
        (picked != (settings.view != ""), "`view` and `pixel` belong together", "give both, or `center`"),
        (picked and settings.center is not None,
         "`center` and `pixel` both say where the ball is", "give one of them"),
        (picked and views is None, "`pixel` needs the cameras", 'wire `views: "@views.train"`'),
        (placed != (settings.radius > 0),
         "a ball needs a middle and a radius", "give `radius` with `center`, or with `view` and `pixel`"),
        (settings.feather > 0 and not placed,
         "`feather` belongs to a ball", "give `center` and `radius`, or soften the mask itself"),
    ):  # fmt: skip
        if wrong:
            raise DataError(message, where=where, fix=fix)
