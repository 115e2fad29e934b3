"""The truth of rendered scenes: mesh, test-view albedo and roughness, the light, and relit pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.color import srgb_to_linear
from exmesh_graph.io.envmaps import canonical_from_blender, read_environment
from exmesh_graph.io.images import read_image, read_photo
from exmesh_graph.io.meshes import read_mesh
from exmesh_graph.io.normalise import points_to_normalised
from exmesh_graph.io.reduce import downscale_area
from exmesh_graph.io.settings import UpAxis
from exmesh_graph.io.shots import Shot
from exmesh_graph.io.truth_files import LIGHTS, MAP_FOLDERS, first_of, mesh_file, relit_light, relit_pictures, test_maps
from exmesh_graph.types import Frame, SceneTruth


def load_truth(
    folder: Path, test: Sequence[Shot], frame: Frame, downscale: int, hdr: bool, up: UpAxis, true_mesh: str = ""
) -> tuple[SceneTruth, list[str]]:
    """What the folder knows beside its photographs, in the normalised world, and notes on what was left out.

    Albedo is kept linear and not multiplied by alpha; both maps are averaged over the covered part of a pixel.
    Environments are Blender's, which is defined for z up only: with another up axis they are left out with a note.
    `true_mesh`, below the folder, in place of the usual ones; DataError where it is not there.
    """
    notes: list[str] = []
    mesh = mesh_file(folder, true_mesh)
    vertices, faces = read_mesh(mesh) if mesh else (None, None)
    if vertices is not None:
        vertices = points_to_normalised(vertices, frame).astype(np.float32)
    light = first_of(folder, LIGHTS)
    relit, relit_alpha = {}, {}
    pictures = relit_pictures(folder, test, hdr)
    if up != "z" and (light or pictures):
        notes.append(f"environment maps were left out: their orientation is known for up: z only, not {up}")
        light, pictures = None, {}
    for name, files in pictures.items():
        source = relit_light(folder, name)
        if source is None:
            places = ", ".join(f"{place}/{name}.exr" for place in MAP_FOLDERS)
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
        albedo=_covered_mean(test_maps(test, "_albedo.png"), downscale),
        roughness=_roughness(test, downscale),
        environment=canonical_from_blender(read_environment(light)) if light else None,
        relit=relit,
        relit_alpha=relit_alpha,
    )
    return truth, notes


def _covered_mean(files: Sequence[Path], factor: int) -> np.ndarray | None:
    """Stack of maps reduced by `factor`, each pixel weighted with its own alpha (RGBA pictures)."""
    if not files:
        return None
    out = []
    for file in files:
        pixels = read_image(file)
        if pixels.shape[2] not in (3, 4):
            raise DataError(f"the albedo map has {pixels.shape[2]} channels", where=str(file), expected="RGB or RGBA")
        weight = pixels[..., 3] if pixels.shape[2] == 4 else np.ones(pixels.shape[:2], np.float32)
        out.append(_weighted(srgb_to_linear(pixels[..., :3]), weight, factor))
    return np.stack(out)


def _roughness(test: Sequence[Shot], factor: int) -> np.ndarray | None:
    files = test_maps(test, "_rough.png")
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
