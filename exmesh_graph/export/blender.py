"""Blender as the judge of an exported file: a child process imports it and renders its cameras with Cycles.

Blender's Python module `bpy` (PyPI) needs one Python version and brings its own libraries, so it lives in an
environment of its own, named by the path of its Python. A child, because importing a broken file may crash it.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.export.usd.read import UsdCamera, open_usd, read_camera, read_usd, select_variant
from exmesh_graph.export.usd.rules import Problem
from exmesh_graph.io.images import display, read_image

CHILD = Path(__file__).with_name("blender_child.py")  # not in the key: code=
MIN_PSNR, MIN_IOU = 28.0, 0.97
"""Below these an import has lost or turned something: map, axis, colour space (28 dB catches gross faults only)."""


@dataclass(frozen=True)
class BlenderSettings:
    """python   a Python with `bpy`
    samples     paths per pixel
    script      Python run in Blender after the import, with `bpy` and `values`
    transparent background as alpha 0; False shows the light itself
    save        also keep the scene as this .blend file
    """

    python: Path
    samples: int = 64
    threads: int = 1
    seed: int = 0
    script: str = ""
    values: Mapping[str, Any] | None = None
    transparent: bool = True
    hide_meshes: bool = False
    save: Path | None = None


def render_in_blender(
    usd: Path,
    settings: BlenderSettings,
    *,
    cameras: Sequence[str] | None = None,
    variants: Mapping[str, str] | None = None,
    scale: float = 1.0,
) -> dict[str, np.ndarray]:
    """View -> float32 [H, W, 4], linear, premultiplied, of the file's own cameras (all, or those of `cameras`).

    variants are chosen on the asset; `scale` multiplies the pictures' sides. Raises DataError when Blender fails.
    """
    known = {camera.view: camera for camera in _cameras(usd)}
    chosen = list(known) if cameras is None else list(cameras)
    strange = [view for view in chosen if view not in known]
    if strange or not chosen:
        raise DataError(
            f"the file has no camera {strange[0]!r}" if strange else "the file has no cameras",
            where=str(usd),
            expected=f"one of {', '.join(known) or 'none'}",
            fix="wire the views into export.usd, and open scene.usda or its package",
        )
    with tempfile.TemporaryDirectory(prefix="exmesh-blender-") as folder:
        opened = usd if not variants else _with_variants(usd, variants, Path(folder) / "chosen.usda")
        files = [Path(folder) / f"{number}.exr" for number in range(len(chosen))]
        pictures = [
            {"camera": camera.prim, "width": round(camera.width * scale), "height": round(camera.height * scale),
             "file": str(file)}
            for camera, file in zip((known[view] for view in chosen), files, strict=True)
        ]  # fmt: skip
        _run(opened, settings, pictures, Path(folder) / "job.json")
        return {view: read_image(file) for view, file in zip(chosen, files, strict=True)}


def compare_with_blender(
    usd: Path, settings: BlenderSettings, view: str | None = None, variants: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Blender's picture of one of the file's cameras (default: the first) against this project's own render of it.

    Returns view, psnr and psnr_linear [dB] over pixels that both cover wholly, whole_psnr, iou of the coverage, gain
    (Blender / ours, one per channel), and the two linear premultiplied pictures "blender" and "ours" [H, W, 4].
    """
    from exmesh_graph.evaluate.metrics.image import psnr
    from exmesh_graph.stage2.render import render_views

    contents = read_usd(usd, variants)
    views = {camera.view: camera for camera in contents.cameras}
    pictures = render_in_blender(
        usd, settings, cameras=[view or next(iter(views))] if views else None, variants=variants
    )
    view, theirs = next(iter(pictures.items()))
    camera = views[view]
    rendered = render_views(
        contents.asset(), camera.intrinsics[None], contents.normalised_pose(camera)[None], camera.height, camera.width,
        bounces=2, supersampling=3, specular_samples=32,
    )  # fmt: skip
    ours = np.concatenate([rendered.images[0], rendered.alpha[0][..., None]], axis=-1)
    inside = (theirs[..., 3] > 0.999) & (ours[..., 3] > 0.999)
    shown, ours_shown = (display(picture[..., :3], picture[..., 3]) for picture in (theirs, ours))
    linear, ours_linear = (np.clip(picture[..., :3], 0, 1) for picture in (theirs, ours))
    cover = np.minimum(theirs[..., 3], ours[..., 3]).sum() / np.maximum(theirs[..., 3], ours[..., 3]).sum()
    gain = theirs[inside][:, :3].mean(0) / np.maximum(ours[inside][:, :3].mean(0), 1e-9)
    return {
        "view": view,
        "psnr": psnr(shown, ours_shown, inside),
        "psnr_linear": psnr(linear, ours_linear, inside),
        "whole_psnr": psnr(shown, ours_shown),
        "iou": float(cover),
        "gain": [float(g) for g in gain],
        "blender": theirs,
        "ours": ours,
    }


