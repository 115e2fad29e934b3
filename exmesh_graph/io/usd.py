"""Exporting an asset as USD, for DCC tools: `write_usd`, `read_usd`, `validate_usd`.

Files written (docs/usd.md):
    asset.usdc      the component, light-free: reference this one into other scenes
    textures/       base_color.png (sRGB), roughness.png, normal.png and metallic.png where fitted (raw)
    env.exr         the recovered environment, OpenEXR lat-long on the Y-up world
    scene.usda      references asset.usdc and adds the dome light
    asset.usdz      scene.usda's composition in one self-contained package: what one double-clicks
    export.json     what the export measured
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from exmesh_graph import __version__
from exmesh_graph.errors import DataError
from exmesh_graph.io.usd_checks import check_asset, check_name
from exmesh_graph.io.usd_mesh import mesh_report, scene_geometry
from exmesh_graph.io.usd_package import write_usdz
from exmesh_graph.io.usd_read import UsdContents, read_usd
from exmesh_graph.io.usd_stage import (
    StageContent,
    author_asset_layer,
    author_flat_layer,
    author_scene_layer,
    save_layer,
)
from exmesh_graph.io.usd_textures import prepare_maps, to_bytes, write_environment, write_map
from exmesh_graph.io.usd_validate import Problem, validate_usd
from exmesh_graph.types import Asset, Frame

__all__ = ["Problem", "UsdContents", "read_usd", "validate_usd", "write_usd"]


def write_usd(
    folder: Path,
    asset: Asset,
    frame: Frame | None = None,
    *,
    name: str = "asset",
    roughness_floor: float = 0.04,
    dilation: int = 8,
    provenance: Mapping[str, str | int | float] | None = None,
) -> dict[str, Any]:
    """Write `asset` into the new `folder`; return the export's report (also written as export.json).

    asset            maps linear, environment canonical; points in the normalised world
    frame            its similarity returns the points to the scene's own units (Y-up kept); None: normalised units
    roughness_floor  lowest roughness written: below it, highlights are spikes that renderers disagree about
    dilation         texels by which charts are padded
    provenance       further plain values for `customData.recon`

    Everything is checked before the first byte is written, written beside `folder`, and moved there at the end, so
    that no half asset is ever seen. Equal inputs give equal bytes. Raises DataError, GeometryError or NumericsError.
    """
    check_name(name)
    check_asset(asset)
    if folder.exists():
        raise DataError("the target exists", where=str(folder), fix="remove it, or export to another folder")
    maps, report = prepare_maps(asset, roughness_floor=roughness_floor, dilation=dilation)
    content = _content(name, asset, frame, maps, report)

    folder.parent.mkdir(parents=True, exist_ok=True)
    partial = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        (partial / "textures").mkdir()
        for map_name, pixels in maps.items():
            write_map(partial / "textures" / f"{map_name}.png", pixels)
        if asset.confidence is not None:  # no renderer reads it: it lies beside the maps, named in the custom data
            write_map(partial / "textures" / "confidence.png", to_bytes(asset.confidence[..., None]))
            report["confidence_map"] = "textures/confidence.png"
        error = write_environment(partial / "env.exr", asset.environment)
        report["environment_size"] = [int(n) for n in asset.environment.shape[:2]]
        report["environment_rounding"] = float(f"{error:.3g}")
        plain = {key: value for key, value in report.items() if isinstance(value, str | int | float)}
        content = replace(
            content, provenance={"tool": "exmesh-graph", "version": __version__, **plain, **(provenance or {})}
        )
        _write_layers(partial, content)
        text = json.dumps(report, sort_keys=True, indent=1, allow_nan=False)
        (partial / "export.json").write_text(text + "\n", encoding="utf-8")
        partial.chmod(0o755)
        partial.rename(folder)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise
    return report


def _content(
    name: str, asset: Asset, frame: Frame | None, maps: Mapping[str, np.ndarray], report: dict[str, Any]
) -> StageContent:
    """The prims' data in scene units; what is found out on the way is added to `report`."""
    points, normals, rotation, scale = scene_geometry(asset, frame)
    report |= mesh_report(asset) | scale
    used, inverse = np.unique(asset.uv_faces, return_inverse=True)  # only the texture vertices that faces use
    return StageContent(
        name=name,
        points=points,
        normals=normals,
        faces=asset.faces.astype(np.int32),
        st=np.clip(asset.uvs[used], 0.0, 1.0).astype(np.float32),
        st_faces=inverse.reshape(-1, 3).astype(np.int32),
        maps=tuple(sorted(maps)),
        metres_per_unit=float(report["metres_per_unit"]),
        rotation=rotation,
    )


def _write_layers(folder: Path, content: StageContent) -> None:
    save_layer(folder / "asset.usdc", author_asset_layer, content)
    save_layer(folder / "scene.usda", author_scene_layer, content)
    flat = folder / "flat.usdc"
    save_layer(flat, author_flat_layer, content)
    textures = [(f"textures/{name}.png", folder / "textures" / f"{name}.png") for name in content.maps]
    write_usdz(folder / "asset.usdz", [("asset.usdc", flat), ("env.exr", folder / "env.exr"), *textures])
    flat.unlink()
