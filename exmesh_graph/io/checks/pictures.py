"""Pictures against cameras, where no masks speak: do matches lie on the epipolar lines that the cameras draw?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

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
_ASKED = 4  # views that seem to be wrong and are matched with all others


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
    return [*_focal(pairs, cameras), *_views(pictures, pairs, ratio, cameras)], True


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


def _views(pictures: np.ndarray, pairs: Sequence[Pair], ratio: np.ndarray, cameras: Cameras) -> list[Finding]:
    """Views of which no pair agrees, where two or more speak; apart, those whose cameras belong to each other."""
    words: dict[int, list[float]] = {}
    for pair, value in zip(pairs, ratio, strict=True):
        for view in (pair.first, pair.second):
            words.setdefault(view, []).append(float(value))
    blamed = [view for view, said in sorted(words.items()) if len(said) >= 2 and max(said) < _FAILS]
    witnesses = {view: _Witness.of(view, pictures) for view in blamed[:_ASKED]}
    bad = [view for view in blamed if view not in witnesses or not witnesses[view].agrees(cameras, view)]
    swapped: list[int] = []
    for view in bad[:_ASKED]:
        other = None if view in swapped else _partner(witnesses[view], pictures, cameras)
        swapped += [] if other is None or other in swapped else [view, other]
    others = [view for view in bad if view not in swapped]
    findings = []
    if swapped:
        couples = [" with ".join(cameras.names[view] for view in swapped[n : n + 2]) for n in range(0, len(swapped), 2)]
        findings.append(Finding(
            "matches", "matches contradict the cameras of these views, and agree once they change places: "
            + ", ".join(couples),
            "files are swapped: they fit each other's views", "put pictures and cameras in one order",
            tuple(cameras.names[view] for view in sorted(swapped)), grave=False,
        ))  # fmt: skip
    if others:
        findings.append(Finding(
            "matches", f"all matches of {len(others)} of {len(words)} views contradict their cameras",
            "pictures of these views are swapped, or their cameras are wrong",
            "put pictures and cameras in one order, or leave these views out",
            tuple(cameras.names[view] for view in others), grave=False,
        ))  # fmt: skip
    return findings


@dataclass(frozen=True)
class _Witness:
    """All telling pairs of one view with the others, and what share of their matches some geometry explains."""

    view: int
    pairs: list[Pair]
    could: np.ndarray

    @classmethod
    def of(cls, view: int, pictures: np.ndarray) -> _Witness:
        pairs = match_pairs(pictures, [(view, other) for other in range(len(pictures)) if other != view])
        return cls(view, *_telling(pairs))

    def agrees(self, cameras: Cameras, camera: int) -> bool:
        """Whether most of the pairs, two at least, lie on their lines when the view has another one's `camera`."""
        order = np.arange(len(cameras.names))
        order[[self.view, camera]] = camera, self.view
        changed = replace(cameras, intrinsics=cameras.intrinsics[order], camera_to_world=cameras.camera_to_world[order])
        said = agreeing(self.pairs, changed) / self.could
        return bool((said >= _HOLDS).sum() >= max(2, len(said) / 2))


def _partner(witness: _Witness, pictures: np.ndarray, cameras: Cameras) -> int | None:
    """The view with which the witness's own has changed places: each agrees with the camera of the other."""
    fitting = [view for view in range(len(pictures)) if view != witness.view and witness.agrees(cameras, view)]
    return next((view for view in fitting if _Witness.of(view, pictures).agrees(cameras, witness.view)), None)
