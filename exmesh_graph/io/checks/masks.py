"""Masks against cameras: which views no common shape explains, or how the camera file was meant instead."""

from __future__ import annotations

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.checks.finding import Finding
from exmesh_graph.io.checks.outlines import Outlines, common_shape, covered, depths_of, overlap, rays_of_masks
from exmesh_graph.io.checks.readings import Reading, focal_lengths, readings
from exmesh_graph.io.normalise import centre_of_masks
from exmesh_graph.io.shots import spread

CLEAN, POOR = 0.93, 0.75
_FEWEST = 4
_READ = 20
_FITS = 0.9
_RIM = 0.5


def check_masks(outlines: Outlines, wrong_masks: int = 0) -> tuple[list[Finding], bool]:
    """(findings, whether the masks support the cameras as they are).

    Every view's share of mask rays that the common shape explains is near 1 where cameras and masks are right. Where it
    is not, the focal length may be to blame, few views (they are found by leaving out one after the other), or the
    reading of the camera file (the likely other ones are tried). Nothing is said of fewer than four views.
    """
    outlines = _in_front(outlines)
    if len(outlines) < _FEWEST:
        return [], False
    shares = _shares(outlines)
    if shares.min() >= CLEAN:
        return [], True
    focal = _focal(outlines, shares)
    if focal is not None:
        return [focal], False
    bad = _to_blame(outlines) if _rim(outlines) < _RIM else []
    if bad:
        return _single(outlines, bad, shares, wrong_masks), len(bad) <= wrong_masks
    return [_all(outlines, shares)], False


