"""Pictures of scored results: views beside their photographs, materials, light, atlas, geometry."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from exmesh_graph.gallery.models import add_model
from exmesh_graph.gallery.pictures import (
    ERROR_TOP,
    GalleryWriter,
    asset_maps,
    environment_panels,
    error_map,
    marked,
    shrink,
)
from exmesh_graph.gallery.shaded import shaded_geometry
from exmesh_graph.types import Asset, Carrier, Gallery, SceneTruth, ScoredViews

_SHARES = (
    " Last: what counts, outlined ({region:.0%} of the picture), of it missing in magenta ({covered:.1%} is covered), "
    "surface outside it in cyan ({leaked:.1%} of ours)."
)
_ERRORS = f"Error: mean over the channels of display colours, brightest at {ERROR_TOP:g}."


def asset_gallery(root: Path, asset: Asset, scored: ScoredViews, truth: SceneTruth | None = None) -> Gallery:
    """The scored pairs of pictures, the light (beside `truth`'s), atlas, geometry and a model of a finished asset."""
    writer = GalleryWriter(root)
    _add_pairs(writer, scored, "Held-out view", "Ours")
    _add_light(writer, asset, truth)
    _add_atlas(writer, asset)
    _add_geometry(writer, asset, scored)
    add_model(writer, asset, "Finished asset", scored.camera_to_world[:3, 3])
    return writer.finish()


def carrier_gallery(root: Path, carrier: Carrier, scored: ScoredViews) -> Gallery:
    """The scored views of the textured mesh, its geometry, a model and its texture."""
    writer = GalleryWriter(root)
    _add_pairs(writer, scored, "Stage I, held-out view", "The mesh with its RGB texture")
    _add_geometry(writer, carrier, scored)
    add_model(writer, carrier, "Stage I", scored.camera_to_world[:3, 3], by_texture=True)
    writer.add("texture", "RGB texture", "The atlas as Stage I left it.", [shrink(carrier.texture)])
    return writer.finish()


def _add_pairs(writer: GalleryWriter, scored: ScoredViews, held_out: str, ours: str) -> None:
    """A strip for each pair: ours, the truth, their error; `held_out` and `ours` are words for titles and captions."""
    for number, (what, (first, second)) in enumerate(zip(scored.pairs, scored.images.astype(np.float32), strict=True)):
        file, title, caption = _words(what, held_out, ours)
        if what["kind"] == "indirect":
            writer.add(file, title, caption, [first, second])
            continue
        panels = [first, second, error_map(first, second)]
        if what["kind"] == "held_out" and scored.marks is not None:
            panels.append(marked(second, scored.marks[number]))
            caption += _SHARES.format(**what["figures"])
        writer.add(file, title, caption, panels, compare=True)


def _words(what: Mapping[str, Any], held_out: str, ours: str) -> tuple[str, str, str]:
    """(file, title, caption) of a pair."""
    kind, name, figures = what["kind"], what["name"], what["figures"]
    if kind == "held_out":
        caption = f"{ours}, photograph, error: {figures['psnr']:.1f} dB. {_ERRORS}"
        return f"held_out_{what['number']:03d}", f"{held_out} {name}", caption
    if kind == "relit":
        caption = (
            f"A light that the fit never saw: ours, truth, error. All views {figures['psnr']:.1f} dB "
            f"({figures['psnr_unscaled']:.1f} dB without the albedo scale, gray object "
            f"{figures['psnr_floor']:.1f} dB). {_ERRORS}"
        )
        return f"relit_{name}", f"Relit by {name}", caption
    if kind == "albedo":
        scale = ", ".join(f"{x:.2f}" for x in figures["scale"])
        caption = f"Ours times the scale ({scale}) that brings its median to the truth's; truth; error. {_ERRORS}"
        return "albedo", "Base colour", caption
    if kind == "roughness":
        return "roughness", "Roughness", f"Ours, truth (white is 1), error at the scale of {ERROR_TOP:g}."
    caption = f"View {name} as rendered; of it, the light that met the surface more than once."
    return "indirect", "Interreflected light", caption


def _add_light(writer: GalleryWriter, asset: Asset, truth: SceneTruth | None) -> None:
    if truth is not None and truth.environment is not None:
        true, ours = environment_panels([truth.environment, asset.environment])
        caption = "Recovered, true; one exposure. Its scale against the base colour's follows from highlights alone."
        writer.add("environment", "Environment", caption, [ours, true], compare=True)
    else:
        caption = "As recovered: lat-long, up is up, the centre looks along +Z."
        if asset.light_axis is not None:
            caption = "As recovered, moving with the camera: lat-long, the centre is behind the photographer."
        writer.add("environment", "Environment", caption, environment_panels([asset.environment]))


def _add_atlas(writer: GalleryWriter, asset: Asset) -> None:
    maps, size = asset_maps(asset), asset.base_color.shape[0]
    writer.add("atlas", "Texture atlas", f"{size} x {size}: {', '.join(maps)}.", list(maps.values()))


def _add_geometry(writer: GalleryWriter, mesh: Carrier, scored: ScoredViews) -> None:
    height, width = scored.images.shape[2:4]
    panels = shaded_geometry(
        mesh, scored.intrinsics, scored.camera_to_world, height, width, scale=max(1.0, 384 / height)
    )  # fmt: skip
    caption = f"Clay, face normals (x, y, z as red, green, blue), edges; {len(mesh.faces)} faces, view {scored.view}."
    writer.add("geometry", "Geometry", caption, panels)
