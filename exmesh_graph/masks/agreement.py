"""Whether masks that were found are those of one object: their common shape, drawn back, says so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from exmesh_graph.errors import DataError, GeometryError
from exmesh_graph.masks.confirmed import confirmed
from exmesh_graph.masks.drawn import drawn_outlines
from exmesh_graph.masks.edges import better_parts, on_edges
from exmesh_graph.masks.grown import maybe_shown
from exmesh_graph.masks.last import Given, healed, opened, undercut
from exmesh_graph.masks.outlines import Small, refined, small_masks
from exmesh_graph.masks.settings import AgreementSettings, CutSettings
from exmesh_graph.masks.shape import common_shape
from exmesh_graph.masks.table import Table
from exmesh_graph.types import Views

_OTHER = 0.7
_SEEN = 0.001
_TURNS = 12  # after the first, at most
_GROWS = 0.02  # of a mask in a turn
_WORSE, _WELL = 0.05, 0.97  # of `edges.on_edges`: leaked, and good enough
_PARTS = None, 0.02, 0.05  # of what lies far beside a mask, which may be the object's; None: that is not asked


@dataclass(frozen=True)
class Agreement:
    """What `agreed_masks` gives.

    masks    bool [N, H, W]; a view that does not show the object has no pixel
    figures  overlap: median of intersection over union of the masks and their common shape, drawn back, or of how
             much of the first masks it covers, whichever is less; seen, contradicted: parts of the views
    fault    the first check that failed, a sentence; empty where all passed
    """

    masks: np.ndarray
    figures: dict[str, float]
    fault: str


def agreed_masks(
    views: Views,
    vertices: np.ndarray,
    faces: np.ndarray,
    cutting: CutSettings,
    settings: AgreementSettings,
    *,
    table: Table | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Agreement:
    """Masks of the mesh (vertices [V, 3], faces [F, 3]) by two turns or more, and whether they have a common shape.

    The first turn cuts the drawn mesh to the pictures' edges. The next cuts, in half the band, the visual hull of
    these masks and of what beside them the colours of most views take for the object's (`grown`); one view of twenty
    is outvoted, so that views mend each other. Further turns follow while masks grow, and those masks are taken whose
    outlines lie best on edges of the pictures (`edges`), as those that have leaked into what lies around do not.
    Where masks no longer grow and some of their outlines lie on no edge, colours are compared with what lies far
    beside them as well. Last, where outlines then lie better, what three views of twenty-five lack is put back and
    gaps that masks fill are opened (`last`), or those parts of it by which they do. A mask of the first turn that the
    hull does not cover is contradicted, and so is one that is another than their own hull. All of that is done in
    reduced views; the masks are `refined` at the end. `table` as for `masks_of_surface`; without one, gaps are not
    looked for.
    """
    small = Small.of(views, cutting, table)
    masks, figures, fault = _judged(small, vertices, faces, cutting, settings, progress)
    return Agreement(refined(views, masks, small.factor, cutting), figures, fault)


def _judged(
    small: Small,
    vertices: np.ndarray,
    faces: np.ndarray,
    cutting: CutSettings,
    settings: AgreementSettings,
    progress: Callable[[int, int], None] | None,
) -> tuple[np.ndarray, dict[str, float], str]:
    """(masks bool [N, h, w] of the reduced views, figures, fault) as `agreed_masks` gives them."""
    first = small_masks(small, vertices, faces, cutting, _turn(progress, 0, len(small.views)))
    seen = first.mean(axis=(1, 2)) >= _SEEN
    figures = {"seen": float(seen.mean()), "overlap": 0.0, "contradicted": 0.0}
    if seen.mean() < settings.least_seen or seen.sum() < 2:
        return first, figures, f"{seen.mean():.0%} of the views show it (least_seen {settings.least_seen:g})"
    try:
        masks, kept, near = _mended(small, vertices, first, seen, cutting, progress)
        shape = common_shape(small.views.subset(np.flatnonzero(seen)), masks[seen], near, small.table)
    except (DataError, GeometryError) as error:
        return first, figures, f"its masks have no common shape ({str(error).splitlines()[0]})"
    overlaps = np.minimum(kept, overlap(drawn_outlines(*shape, small.views)[seen], masks[seen]))
    figures["overlap"], figures["contradicted"] = float(np.median(overlaps)), float((overlaps < _OTHER).mean())
    fault = ""
    if figures["overlap"] < settings.least_overlap:
        fault = f"its masks and their common shape overlap by {figures['overlap']:.0%} (least_overlap"
        fault = f"{fault} {settings.least_overlap:g})"
    elif figures["contradicted"] > settings.most_contradicted:
        fault = f"{figures['contradicted']:.0%} of the masks are another than their common shape (most_contradicted"
        fault = f"{fault} {settings.most_contradicted:g})"
    return masks, figures, fault


def _mended(
    small: Small,
    vertices: np.ndarray,
    first: np.ndarray,
    seen: np.ndarray,
    cutting: CutSettings,
    progress: Callable[[int, int], None] | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(the masks of the turn whose outlines lie best on edges; of each mask of the `first` turn that is `seen`, how
    much the hull of that turn covers; points around the last hull)."""
    finer = cutting.replaced(band=max(1.0, cutting.band / 2))
    masks, kept, near = first, np.ones(int(seen.sum())), vertices
    best, here, chosen, parts, told = -1.0, -1.0, first, list(_PARTS), None
    for turn in range(1, 1 + _TURNS):
        try:
            hull = _grown(small, seen, masks, near, parts[0])
        except (DataError, GeometryError):
            if best < 0:
                raise
            break  # what earlier turns found stands
        near = np.concatenate([vertices, hull[0]])
        covers = covered(drawn_outlines(*hull, small.views)[seen], first[seen])
        last, told = masks, _turn(progress, turn, len(small.views))
        masks = small_masks(small, *hull, finer, told)
        masks[~seen] = False
        clear = on_edges(small.shown, masks)
        if clear > best:
            best, chosen, kept = clear, masks, covers
        here = max(here, clear)
        if clear < here - _WORSE:
            break
        if np.median(1 - covered(last[seen], masks[seen])) < _GROWS:
            if best >= _WELL or len(parts) == 1:
                break
            if parts.pop(0) is None:  # the other way from the start: what one way has found bends the other
                masks, near, here = first, vertices, -1.0
    given, refused = Given(small, seen, near, finer, told), None
    more = confirmed(given, chosen)
    if more is not None and (clear := on_edges(small.shown, more)) > best - _WORSE:
        best, chosen = clear, more  # thin things lie less well on edges
    for step in (healed, healed, undercut, opened):
        changed = None if step is refused else step(given, chosen)
        if changed is None:
            continue
        clear = on_edges(small.shown, changed)
        if clear <= best:  # not the whole of it
            refused, changed = step, better_parts(small.shown, chosen, changed)
            clear = on_edges(small.shown, changed)
        if clear > best:
            best, chosen = clear, changed
    return chosen, kept, near


