"""The truth of rendered scenes: mesh, test-view albedo and roughness, the light, and relit pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.cameras import UpAxis
from exmesh_graph.io.color import srgb_to_linear
from exmesh_graph.io.envmaps import canonical_from_blender, read_environment
from exmesh_graph.io.images import read_image, read_photo
from exmesh_graph.io.meshes import read_mesh
from exmesh_graph.io.normalise import points_to_normalised
from exmesh_graph.io.shots import Shot, downscale_area
from exmesh_graph.types import Frame, SceneTruth

_MESHES = ("mesh/mesh.obj", "mesh/mesh.ply", "mesh.obj", "mesh.ply")
_LIGHTS = ("env_train.exr", "env_train.hdr")
_MAP_FOLDERS = ("envmaps", "../envmaps", "test_rli/envmaps")


def truth_files(folder: Path, test: Sequence[Shot], hdr: bool, up: UpAxis) -> list[Path]:
    """Every file that `load_truth` reads."""
    files = [f for f in (_first(folder, _MESHES), _first(folder, _LIGHTS) if up == "z" else None) if f]
    for ending in ("_albedo.png", "_rough.png"):
        files += _maps(test, ending)
    for name, pictures in _relit_pictures(folder, test, hdr).items():
        light = _relit_light(folder, name)
        if light is not None and up == "z":
            files += [light, *pictures]
    return files


def load_truth(
    folder: Path, test: Sequence[Shot], frame: Frame, downscale: int, hdr: bool, up: UpAxis
) -> tuple[SceneTruth, list[str]]:
    """What the folder knows beside its photographs, in the normalised world, and notes on what was left out.

    Albedo is kept linear and not multiplied by alpha; both maps are averaged over the covered part of a pixel.
    Environments are Blender's, which is defined for z up only: with another up axis they are left out with a note.
    """
    notes: list[str] = []
    mesh = _first(folder, _MESHES)
    vertices, faces = read_mesh(mesh) if mesh else (None, None)
    if vertices is not None:
        vertices = points_to_normalised(vertices, frame).astype(np.float32)
    light = _first(folder, _LIGHTS)
    relit, relit_alpha = {}, {}
    pictures = _relit_pictures(folder, test, hdr)
    if up != "z" and (light or pictures):
        notes.append(f"environment maps were left out: their orientation is known for up: z only, not {up}")
        light, pictures = None, {}
    for name, files in pictures.items():
        source = _relit_light(folder, name)
        if source is None:
            places = ", ".join(f"{place}/{name}.exr" for place in _MAP_FOLDERS)
            notes.append(f"relit pictures {name!r} were left out: no environment in {places}")
            continue
        photos = [read_photo(file) for file in files]
        images = np.stack([downscale_area(photo.rgb, downscale, f) for photo, f in zip(photos, files, strict=True)])
        relit[name] = (canonical_from_blender(read_environment(source)), images)
        relit_alpha[name] = np.stack([downscale_area(photo.alpha, downscale) for photo in photos])
    truth = SceneTruth(
        names=tuple(shot.name for shot in test),
        mesh_vertices=vertices,
        mesh_faces=faces,
        albedo=_covered_mean(_maps(test, "_albedo.png"), downscale, color=True),
        roughness=_roughness(test, downscale),
        environment=canonical_from_blender(read_environment(light)) if light else None,
        relit=relit,
        relit_alpha=relit_alpha,
    )
    return truth, notes


def _first(folder: Path, names: Sequence[str]) -> Path | None:
    return next((folder / name for name in names if (folder / name).is_file()), None)


def _base(shot: Shot) -> str:
    return shot.image.name.removesuffix(shot.image.suffix).removesuffix("_rgba")


def _maps(test: Sequence[Shot], ending: str) -> list[Path]:
    """The map of each test view; none at all, or DataError where only some are there."""
    files = [shot.image.with_name(_base(shot) + ending) for shot in test]
    there = [file for file in files if file.is_file()]
    if there and len(there) < len(files):
        missing = next(file for file in files if not file.is_file())
        raise DataError(
            "the truth map does not exist, though those of other test views do", where=str(missing),
            fix="restore it, or set truth: false",
        )  # fmt: skip
    return there


def _relit_pictures(folder: Path, test: Sequence[Shot], hdr: bool) -> dict[str, list[Path]]:
    """{environment name: picture of each test view}, from test_rli/<environment>_<view>.exr or .png."""
    place = folder / "test_rli"
    if not place.is_dir() or not test:
        return {}
    ending = ".exr" if hdr and any(place.glob("*.exr")) else ".png"
    last = _base(test[0])
    names = sorted(f.name.removesuffix(f"_{last}{ending}") for f in place.glob(f"*_{last}{ending}"))
    found = {}
    for name in names:
        files = [place / f"{name}_{_base(shot)}{ending}" for shot in test]
        missing = [file for file in files if not file.is_file()]
        if missing:
            raise DataError(
                "the relit picture does not exist, though those of other test views do", where=str(missing[0]),
                fix="restore it, or set truth: false",
            )  # fmt: skip
        found[name] = files
    return found


def _relit_light(folder: Path, name: str) -> Path | None:
    return _first(folder, [f"{place}/{name}{ending}" for place in _MAP_FOLDERS for ending in (".exr", ".hdr")])


def _covered_mean(files: Sequence[Path], factor: int, *, color: bool) -> np.ndarray | None:
    """Stack of maps reduced by `factor`, each pixel weighted with its own alpha (RGBA pictures)."""
    if not files:
        return None
    out = []
    for file in files:
        pixels = read_image(file)
        if pixels.shape[2] not in (3, 4):
            raise DataError(f"the albedo map has {pixels.shape[2]} channels", where=str(file), expected="RGB or RGBA")
        weight = pixels[..., 3] if pixels.shape[2] == 4 else np.ones(pixels.shape[:2], np.float32)
        values = srgb_to_linear(pixels[..., :3]) if color else pixels[..., :3]
        out.append(_weighted(values, weight, factor))
    return np.stack(out)


def _roughness(test: Sequence[Shot], factor: int) -> np.ndarray | None:
    files = _maps(test, "_rough.png")
    if not files:
        return None
    out = []
    for shot, file in zip(test, files, strict=True):
        pixels = read_image(file)[..., :1]
        weight = read_photo(shot.image).alpha if factor > 1 else np.ones(pixels.shape[:2], np.float32)
        out.append(_weighted(pixels, weight, factor)[..., 0])
    return np.stack(out)


def _weighted(values: np.ndarray, weight: np.ndarray, factor: int) -> np.ndarray:
    if factor == 1:
        return values.astype(np.float32)
    total = downscale_area(weight, factor)[..., None]
    summed = downscale_area(values * weight[..., None], factor)
    return np.where(total > 0, summed / np.maximum(total, 1e-6), 0).astype(np.float32)
