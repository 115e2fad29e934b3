"""Cameras from verified matches: three ways of COLMAP, and which of their results the matches themselves support.

Incremental mapping (Schoenberger and Frahm 2016) needs a good first pair and finds none among few or small pictures;
with easier thresholds it does, and goes wrong more often; global mapping (Pan et al. 2024, GLOMAP) solves for all
cameras at once, places more of them, and now and then all of them wrongly. No rule on counts tells these apart. What
does: under right cameras the matches that were verified pair by pair lie on their epipolar lines.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np

from exmesh_graph.io.settings import Way

SEEN_BY = 3  # pictures that must see a point
_TIES = 10
_NEAR = 2.0  # pixels
_WAYS = ("incremental", "easier", "global")
_SETTLED = 0.95
"""Of all verified matches: a mapping of all pictures with which so many agree leaves the other ways nothing to gain."""
_EASIER = {"init_min_num_inliers": 50, "init_min_tri_angle": 4.0, "abs_pose_min_num_inliers": 15,
           "abs_pose_min_inlier_ratio": 0.15}  # fmt: skip


@dataclass(frozen=True)
class Mapped:
    """A model of COLMAP's, the pictures in it that count, how it was found, and how many of their verified matches
    agree with it, of how many."""

    model: Any
    names: frozenset[str]
    how: str
    agreeing: int
    matches: int


def map_cameras(
    colmap: Any, database: Path, pictures: Path, work: Path, seed: int, way: Way = "auto",
    tell: Callable[[str], None] = lambda _: None,
) -> Mapped | None:  # fmt: skip
    """The result with the most agreeing matches, the earlier of equal ones, or of one way; None: nothing was found.

    No other way is tried after one that places all pictures so that 95 % of the verified matches agree.
    All of it runs on one thread with `seed`, so that equal matches give equal bytes.
    """
    best: Mapped | None = None
    count, verified = _held(colmap, database)
    for how in _WAYS if way == "auto" else (way,):
        tell(f"cameras by {how} mapping")
        for model in _models(colmap, database, pictures, _new(work, how), seed, how).values():
            names = tied(model)
            mapped = Mapped(model, names, how, *agreeing(colmap, database, model, names))
            if len(names) >= SEEN_BY and (best is None or mapped.agreeing > best.agreeing):
                best = mapped
        if best is not None and len(best.names) == count and best.agreeing >= _SETTLED * verified:
            break
    return best


def tied(model: Any) -> frozenset[str]:
    """The largest group of pictures that hold together by ten points or more which three pictures see.

    Where pictures hang on the others by pairs alone, these say in which direction they stand, and not how far away.
    """
    name = {number: image.name for number, image in model.images.items() if image.has_pose}
    shared: Counter[tuple[str, str]] = Counter()
    for point in model.points3D.values():
        seen = sorted({name[e.image_id] for e in point.track.elements if e.image_id in name})
        if len(seen) >= SEEN_BY:
            shared.update(combinations(seen, 2))
    ties = nx.Graph()
    ties.add_nodes_from(sorted(name.values()))
    ties.add_edges_from(pair for pair, count in sorted(shared.items()) if count >= _TIES)
    groups = sorted(map(sorted, nx.connected_components(ties)), key=lambda group: (-len(group), group))
    return frozenset(groups[0] if groups else ())


def agreeing(colmap: Any, database: Path, model: Any, names: Collection[str]) -> tuple[int, int]:
    """(verified matches between the pictures `names` within two pixels of both epipolar lines of the model's cameras,
    of how many)."""
    placed = {number: image for number, image in model.images.items() if image.has_pose and image.name in names}
    count = matched = 0
    opened = colmap.Database.open(database)
    try:
        points = {number: np.asarray(opened.read_keypoints(number), np.float64)[:, :2] for number in placed}
        for pair, geometry in zip(*opened.read_two_view_geometries(), strict=True):
            first, second = colmap.pair_id_to_image_pair(pair)
            matches = np.asarray(geometry.inlier_matches, np.int64).reshape(-1, 2)
            if first in placed and second in placed and len(matches):
                sides = [
                    _Side(placed[n], model.cameras[placed[n].camera_id], points[n][matches[:, k]])
                    for k, n in enumerate((first, second))
                ]
                near = np.maximum(_off_line(*sides), _off_line(*sides[::-1])) < _NEAR
                count, matched = count + int(near.sum()), matched + len(near)
    finally:
        opened.close()
    return count, matched


def _held(colmap: Any, database: Path) -> tuple[int, int]:
    """(pictures, verified matches of all pairs) in the database."""
    opened = colmap.Database.open(database)
    try:
        pairs = opened.read_two_view_geometries()[1]
        return opened.num_images(), sum(len(np.asarray(pair.inlier_matches).reshape(-1, 2)) for pair in pairs)
    finally:
        opened.close()


def _models(colmap: Any, database: Path, pictures: Path, work: Path, seed: int, how: str) -> Any:
    whole = how == "global"
    options = colmap.GlobalPipelineOptions() if whole else colmap.IncrementalPipelineOptions()
    options.min_model_size = SEEN_BY
    _quiet(options, seed)
    for name, value in _EASIER.items() if how == "easier" else ():
        setattr(options.mapper, name, value)
    return (colmap.global_mapping if whole else colmap.incremental_mapping)(database, pictures, work, options=options)


def _quiet(options: Any, seed: int) -> None:
    """One thread, no GPU and this seed in COLMAP's options and all that they hold."""
    for name in dir(options):
        if name.startswith("_"):
            continue
        value = getattr(options, name)
        if name == "random_seed":
            options.random_seed = seed
        elif name == "num_threads":
            options.num_threads = 1
        elif name == "use_gpu":
            options.use_gpu = False
        elif hasattr(value, "todict") and hasattr(value, "mergedict"):
            _quiet(value, seed)


def _new(work: Path, name: str) -> Path:
    folder = work / name
    folder.mkdir()
    return folder


@dataclass(frozen=True)
class _Side:
    """A picture of a pair, its camera, and its pixels [N, 2] of the matches."""

    image: Any
    camera: Any
    pixels: np.ndarray


def _off_line(one: _Side, other: _Side) -> np.ndarray:
    """Angles [N] of the rays of `other` off the epipolar planes through those of `one`, in pixels at the centre."""
    matrix, other_matrix = one.image.cam_from_world().matrix(), other.image.cam_from_world().matrix()
    turn = other_matrix[:, :3] @ matrix[:, :3].T
    baseline = other_matrix[:, 3] - turn @ matrix[:, 3]
    normals = np.cross(baseline, _rays(one) @ turn.T)
    length = np.linalg.norm(normals, axis=1)
    off = np.abs((normals * _rays(other)).sum(axis=1)) / np.maximum(length, 1e-12)
    # a ray along the baseline lies in every plane through it: it says nothing, and agrees
    return np.where(length > 1e-12, off, 0.0) * other.camera.mean_focal_length()


def _rays(side: _Side) -> np.ndarray:
    rays = np.c_[np.asarray(side.camera.cam_from_img(side.pixels)), np.ones(len(side.pixels))]
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
