"""What every loader returns, and the steps from two lists of shots to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.cameras import scene_from_dataset
from exmesh_graph.io.checks.finding import settle
from exmesh_graph.io.checks.keyed import LEAST_COVERED, covered_by_hull
from exmesh_graph.io.checks.scene import check_cameras, check_world, principal_shift
from exmesh_graph.io.key import contradicted_note, ground_note, with_ground
from exmesh_graph.io.load import Loaded, check_no_leak, load_shots, shifted, to_views
from exmesh_graph.io.normalise import (
    looking_away,
    make_frame,
    some,
    sphere_from_box,
    sphere_from_cameras,
    sphere_from_masks,
)
from exmesh_graph.io.one_size import of_one_size
from exmesh_graph.io.settings import Checks, TrainSize, UpAxis
from exmesh_graph.io.shots import Shot
from exmesh_graph.io.train_size import factor_for, reduced
from exmesh_graph.types import Frame, SceneTruth, Views


@dataclass(frozen=True)
class Scene:
    """A loaded data set in the normalised Y-up world. `notes` are for the user: what was left out, and why."""

    train: Views
    test: Views
    frame: Frame
    truth: SceneTruth | None = None
    notes: list[str] = field(default_factory=list)


def load_scene(
    train: Sequence[Shot],
    test: Sequence[Shot],
    *,
    up: UpAxis,
    downscale: int = 1,
    wrong_masks: int = 0,
    box: Sequence[Sequence[float]] | None = None,
    sphere: tuple[np.ndarray, float] | None = None,
    metres_per_unit: float = 0.0,
    checks: Checks = "error",
    half_pixel: bool = False,
    key: bool = False,
    size: TrainSize | None = None,
) -> Scene:
    """Read both splits, check them, and normalise: by `box` or `sphere` (data set's units) where given, else by the
    training masks (`wrong_masks` of which may be wrong at a point), else by the cameras alone.

    Cameras and pictures are checked against each other (`io.checks`): what is found becomes notes, and a DataError
    where it is grave and `checks` is "error"; "off" leaves the checks out. With `half_pixel` matches
    between the pictures decide whether half a pixel is added to all principal points. With `key` pictures without alpha
    that stand on one flat colour get masks of what differs from it (`io.key`), which is noted. `size` bounds the
    training pictures that are handed on; checks and normalisation see them as they are.
    """
    # as they were held: none lies on its side
    given = np.array([shot.camera_to_world for shot in train], np.float64).reshape(-1, 4, 4)
    train, sized = of_one_size(train)
    test, held_sized = of_one_size(test)
    fit, held, notes = _read(train, test, downscale, key)
    notes = [note for note in (sized, held_sized) if note] + notes
    check_no_leak(fit, held)
    places = fit.camera_to_world[:, :3, 3]
    if (
        box is None
        and sphere is None
        and len(train) > 1
        and np.ptp(places, axis=0).max() <= 1e-9 * np.abs(places).max()
    ):
        raise DataError(
            f"all {len(train)} training cameras stand in one place, so the object cannot be located",
            expected="cameras around the object",
            fix="correct the poses, or give the object's box in the loader's `box`",
        )
    if half_pixel:
        offset, note = principal_shift(fit)
        fit, held = shifted(fit, offset), shifted(held, offset)
        notes += [note] if note else []
    few = min(wrong_masks, max(len(train) - 2, 0))
    found = settle(check_cameras(fit, few), checks) if checks != "off" else []
    if box is not None:
        centre, radius = sphere_from_box(box[0], box[1])
    elif sphere is not None:
        centre, radius = sphere
    elif fit.has_masks:
        centre, radius = sphere_from_masks(
            fit.silhouettes, fit.silhouette_intrinsics, fit.camera_to_world, wrong_masks=few, names=fit.names
        )
    else:
        height, width = fit.alpha.shape[1:]
        centre, radius = sphere_from_cameras(fit.intrinsics, fit.camera_to_world, width, height)
    if checks != "off":
        placed = box is not None or sphere is not None
        found += settle(check_world(fit, held, centre, radius, placed), checks)
    frame = make_frame(centre, radius, scene_from_dataset(up, given), metres_per_unit)
    views = to_views(fit, frame, "train", has_masks=fit.has_masks)
    factor = 1 if size is None else factor_for(views, size.train_side, size.train_megapixels)
    return Scene(
        train=reduced(views, factor),
        test=to_views(held, frame, "test", has_masks=held.has_masks),
        frame=frame,
        notes=[*_notes(views), *notes, *found],
    )


def _read(train: Sequence[Shot], test: Sequence[Shot], downscale: int, key: bool) -> tuple[Loaded, Loaded, list[str]]:
    """(training views, test views, what is to be said), without their flat ground where there is one that agrees."""
    notes = []
    bare, held_bare, ground = with_ground(train, test) if key else (train, test, None)
    if ground is not None:
        try:
            fit, held = _both(bare, held_bare, downscale)
            covered = covered_by_hull(fit)
        except DataError:  # of a picture with nothing but its ground, as of any other fault: that is met again below
            covered = 0.0
        if covered >= LEAST_COVERED:
            return fit, held, [ground_note(ground)]
        notes = [contradicted_note(ground, covered)]
    return *_both(train, test, downscale), notes


def _both(train: Sequence[Shot], test: Sequence[Shot], downscale: int) -> tuple[Loaded, Loaded]:
    fit = load_shots(train, split="training", downscale=downscale)
    return fit, load_shots(test, split="test", downscale=downscale)


def _notes(train: Views) -> list[str]:
    """What is odd about the training views, views named."""
    notes = []
    bare = [name for name, masked in zip(train.names, train.masked, strict=True) if not masked]
    if train.has_masks and bare:
        notes.append(f"{len(bare)} of {len(train)} training views have no mask: {some(bare)}")
    blind = [train.names[i] for i in looking_away(train.intrinsics, train.camera_to_world, train.width, train.height)]
    if blind:
        notes.append(
            f"{len(blind)} cameras look past the object and show nothing of it: {some(blind)}; correct their "
            "poses, or leave these views out"
        )
    return notes