def _in_front(outlines: Outlines) -> Outlines:
    """Without the few cameras that look the other way: they say nothing, and are named elsewhere."""
    if len(outlines) < _FEWEST:
        return outlines
    centre, _ = _middle(outlines)
    poses = outlines.cameras.camera_to_world
    behind = np.einsum("ni,ni->n", centre - poses[:, :3, 3], poses[:, :3, 2]) < 0
    return outlines.subset(np.flatnonzero(~behind)) if behind.sum() <= max(1, len(behind) // 6) else outlines


def _middle(outlines: Outlines) -> tuple[np.ndarray, float]:
    """`centre_of_masks` of the three quarters of the views whose rays pass the centre most closely; radius 0: none."""
    k, poses = outlines.cameras.intrinsics, outlines.cameras.camera_to_world
    try:
        centre, radius = centre_of_masks(outlines.masks, k, poses)
        for _ in range(2):
            near = np.argsort(_off_middle(outlines, centre), kind="stable")[: max(3, 3 * len(outlines) // 4)]
            centre, radius = centre_of_masks(outlines.masks[near], k[near], poses[near])
    except DataError:
        return np.zeros(3), 0.0
    return centre, radius


def _off_middle(outlines: Outlines, centre: np.ndarray) -> np.ndarray:
    """float64 [N]: how far the centre is drawn from the middle of each mask, in pixels; infinite behind a camera."""
    off = np.full(len(outlines), np.inf)
    for view, mask in enumerate(outlines.masks):
        x, y, depth = outlines.cameras.project(view, centre[None])
        if depth[0] > 0:
            rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
            off[view] = np.hypot(x[0] - columns[[0, -1]].mean(), y[0] - rows[[0, -1]].mean())
    return off


def _shares(outlines: Outlines) -> np.ndarray:
    return covered(outlines, *_middle(outlines))


def _focal(outlines: Outlines, shares: np.ndarray) -> Finding | None:
    """The focal length under which all masks have a common shape: a wrong mask or camera has it under none."""
    everything = range(len(outlines))
    tried = [(reading, _shares(outlines.read(reading, everything))) for reading in focal_lengths()]
    reading, best = max(tried, key=lambda one: float(one[1].mean()))
    if best.min() < CLEAN or 1 - best.mean() > (1 - shares.mean()) / 2:
        return None
    return Finding(
        "masks", f"the masks have no common shape: it explains {shares.mean():.1%} of them, least {shares.min():.1%}; "
        f"read otherwise, {best.mean():.1%} and {best.min():.1%}", reading.cause, reading.cure, explained=True,
    )  # fmt: skip


def _to_blame(outlines: Outlines) -> list[int]:
    """The fewest views, a sixth at most, without which the others have a common shape; none: there are no such."""
    centre, radius = _middle(outlines)
    if radius <= 0:
        return []
    count = len(outlines)
    depths = depths_of(outlines)
    rays = max(12, min(80, int(1e7 / (count * count * depths))))
    against = ~rays_of_masks(outlines, centre, radius, rays, depths).held(outlines)
    kept = np.ones(count, bool)
    for _ in range(max(2, count // 6) + 1):
        number = against[kept].sum(axis=0, dtype=np.uint16)
        at = number.argmin(axis=2)
        fewest = np.take_along_axis(number, at[..., None], axis=2)[..., 0]
        if (fewest == 0).mean(axis=1)[kept].min() >= CLEAN:
            return [int(view) for view in np.flatnonzero(~kept)]
        # a ray with one view against it speaks against that view; one with several, against the view it is of
        sole = np.take_along_axis(against, at[None, ..., None], axis=3)[..., 0] & (fewest == 1) & kept[None, :, None]
        blame = np.where(kept, sole.mean(axis=2).sum(axis=1) + (fewest >= 2).mean(axis=1), -1)
        kept[blame.argmax()] = False
    return []


def _single(outlines: Outlines, bad: list[int], shares: np.ndarray, wrong_masks: int) -> list[Finding]:
    good = [view for view in range(len(outlines)) if view not in bad]
    rest = outlines.subset(good)
    names = outlines.cameras.names
    groups: dict[tuple[str, str], list[int]] = {}
    overlaps = {}
    for view in bad:
        mask = outlines.masks[view]
        overlaps[view], *others = overlap(
            rest, outlines.cameras.subset([view]),
            [mask, mask[:, ::-1], mask[::-1], mask[::-1, ::-1], ~mask, *(outlines.masks[o] for o in bad if o != view)],
        )  # fmt: skip
        best = int(np.argmax(others))
        if others[best] < _FITS or others[best] < overlaps[view] + 0.1:
            said = "the mask or the camera of the view is wrong", "mend the mask or leave the view out"
        elif best < 4:
            how = ("mirrored left to right", "mirrored top to bottom", "turned by 180 degrees", "inverted")[best]
            said = f"the mask is {how}", "write the mask again as its picture is, white on the object"
        else:
            said = "files are swapped: they fit each other's views", "put pictures, masks and cameras in one order"
        groups.setdefault(said, []).append(view)
    lost = float(np.mean(1 - shares[good]))
    harm = lost > 0.05 or shares[good].min() < POOR or min(overlaps.values()) < 0.5
    return [
        Finding(
            "masks",
            f"{len(views)} of {len(names)} masks contradict the others: the hull of the others drawn back overlaps "
            f"them by (IoU) {', '.join(f'{overlaps[view]:.2f}' for view in views[:8])}",
            cause, cure if len(bad) <= wrong_masks else f"{cure}, or let `wrong_masks: {len(bad)}` outvote them",
            tuple(names[view] for view in views), grave=harm and len(bad) > wrong_masks,
        )
        for (cause, cure), views in groups.items()
    ]  # fmt: skip


def _all(outlines: Outlines, shares: np.ndarray) -> Finding:
    names = outlines.cameras.names
    poor = tuple(name for name, share in zip(names, shares, strict=True) if share < CLEAN)
    found = fitting(outlines)
    some_part = "have no common part" if shares.max() == 0 else (
        f"have no common shape: it explains {shares.mean():.0%} of them, least {shares.min():.0%}"
    )  # fmt: skip
    what = f"the masks of the views {some_part}"
    views = poor if len(poor) < len(names) else ()
    if found is not None:
        reading, share = found
        return Finding(
            "masks", f"{what}; read otherwise, {share:.0%}", reading.cause, reading.cure, views, explained=True
        )
    return Finding(
        "masks", what, "cameras or masks of other pictures, pictures in another order than the cameras, or masks that "
        "are wrong in many views",
        "check the cameras' convention (axes, intrinsics for this picture size), the order of the files and the masks",
        views, grave=bool(np.mean(shares) < POOR or shares.min() < 0.5),
    )  # fmt: skip


def fitting(outlines: Outlines) -> tuple[Reading, float] | None:
    """The reading of the cameras under which the masks have a common shape, and how much of them it explains."""
    rows = spread(len(outlines), _READ)
    best: tuple[Reading, float] | None = None
    inside_out = _rim(outlines) >= _RIM
    listed = [reading for reading in readings(outlines.cameras) if inside_out or not reading.inverted]
    for reading in sorted(listed, key=lambda reading: not reading.inverted):
        share = common_shape(outlines.read(reading, rows))
        if best is None or share > best[1] + 0.005:
            best = reading, share
    as_it_is = common_shape(outlines.subset(rows))
    return best if best is not None and best[1] >= max(CLEAN, as_it_is + 0.05) else None


def _rim(outlines: Outlines) -> float:
    """Share of the pictures' edges that lie in the masks."""
    return float(np.mean([np.r_[mask[0], mask[-1], mask[:, 0], mask[:, -1]].mean() for mask in outlines.masks]))
