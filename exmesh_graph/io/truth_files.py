"""Where a rendered scene keeps its truth: finding the files, without reading them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from exmesh_graph.errors import DataError
from exmesh_graph.io.settings import UpAxis
from exmesh_graph.io.shots import Shot, all_or_none

MESHES = ("mesh/mesh.obj", "mesh/mesh.ply", "mesh.obj", "mesh.ply")
LIGHTS = ("env_train.exr", "env_train.hdr")
MAP_FOLDERS = ("envmaps", "../envmaps", "test_rli/envmaps")


def truth_files(folder: Path, test: Sequence[Shot], hdr: bool, up: UpAxis, true_mesh: str = "") -> list[Path]:
    """Every file that `load_truth` reads."""
    files = [f for f in (mesh_file(folder, true_mesh), first_of(folder, LIGHTS) if up == "z" else None) if f]
    for ending in ("_albedo.png", "_rough.png"):
        files += test_maps(test, ending)
    for name, pictures in relit_pictures(folder, test, hdr).items():
        light = relit_light(folder, name)
        if light is not None and up == "z":
            files += [light, *pictures]
    return files


def mesh_file(folder: Path, name: str = "") -> Path | None:
    """The true mesh: `name` below the folder (DataError where it is not there), or one of the usual ones."""
    if not name:
        return first_of(folder, MESHES)
    if not (folder / name).is_file():
        raise DataError(
            "there is no such true mesh", where=str(folder / name), expected="an OBJ or PLY file in the folder",
            fix=f"true_mesh: one of {', '.join(MESHES)}, or leave it out",
        )  # fmt: skip
    return folder / name


def first_of(folder: Path, names: Sequence[str]) -> Path | None:
    return next((folder / name for name in names if (folder / name).is_file()), None)


def _base(shot: Shot) -> str:
    return shot.image.name.removesuffix(shot.image.suffix).removesuffix("_rgba")


def test_maps(test: Sequence[Shot], ending: str) -> list[Path]:
    """The map of each test view; none at all, or DataError where only some are there."""
    files = [shot.image.with_name(_base(shot) + ending) for shot in test]
    return all_or_none(files, "the truth map", "restore it, or set truth: false")


def relit_pictures(folder: Path, test: Sequence[Shot], hdr: bool) -> dict[str, list[Path]]:
    """{environment name: picture of each test view}, from test_rli/<environment>_<view>.exr or .png."""
    place = folder / "test_rli"
    if not place.is_dir() or not test:
        return {}
    ending = ".exr" if hdr and any(place.glob("*.exr")) else ".png"
    last = _base(test[0])
    names = sorted(f.name.removesuffix(f"_{last}{ending}") for f in place.glob(f"*_{last}{ending}"))
    files = {name: [place / f"{name}_{_base(shot)}{ending}" for shot in test] for name in names}
    return {name: all_or_none(of, "the relit picture", "restore it, or set truth: false") for name, of in files.items()}


def relit_light(folder: Path, name: str) -> Path | None:
    return first_of(folder, [f"{place}/{name}{ending}" for place in MAP_FOLDERS for ending in (".exr", ".hdr")])
