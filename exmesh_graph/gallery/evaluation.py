"""The galleries of the evaluation nodes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from exmesh_graph.evaluate.scores import AssetScores, spread
from exmesh_graph.evaluate.scores_mesh import CarrierScores
from exmesh_graph.gallery.models import add_model
from exmesh_graph.gallery.pictures import ERROR_TOP, GalleryWriter, environment_panels, error_map, shrink
from exmesh_graph.gallery.shaded import shaded_geometry
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.types import Asset, Carrier, Gallery, SceneTruth, Views

_ERRORS = f"Error: mean over the channels of display colours, brightest at {ERROR_TOP:g}."


def asset_gallery(
    root: Path,
    asset: Asset,
    views: Views,
    scores: AssetScores,
    truth: SceneTruth | None = None,
    *,
    count: int = 3,
) -> Gallery:
    """Held-out and relit views, materials, light, atlas and geometry; `count` views of each."""
    writer = GalleryWriter(root)
    held_out = scores.values["held_out"]["psnr_per_view"]
    for k in spread(len(scores.held_out), count):
        ours, true = scores.held_out[k]
        name = views.names[scores.views[k]]
        writer.add(
            f"held_out_{k:03d}",
            f"Held-out view {name}",
            f"Ours, photograph, error: {held_out[name]:.1f} dB. {_ERRORS}",
            [ours, true, error_map(ours, true)],
            compare=True,
        )
    for light, pairs in scores.relit.items():
        figures = scores.values["relit"]["per_light"][light]
        for k in spread(len(pairs), 1):
            ours, true = pairs[k]
            writer.add(
                f"relit_{light}",
                f"Relit by {light}",
                f"A light that the fit never saw: ours, truth, error. All views {figures['psnr']:.1f} dB "
                f"({figures['psnr_unscaled']:.1f} dB without the albedo scale, gray object "
                f"{figures['psnr_floor']:.1f} dB). {_ERRORS}",
                [ours, true, error_map(ours, true)],
                compare=True,
            )
    for k in spread(len(scores.albedo), 1):
        ours, true = scores.albedo[k]
        scale = ", ".join(f"{x:.2f}" for x in scores.values["material"]["albedo_scale"])
        writer.add(
            "albedo",
            "Base colour",
            f"Ours times the scale ({scale}) that brings its median to the truth's; truth; error. {_ERRORS}",
            [ours, true, error_map(ours, true)],
            compare=True,
        )
    for k in spread(len(scores.roughness), 1):
        ours, true = scores.roughness[k]
        error = error_map(ours[..., None], true[..., None])
        writer.add("roughness", "Roughness", f"Ours, truth (white is 1), error at the scale of {ERROR_TOP:g}.",
                   [ours, true, error], compare=True)  # fmt: skip
    if scores.indirect is not None:
        view, whole, alone = scores.indirect
        writer.add(
            "indirect",
            "Interreflected light",
            f"View {views.names[view]} as rendered; of it, the light that met the surface more than once.",
            [whole, alone],
        )
    _add_light(writer, asset, truth)
    _add_atlas(writer, asset)
    _add_geometry(writer, asset, views, scores.views)
    add_model(writer, asset, "Finished asset", _eye(views, scores.views))
    return writer.finish()


def carrier_gallery(root: Path, carrier: Carrier, views: Views, scores: CarrierScores, *, count: int = 2) -> Gallery:
    """Held-out views of the textured mesh, its geometry, its texture."""
    writer = GalleryWriter(root)
    for k in spread(len(scores.held_out), count):
        ours, true = scores.held_out[k]
        name = views.names[scores.views[k]]
        figure = scores.values["held_out"]["psnr_per_view"][name]
        writer.add(
            f"held_out_{k:03d}",
            f"Stage I, held-out view {name}",
            f"The mesh with its RGB texture, photograph, error: {figure:.1f} dB. {_ERRORS}",
            [ours, true, error_map(ours, true)],
            compare=True,
        )
    _add_geometry(writer, carrier, views, scores.views)
    add_model(writer, carrier, "Stage I", _eye(views, scores.views), by_texture=True)
    writer.add("texture", "RGB texture", "The atlas as Stage I left it.", [shrink(carrier.texture)])
    return writer.finish()


def _eye(views: Views, chosen: list[int]) -> np.ndarray:
    """Where the camera of the geometry's picture stands."""
    return np.asarray(views.camera_to_world[chosen[len(chosen) // 2]][:3, 3])


def _add_light(writer: GalleryWriter, asset: Asset, truth: SceneTruth | None) -> None:
    if truth is not None and truth.environment is not None:
        true, ours = environment_panels([truth.environment, asset.environment])
        caption = "Found, true; one exposure. Its scale against the base colour's follows from highlights alone."
        writer.add("environment", "Environment", caption, [ours, true], compare=True)
    else:
        caption = "As found: lat-long, up is up, the centre looks along +Z."
        writer.add("environment", "Environment", caption, environment_panels([asset.environment]))


def _add_atlas(writer: GalleryWriter, asset: Asset) -> None:
    panels = [linear_to_srgb(shrink(asset.base_color)), shrink(asset.roughness)]
    words = ["base colour", "roughness"]
    if asset.metallic is not None:
        panels.append(shrink(asset.metallic))
        words.append("metallic")
    if asset.normal is not None:
        panels.append(shrink(0.5 + 0.5 * asset.normal))
        words.append("normals")
    if asset.confidence is None:
        panels.append(shrink(asset.seen.astype(np.float32)))
        words.append("texels that a training view saw")
    else:
        panels.append(shrink(asset.confidence))
        words.append("confidence (0 where no view saw the texel)")
    size = asset.base_color.shape[0]
    writer.add("atlas", "Texture atlas", f"{size} x {size}: {', '.join(words)}.", panels)


def _add_geometry(writer: GalleryWriter, mesh: Carrier, views: Views, chosen: list[int]) -> None:
    i = chosen[len(chosen) // 2]
    panels = shaded_geometry(
        mesh, views.intrinsics[i], views.camera_to_world[i], views.height, views.width,
        scale=max(1.0, 384 / views.height),
    )  # fmt: skip
    caption = (
        f"Clay, face normals (x, y, z as red, green, blue), edges; {len(mesh.faces)} faces, view {views.names[i]}."
    )
    writer.add("geometry", "Geometry", caption, panels)