def _grown(
    small: Small, seen: np.ndarray, masks: np.ndarray, near: np.ndarray, part: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """The hull (vertices, faces), around points `near` [P, 3], of what the views `seen` bool [N] may show, masks bool
    [N, h, w] and beside them, `part` as for `maybe_shown`."""
    chance = small.table_chance(masks, near)
    more = maybe_shown(small.shown[seen], masks[seen], None if chance is None else chance[seen], part)
    return common_shape(small.views.subset(np.flatnonzero(seen)), more, near, small.table)


def covered(shape: np.ndarray, masks: np.ndarray) -> np.ndarray:
    """float64 [N], share of bool masks [N, H, W] within bool shapes [N, H, W]; 1 where a mask is empty."""
    there = masks.sum(axis=(1, 2))
    return np.where(there > 0, (shape & masks).sum(axis=(1, 2)) / np.maximum(there, 1), 1.0)


def overlap(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """float64 [N], intersection over union of bool [N, H, W] and [N, H, W]; 1 where both are empty."""
    both, any_ = (np.asarray(part).sum(axis=(1, 2)) for part in (first & second, first | second))
    return np.where(any_ > 0, both / np.maximum(any_, 1), 1.0)


def _turn(progress: Callable[[int, int], None] | None, turn: int, views: int) -> Callable[[int, int], None] | None:
    """Progress in one of the turns, of which at least two more are expected at first and then one."""
    return None if progress is None else lambda step, _: progress(turn * views + step, (max(turn, 1) + 2) * views)
