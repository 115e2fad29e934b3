"""Are faults of cameras and pictures found? Faults put into clean scenes, and what the loaders' checks say of each.

    python -m benchmarks.camera_faults                                       # the sample
    python -m benchmarks.camera_faults graphs/samples/spot path/to/temple_ring path/to/dtu_scan24

A scene is a folder in the layout of NeRF-Synthetic, Middlebury or IDR. For every fault: whether it is an error, a
warning or not found, by which check, the probable cause that is told, and processor seconds of the checks. The first
row of a scene is the scene as it is, where anything that is found is a false alarm. For IDR's layout the last row says
what matches tell of half a pixel. Without masks the faults of masks are left out.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.blender import list_blender
from exmesh_graph.io.checks.finding import Finding
from exmesh_graph.io.checks.scene import check_cameras, check_world, principal_shift
from exmesh_graph.io.idr import list_idr
from exmesh_graph.io.load import Loaded, load_shots, shifted
from exmesh_graph.io.middlebury import list_middlebury
from exmesh_graph.io.normalise import sphere_from_cameras, sphere_from_masks
from exmesh_graph.io.settings import BlenderOptions, IdrOptions, MiddleburyOptions

SAMPLE = Path(__file__).parents[1] / "graphs" / "samples" / "spot"
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])
Scene = tuple[Loaded, Loaded, tuple[np.ndarray, float] | None]


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.camera_faults", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("scenes", type=Path, nargs="*", default=[SAMPLE])
    parser.add_argument("--quick", action="store_true", help="every third view only")
    parser.add_argument("--json", type=Path, help="write the rows here too")
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for path in options.scenes:
        fit, held, sphere = load(path)
        if options.quick:
            fit = chosen(fit, np.arange(0, len(fit.names), 3))
        masks = "masks" if fit.has_masks else "no masks"
        print(f"{path.name}: {len(fit.names)} views, {masks}", flush=True)
        for name, change in faults(fit):
            row = measure(name, change((fit, held, sphere)))
            rows.append({"scene": path.name, **row})
            print(
                f"  {name:32} {row['level']:8} {row['check']:15} {row['seconds']:4.1f} s  {row['cause'][:90]}",
                flush=True,
            )
        if sphere is not None:
            began = time.process_time()
            told = principal_shift(shifted(fit, -0.5))
            print(f"  half a pixel: {told[0]:g} is added; {told[1]} {time.process_time() - began:.1f} s", flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def load(path: Path) -> Scene:
    """(training views, test views, the files' own sphere) with the principal point as published or as matches say."""
    if any(path.glob("*_par.txt")):
        train, test = list_middlebury(path, MiddleburyOptions())
    elif any(path.glob("cameras*.npz")):
        train, test, sphere = list_idr(path, IdrOptions())
        fit, held = load_shots(train, split="training"), load_shots(test, split="test")
        offset, _ = principal_shift(fit)
        return shifted(fit, offset), shifted(held, offset), sphere
    else:
        train, test, _ = list_blender(path, BlenderOptions())
    return load_shots(train, split="training"), load_shots(test, split="test"), None


def measure(name: str, scene: Scene) -> dict[str, Any]:
    """What is found in a scene, the gravest first, and processor seconds."""
    fit, held, sphere = scene
    began = time.process_time()
    found: list[Finding] = check_cameras(fit, 0)
    if not any(finding.grave for finding in found):
        given = sphere is not None
        try:
            found += check_world(fit, held, *(sphere or _sphere(fit)), given)
        except DataError as error:
            found.append(Finding("normalisation", error.what, "", error.fix))
    found.sort(key=lambda finding: not finding.grave)
    row = {"fault": name, "seconds": time.process_time() - began, "level": "-", "check": "", "cause": ""}
    if found:
        first = found[0]
        row |= {"level": "error" if first.grave else "warning", "check": first.check, "cause": first.cause}
        row |= {"what": first.what, "views": list(first.views)}
    return row


def _sphere(fit: Loaded) -> tuple[np.ndarray, float]:
    if fit.has_masks:
        return sphere_from_masks(fit.silhouettes, fit.silhouette_intrinsics, fit.camera_to_world, wrong_masks=1)
    return sphere_from_cameras(fit.intrinsics, fit.camera_to_world, fit.alpha.shape[2], fit.alpha.shape[1])


def chosen(loaded: Loaded, rows: np.ndarray) -> Loaded:
    """Some of the views."""
    arrays = ("images", "alpha", "intrinsics", "camera_to_world", "silhouettes", "silhouette_intrinsics")
    names = tuple(loaded.names[row] for row in rows)
    return replace(loaded, names=names, **{name: getattr(loaded, name)[rows] for name in arrays})


def faults(fit: Loaded) -> Iterator[tuple[str, Callable[[Scene], Scene]]]:
    """(name, what it does to a scene); those of masks only where there are masks."""
    count = len(fit.names)
    one, two, other = count // 7, count // 5, count // 2
    rng = np.random.default_rng(0)
    c, s = np.cos(np.radians(8)), np.sin(np.radians(8))
    turn = np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1]])
    yield "none", lambda scene: scene
    yield "camera file for twice the size", _k([[2, 1, 2], [1, 2, 2], [1, 1, 1]])
    yield "camera file for half the size", _k([[0.5, 1, 0.5], [1, 0.5, 0.5], [1, 1, 1]])
    yield "focal length for twice the size", _k([[2, 1, 1], [1, 2, 1], [1, 1, 1]])
    yield "focal length 25 % too long", _k([[1.25, 1, 1], [1, 1.25, 1], [1, 1, 1]])
    yield "focal length in millimetres", _k([[0.03, 1, 1], [1, 0.03, 1], [1, 1, 1]])
    yield "principal point at the edge", _k([[1, 1, 1.8], [1, 1, 1], [1, 1, 1]])
    yield "axes of the other convention", _poses(lambda poses: poses @ FLIP)
    yield "world-to-camera", _poses(np.linalg.inv)
    yield "left-handed world", _poses(lambda poses: MIRROR @ poses @ MIRROR)
    yield "cameras shuffled", _poses(lambda poses, order=rng.permutation(count): poses[order])
    yield "two cameras swapped", _poses(lambda poses: poses[_swapped(count, two, other)])
    yield "one camera turned by 8 degrees", _poses(lambda poses: _put(poses, one, poses[one] @ turn))
    yield "box in other units", lambda scene: (*scene[:2], (np.zeros(3), 100 * (scene[2] or _sphere(scene[0]))[1]))
    yield "test pictures half as bright", _test_images(0.5)
    yield "test pictures of warmer balance", _test_images(np.array([1.2, 1.0, 0.8]))
    if fit.has_masks:
        yield "one mask mirrored", _masks(lambda masks: _put(masks, one, masks[one][:, ::-1]))
        yield "one mask inverted", _masks(lambda masks: _put(masks, one, 1 - masks[one]))
        yield "half of one mask missing", _masks(lambda masks: _put(masks, one, _halved(masks[one])))
        yield "two masks swapped", _masks(lambda masks: masks[_swapped(count, two, other)])
        yield "all masks inverted", _masks(lambda masks: 1 - masks)
        yield "all pictures mirrored", _masks(lambda masks: masks[:, :, ::-1])