def judged(usd: Path, python: Path) -> list[Problem]:
    """What Blender says of the file's first camera: a note with the figures, an error below MIN_PSNR or MIN_IOU."""
    try:
        figures = compare_with_blender(usd, BlenderSettings(python))
    except DataError as error:
        return [Problem("blender", str(usd), ": ".join(filter(None, (error.what, error.fix))))]
    gain = " ".join(f"{value:.3f}" for value in figures["gain"])
    what = f"{figures['psnr']:.1f} dB from our picture on the object, IoU {figures['iou']:.4f}, Blender / ours {gain}"
    good = figures["psnr"] >= MIN_PSNR and figures["iou"] >= MIN_IOU
    return [Problem("blender", f"camera {figures['view']}", what, "note" if good else "error")]


def camera_names(usd: Path) -> list[str]:
    """The views that the file's cameras show, in its order."""
    return [camera.view for camera in _cameras(usd)]


def _cameras(usd: Path) -> tuple[UsdCamera, ...]:
    from pxr import UsdGeom

    stage = open_usd(usd)  # held: its prims expire with it
    return tuple(read_camera(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Camera))


def _with_variants(usd: Path, variants: Mapping[str, str], file: Path) -> Path:
    """A layer over `usd` that chooses the variants, as a user would in a shot."""
    from pxr import Sdf, Usd

    under = open_usd(usd)
    layer = Sdf.Layer.CreateNew(str(file))
    layer.subLayerPaths.append(str(usd.resolve()))
    stage = Usd.Stage.Open(layer)
    for key in ("upAxis", "metersPerUnit", "defaultPrim"):
        stage.SetMetadata(key, under.GetMetadata(key))
    for name, choice in variants.items():
        select_variant(stage, name, choice, layer)
    layer.Save()
    return file


def _run(usd: Path, settings: BlenderSettings, pictures: list[dict[str, Any]], job: Path) -> None:
    files = {"usd": usd.resolve(), "save": settings.save.resolve() if settings.save else ""}
    entries = {**vars(settings), "values": dict(settings.values or {}), "pictures": pictures, **files}
    job.write_text(json.dumps(entries, default=str), encoding="utf-8")
    # its own environment: what this project put on the path is not for it
    # not in the key: Blender's own process
    environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")}
    try:
        done = subprocess.run(  # not in the key: what it is called with is, its script by code=
            [str(settings.python), str(CHILD), str(job)], capture_output=True, text=True, check=False, env=environment
        )
    except OSError as error:
        raise DataError(
            f"Blender's Python cannot be started ({error})", where=str(settings.python), fix=_INSTALL
        ) from error
    missing = [picture["file"] for picture in pictures if not Path(picture["file"]).is_file()]
    if done.returncode or missing:
        lines = (done.stderr.strip() or done.stdout.strip()).splitlines()
        raise DataError(
            f"Blender ended with code {done.returncode} and without {len(missing)} of {len(pictures)} pictures: "
            f"{lines[-1] if lines else 'it said nothing'}",
            where=str(usd),
            fix=_INSTALL if "No module named 'bpy'" in done.stderr else "exmesh check-usd may say more",
        )


_INSTALL = "python3.11 -m venv bpy; bpy/bin/pip install bpy==5.0.1; then give bpy/bin/python"
