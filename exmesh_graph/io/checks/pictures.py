"""Pictures against cameras, where no masks speak: do matches lie on the epipolar lines that the cameras draw?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from exmesh_graph.io.checks.epipolar import agreeing, off_lines, possible
from exmesh_graph.io.checks.features import Pair, alike, match_pairs, nearest_pairs
from exmesh_graph.io.checks.finding import Finding
from exmesh_graph.io.checks.readings import Cameras, Reading, readings
from exmesh_graph.io.shots import spread

_PAIRS = 30  # of each kind
_SURE = 15  # matches of a pair that one geometry explains
_HOLDS, _FAILS = 0.6, 0.4
_FOCAL = (1 / 3, 0.5, 0.67, 0.8, 1.25, 1.5, 2.0, 3.0)
_SHARPER = 0.6


def check_pictures(pictures: np.ndarray, cameras: Cameras) -> tuple[list[Finding], bool]:
    """(findings, whether matches support the cameras) of pictures float32 [N, H, W, 3] in display values.

    Matched are pictures that look alike and pictures that should by their cameras. A pair counts where some pair of
    cameras would explain its matches; its word is the share of these that the given cameras explain. Looks can
    deceive (a house with four equal sides), so that all cameras are doubted only where nearly no pair agrees.
    """
    listed = sorted({*_some(alike(pictures)), *_some(nearest_pairs(_nearness(cameras)))})
    pairs, could = _telling(match_pairs(pictures, listed))
    if len(pairs) < 4:
        return [], False
    ratio = agreeing(pairs, cameras) / could
    if (ratio >= _HOLDS).mean() < 0.25 and np.median(ratio) < _FAILS:
        return [_all(pairs, could, ratio, cameras)], False
    if np.median(ratio) < _HOLDS:
        return [], False
    return [*_focal(pairs, cameras), *_views(pairs, ratio, cameras)], True


def _some(pairs: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    return [pairs[i] for i in spread(len(pairs), _PAIRS)]


def _nearness(cameras: Cameras) -> np.ndarray:
    """[N, N], higher for cameras that stand closer and look the same way."""
    places, axes = cameras.camera_to_world[:, :3, 3], cameras.camera_to_world[:, :3, 2]
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    return np.asarray(axes @ axes.T - apart / max(float(np.median(apart)), 1e-12))


def _telling(pairs: Sequence[Pair]) -> tuple[list[Pair], np.ndarray]:
    could = [possible(pair) for pair in pairs]
    kept = [i for i, share in enumerate(could) if share * len(pairs[i].places) >= _SURE and share >= 0.4]
    return [pairs[i] for i in kept], np.array([could[i] for i in kept])


def _all(pairs: Sequence[Pair], could: np.ndarray, ratio: np.ndarray, cameras: Cameras) -> Finding:
    what = (
        f"matches between pictures contradict the cameras: {(ratio >= _HOLDS).sum()} of {len(pairs)} pairs of pictures "
        "have them on their epipolar lines"
    )
    best: tuple[Reading, float] | None = None
    for reading in readings(cameras):
        score = float(np.median(agreeing(pairs, reading.change(cameras), reading.over) / could))
        if best is None or score > best[1] + 0.02:
            best = reading, score
    if best is not None and best[1] >= 0.8:
        return Finding("matches", f"{what}; read otherwise, {best[1]:.0%} of the matches lie there", best[0].cause,
                       best[0].cure, explained=True)  # fmt: skip
    return Finding(
        "matches", what, "cameras of other pictures, or pictures in another order than the cameras",
        "put pictures and cameras in one order; check the cameras' convention (axes, intrinsics for this picture size)",
    )  # fmt: skip


def _focal(pairs: Sequence[Pair], cameras: Cameras) -> list[Finding]:
    def median(scale: float) -> float:
        scaled = replace(cameras, intrinsics=cameras.intrinsics * [[scale, 1, 1], [1, scale, 1], [1, 1, 1]])
        return float(np.median(np.concatenate([off_lines(pair, scaled) for pair in pairs])))

    given = median(1.0)
    best = min(_FOCAL, key=median)
    if median(best) > _SHARPER * given:
        return []
    return [Finding(
        "focal length", f"matches lie {given:.2f} pixels off their epipolar lines, and {median(best):.2f} with focal "
        f"lengths times {best:.2f}", f"the focal length is about {1 / best:.2g} times what it should be, that of "
        "another picture size perhaps", "correct the focal length, or find the cameras again",
    )]  # fmt: skip


def _views(pairs: Sequence[Pair], ratio: np.ndarray, cameras: Cameras) -> list[Finding]:
    """Views of which no pair agrees, where two or more speak."""
    words: dict[int, list[float]] = {}
    for pair, value in zip(pairs, ratio, strict=True):
        for view in (pair.first, pair.second):
            words.setdefault(view, []).append(float(value))
    bad = [view for view, said in sorted(words.items()) if len(said) >= 2 and max(said) < _FAILS]
    if not bad:
        return []
    return [Finding(
        "matches", f"all matches of {len(bad)} of {len(words)} views contradict their cameras",
        "pictures of these views are swapped, or their cameras are wrong",
        "put pictures and cameras in one order, or leave these views out",
        tuple(cameras.names[view] for view in bad), grave=False,
    )]  # fmt: skip