def _k(factor: list[list[float]]) -> Callable[[Scene], Scene]:
    by = np.array(factor)

    def change(scene: Scene) -> Scene:
        fit = scene[0]
        silhouettes = fit.silhouette_intrinsics * by
        return replace(fit, intrinsics=fit.intrinsics * by, silhouette_intrinsics=silhouettes), *scene[1:]

    return change


def _poses(turned: Callable[[np.ndarray], np.ndarray]) -> Callable[[Scene], Scene]:
    return lambda scene: (replace(scene[0], camera_to_world=turned(scene[0].camera_to_world)), *scene[1:])


def _masks(drawn: Callable[[np.ndarray], np.ndarray]) -> Callable[[Scene], Scene]:
    return lambda scene: (replace(scene[0], silhouettes=drawn(scene[0].silhouettes)), *scene[1:])


def _test_images(gain: float | np.ndarray) -> Callable[[Scene], Scene]:
    return lambda scene: (scene[0], replace(scene[1], images=(scene[1].images * gain).astype(np.float32)), scene[2])


def _put(values: np.ndarray, row: int, value: np.ndarray) -> np.ndarray:
    out = values.copy()
    out[row] = value
    return out


def _halved(mask: np.ndarray) -> np.ndarray:
    rows = np.flatnonzero((mask >= 0.5).any(axis=1))
    return np.where(np.arange(len(mask))[:, None] < rows.mean(), mask, 0)


def _swapped(count: int, one: int, other: int) -> np.ndarray:
    order = np.arange(count)
    order[[one, other]] = order[[other, one]]
    return order


if __name__ == "__main__":
    main()
