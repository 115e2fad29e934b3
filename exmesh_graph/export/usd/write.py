"""Exporting an asset as USD, for DCC tools. The files (docs/usd.md; `asset` stands for the asset's name):

asset.usda      the component, light-free, without arrays: reference this one into other scenes
payload.usda, geo.usdc, mtl.usda   what it loads (export.usd.layers)
textures/       base_color.png (sRGB), roughness.png, normal.png and metallic.png where fitted (raw)
env.exr         the recovered environment, OpenEXR lat-long on the Y-up world
scene.usda      references asset.usda and adds the dome light and the capture cameras
asset.usdz      scene.usda with all it needs in one package: what one double-clicks
asset_ar.usdz   the component in one flat layer, without light: for augmented reality
export.json     what the export measured, and where the asset comes from
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.export.content import LODS, AssetContent, camera_contents, mesh_content, mesh_report, place
from exmesh_graph.export.folder import new_folder
from exmesh_graph.export.inputs import check_asset, check_name, check_views, clipped, without_vanished
from exmesh_graph.export.maps import prepare_maps, to_codes, write_environment, write_map
from exmesh_graph.export.packing import write_usdz
from exmesh_graph.export.settings import ExportSettings
from exmesh_graph.export.usd import layers
from exmesh_graph.export.usd.gate import validate_usd
from exmesh_graph.export.usd.rules import Pictures
from exmesh_graph.types import Asset, Frame, Views
from exmesh_graph.version import __version__

Plain = str | int | float


def write_usd(
    folder: Path,
    asset: Asset,
    frame: Frame | None = None,
    views: Views | None = None,
    *,
    lods: Mapping[str, Asset] | None = None,
    settings: ExportSettings | None = None,
    provenance: Mapping[str, Plain | Mapping[str, Plain]] | None = None,
) -> dict[str, Any]:
    """Write `asset` into the new `folder`; return the export's report (also written as export.json).

    asset       maps linear, environment canonical; points in the normalised world
    frame       its similarity returns the points to the scene's own units (Y-up kept); None: normalised units
    views       become the cameras of scene.usda
    lods        coarser versions, "mid" and "low", with the same maps apart from those that hold other values
    provenance  plain values for `customData.recon`: what the asset comes from

    Everything is checked before the first byte is written, written beside `folder`, judged by the gate, and moved
    there at the end: no half or broken asset is ever seen under its name. Equal inputs give equal bytes. Warnings of
    the gate are in the report's "problems". Raises DataError, GeometryError or NumericsError.
    """
    settings = settings or ExportSettings()
    check_name(settings.name)
    counts: dict[str, int] = {}
    if settings.clip:
        asset, counts = clipped(asset)
    levels = _levels(asset, lods or {})
    if views is not None:
        check_views(views)
    maps, report = prepare_maps(asset, settings, settings.normal_bits)
    report |= counts
    content, files = _content(levels, maps, frame, views, settings, report)
    _demand(settings, report)

    with new_folder(folder) as partial:
        (partial / "textures").mkdir()
        for file, codes in files.items():
            write_map(partial / "textures" / file, codes, srgb=file.startswith("base_color"))
        if asset.confidence is not None:  # no renderer reads it: it lies beside the maps, named in the custom data
            write_map(partial / "textures" / "confidence.png", to_codes(asset.confidence[..., None]))
            report["confidence_map"] = "textures/confidence.png"
        error = write_environment(partial / "env.exr", asset.environment)
        report["environment_size"] = [int(n) for n in asset.environment.shape[:2]]
        report["environment_rounding"] = float(f"{error:.3g}")
        report["gate"] = "passed" if settings.gate else "skipped"
        plain = {key: int(value) if isinstance(value, bool) else value
                 for key, value in report.items() if isinstance(value, str | int | float)}  # fmt: skip
        report["provenance"] = {"tool": "exmesh-graph", "version": __version__, **(provenance or {})}
        content = replace(content, provenance={**plain, **report["provenance"]})
        _write_layers(partial, content, sorted(files))
        written = sorted(path for path in partial.rglob("*") if path.is_file())
        report["bytes"] = {str(path.relative_to(partial)): path.stat().st_size for path in written}
        if settings.gate:
            report["problems"] = _judge(partial, settings.name)
        text = json.dumps(report, sort_keys=True, indent=1, allow_nan=False)
        (partial / "export.json").write_text(text + "\n", encoding="utf-8")
    return report


def _levels(asset: Asset, lods: Mapping[str, Asset]) -> dict[str, Asset]:
    """The levels of detail, finest first, checked."""
    strange = sorted(set(lods) - set(LODS[1:]))
    if strange:
        raise DataError(f"unknown level of detail {strange[0]!r}", where="lods", expected="mid or low")
    levels = {"high": asset, **{lod: lods[lod] for lod in LODS if lod in lods}}
    for lod, level in levels.items():
        check_asset(level, lod if lods else "asset")
    return {lod: without_vanished(level) for lod, level in levels.items()}


def _content(
    levels: Mapping[str, Asset],
    maps: Mapping[str, np.ndarray],
    frame: Frame | None,
    views: Views | None,
    settings: ExportSettings,
    report: dict[str, Any],
) -> tuple[AssetContent, dict[str, np.ndarray]]:
    """The prims' data in scene units, and the texture files' codes; what is found out is added to `report`."""
    high = levels["high"]
    placement = place(frame, settings.up_axis, recentre=settings.recentre)
    report |= mesh_report(high, placement) | placement.report
    meshes = {lod: mesh_content(level, placement) for lod, level in levels.items()}
    codes = {"high": maps}
    for lod, level in levels.items():
        if lod != "high":
            codes[lod] = {**maps, **_own_maps(high, level, settings)}
            report[f"faces_{lod}"] = len(level.faces)
    if any("normal" in own for own in codes.values()):  # a level without one reads a flat one
        codes = {lod: {"normal": _flat_normal(settings.normal_bits), **own} for lod, own in codes.items()}
    names: dict[str, dict[str, str]] = {}
    files: dict[str, np.ndarray] = {}
    for lod, own in codes.items():
        for name, pixels in own.items():
            file = f"{name}.png" if pixels is codes["high"].get(name) else f"{name}_{lod}.png"
            names.setdefault(lod, {})[name] = file
            files[file] = pixels
    reach = float(np.linalg.norm(meshes["high"].points - placement.offset, axis=1).max())
    content = AssetContent(
        name=settings.name,
        meshes=meshes,
        files=names,
        placement=placement,
        cameras=() if views is None else camera_contents(views, placement, reach),
    )
    return content, files


def _demand(settings: ExportSettings, report: Mapping[str, Any]) -> None:
    """Raise what the settings require and the asset does not have."""
    if settings.require_scale and report["scale"] != "measured":
        raise DataError(
            f"the metric scale is {report['scale']}", where="export.usd", expected="a measured one (require_scale)",
            fix="give the loader metres_per_unit and wire its frame in",
        )  # fmt: skip
    if settings.require_closed and not (report["closed"] and report["manifold"]):
        raise DataError(
            f"the mesh is {'not manifold' if report['closed'] else 'open'}", where="export.usd",
            expected="a closed manifold mesh (require_closed)", fix="init.clean closes holes",
        )  # fmt: skip


def _own_maps(high: Asset, level: Asset, settings: ExportSettings) -> dict[str, np.ndarray]:
    """The maps of a coarser level that hold other values than those of the finest one."""

    def same(name: str) -> bool:
        ours, theirs = getattr(level, name), getattr(high, name)
        return ours is theirs or (ours is not None and theirs is not None and np.array_equal(ours, theirs))

    names = [name for name in ("base_color", "roughness", "metallic", "normal") if not same(name)]
    prepared = prepare_maps(level, settings, settings.normal_bits)[0] if names else {}
    return {name: prepared[name] for name in names if name in prepared}


def _flat_normal(bits: int) -> np.ndarray:
    return to_codes(np.broadcast_to(np.array([0.5, 0.5, 1.0]), (4, 4, 3)), bits)


def _write_layers(folder: Path, content: AssetContent, textures: list[str]) -> None:
    name = content.name
    # what a layer refers to is there before it: composing it would warn otherwise
    authors = {"geo.usdc": layers.author_geometry, "mtl.usda": layers.author_materials,
               "payload.usda": layers.author_payload, f"{name}.usda": layers.author_root,
               "scene.usda": layers.author_scene}  # fmt: skip
    for file, author in authors.items():
        layers.save_layer(folder / file, author, content)
    members = [*reversed(authors), "env.exr", *(f"textures/{file}" for file in textures)]
    write_usdz(folder / f"{name}.usdz", [(member, folder / member) for member in members])
    flat = folder / "flat.usdc"
    layers.save_layer(flat, layers.author_flat, content)
    own = [f"textures/{file}" for file in textures if file in content.files["high"].values()]
    write_usdz(folder / f"{name}_ar.usdz", [(f"{name}.usdc", flat), *((member, folder / member) for member in own)])
    flat.unlink()


def _judge(folder: Path, name: str) -> list[str]:
    """Warnings of the gate; DataError for any error. The package holds what scene.usda holds, and is its layout."""
    pictures = Pictures()
    found = [
        (file, problem)
        for file in (f"{name}.usda", "scene.usda", f"{name}.usdz", f"{name}_ar.usdz")
        for problem in validate_usd(folder / file, pictures)
    ]
    errors = [f"\n    {file}: {problem}" for file, problem in found if problem.level == "error"]
    if errors:
        raise DataError(
            f"the export does not pass its gate:{''.join(errors)}", where="export.usd", expected="no error",
            fix="mend what the rule names (docs/usd.md); nothing was published",
        )  # fmt: skip
    return sorted({f"{problem.rule}: {problem.what}" for _, problem in found})
