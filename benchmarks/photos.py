"""Cameras that `data.photos` finds, against those that a data set states: rotation and place.

    python -m benchmarks.photos --middlebury ../shared/data/temple_ring --idr ../shared/data/dtu_scan24

Only the pictures are handed over. The found cameras are brought to the stated ones by the similarity with the least
sum of squared distances of the camera centres (Umeyama 1991); what is left is printed: the angle between the rotations
in degrees, and the distance of the centres in per cent of the mean distance of the cameras from their middle.
"""

from __future__ import annotations

import argparse
import itertools
import json
import shutil
import tempfile
import time
from pathlib import Path
from typing import get_args

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.idr import list_idr
from exmesh_graph.io.mapping import Way
from exmesh_graph.io.middlebury import list_middlebury
from exmesh_graph.io.motion import Motion, find_motion
from exmesh_graph.io.settings import IdrOptions, Matching, MiddleburyOptions, MotionSettings
from exmesh_graph.io.shots import Shot


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--middlebury", type=Path, action="append", default=[], help="a folder in Middlebury's layout")
    parser.add_argument("--idr", type=Path, action="append", default=[], help="a folder in IDR's layout")
    parser.add_argument("--lens", nargs="+", default=["radial"], choices=["pinhole", "radial", "opencv"])
    parser.add_argument("--mapping", nargs="+", default=["auto"], choices=get_args(Way))
    parser.add_argument("--matching", nargs="+", default=["auto"], choices=get_args(Matching))
    parser.add_argument("--focal", action="store_true", help="also with the stated focal length given")
    parser.add_argument("--twice", action="store_true", help="run each a second time: are the bytes the same?")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument(
        "--few",
        action="store_true",
        help="first 8, 12, 20; every 2nd, 3rd, 4th picture",
    )
    parser.add_argument("--quick", action="store_true", help="the first quarter of the pictures")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    listed = {folder.name: list_middlebury(folder, MiddleburyOptions()) for folder in args.middlebury}
    listed |= {folder.name: list_idr(folder, IdrOptions())[:2] for folder in args.idr}
    rows = []
    print(
        "scene          part     lens     focal   found  degrees median/max  place % median/max  focal %  px  seconds"
    )
    for name, (train, test) in listed.items():
        shots = sorted([*train, *test], key=lambda shot: shot.image.name)
        shots = shots[: len(shots) // 4] if args.quick else shots
        parts = {f"first {n}": shots[:n] for n in (8, 12, 20)} | {f"every {n}": shots[::n] for n in (2, 3, 4)}
        cases = itertools.product(
            parts.items() if args.few else [("all", shots)], args.lens, args.mapping, args.matching
        )
        for (part, taken), lens, way, matching in cases:
            for given in (False, True) if args.focal else (False,):
                try:
                    found = measure(taken, lens, given, way, matching, args.threads, args.twice)
                except DataError as error:
                    rows.append({"scene": name, "part": part, "how": way, "error": error.what})
                    print(f"{name:14} {part:9}{lens:8} {error.what.split(';')[0]}  {way}", flush=True)
                    continue
                row = {"scene": name, "part": part, **found}
                rows.append(row)
                print(
                    f"{name:14} {part:9}{lens:8} {'given' if given else 'found':6} {row['found']:3}/{row['of']:<3}"
                    f" {row['degrees_median']:9.3f}/{row['degrees_max']:<9.3f}{row['place_median']:8.2f}/"
                    f"{row['place_max']:<8.2f}{row['focal_off']:8.2f}{row['error']:6.2f}{row['seconds']:8.0f}"
                    f"  {row['how']}, {row['taken']}"
                    + (f"  same bytes: {row['same']}" if args.twice else ""), flush=True,
                )  # fmt: skip
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1) + "\n")


def measure(shots: list[Shot], lens: str, given: bool, way: Way, matching: Matching, threads: int, twice: bool) -> dict:
    """One row of the table."""
    focal = float(np.mean([shot.intrinsics[0, 0] for shot in shots])) if given else 0.0
    settings = MotionSettings(lens=lens, focal=focal, threads=threads, registered=0.01, mapping=way, matching=matching)
    begin = time.process_time()
    motion = run(shots, settings)
    seconds = time.process_time() - begin
    known = [shot for shot in shots if shot.image.name in motion.camera_to_world]
    true = np.stack([shot.camera_to_world for shot in known])
    found = np.stack([motion.camera_to_world[shot.image.name] for shot in known])
    degrees, place = differences(found, true)
    stated = np.mean([shot.intrinsics[0, 0] for shot in known])
    return {
        **settings.model_dump(), "found": len(known), "of": len(shots), "seconds": seconds, "error": motion.error,
        "degrees_median": float(np.median(degrees)), "degrees_max": float(degrees.max()),
        "place_median": float(np.median(place)), "place_max": float(place.max()),
        "focal_off": 100 * float(motion.lenses[0].calibration_matrix()[0, 0] / stated - 1),
        "points": len(motion.points), "how": motion.how, "taken": motion.matching,
        "same": same(motion, run(shots, settings)) if twice else None,
    }  # fmt: skip


def run(shots: list[Shot], settings: MotionSettings) -> Motion:
    folder = Path(tempfile.mkdtemp())
    try:
        return find_motion([shot.image for shot in shots], {}, settings, folder)
    finally:
        shutil.rmtree(folder)


def same(a: Motion, b: Motion) -> bool:
    poses = all(np.array_equal(a.camera_to_world[n], b.camera_to_world.get(n)) for n in a.camera_to_world)
    return poses and np.array_equal(a.points, b.points)


def differences(found: np.ndarray, true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(degrees [N], per cent of the cameras' mean distance from their middle [N]) after the best similarity."""
    a, b = found[:, :3, 3], true[:, :3, 3]
    scale, turn, offset = similarity(a, b)
    moved = scale * a @ turn.T + offset
    radius = np.linalg.norm(b - b.mean(0), axis=1).mean()
    relative = np.einsum("nji,jk,nkl->nil", true[:, :3, :3], turn, found[:, :3, :3])
    angle = np.arccos(np.clip((np.trace(relative, axis1=1, axis2=2) - 1) / 2, -1, 1))
    return np.degrees(angle), 100 * np.linalg.norm(moved - b, axis=1) / radius


def similarity(points: np.ndarray, targets: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """s, R [3, 3], t [3] that bring points [N, 3] nearest to targets by s R x + t."""
    middle, aim = points.mean(0), targets.mean(0)
    left, values, right = np.linalg.svd((targets - aim).T @ (points - middle))
    signs = np.array([1, 1, np.linalg.det(left) * np.linalg.det(right)])
    rotation = left * signs @ right
    scale = float((values * signs).sum() / ((points - middle) ** 2).sum())
    return scale, rotation, aim - scale * rotation @ middle


if __name__ == "__main__":
    main()
