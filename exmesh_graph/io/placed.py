"""Photographs whose cameras are known, and the views that are made of them: lenses undone, the world normalised."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.lens import UNCHANGED, AnyLens, Changed, LensChange
from exmesh_graph.io.motion import Motion
from exmesh_graph.io.normalise import cameras_from_normalised, nearest_point, points_to_normalised, some, sphere_of
from exmesh_graph.io.one_size import brought_note
from exmesh_graph.io.settings import PhotosOptions
from exmesh_graph.io.shots import Shot, split
from exmesh_graph.io.undistort import pinhole
from exmesh_graph.io.vertical import upright_world
from exmesh_graph.io.working import Working, common_size, upright
from exmesh_graph.types import Frame, PointCloud

if TYPE_CHECKING:
    from exmesh_graph.io.scene import Scene

_STRAIGHT = 0.05  # pixels
_NEAR, _ROOM, _OUTSIDE = 0.7, 1.05, 0.8


class Adjustment(NamedTuple):
    """Camera-to-world float64 [4, 4] by the view's name in the normalised `world`, and what lenses are other."""

    world: Frame
    camera_to_world: Mapping[str, np.ndarray]
    lens: LensChange


@dataclass(frozen=True)
class Placed:
    """Pictures of `path` with cameras, not read yet, and what is to be said of them. `alpha`: that of some pictures is
    their mask, so that what lies beyond it is gone."""

    path: Path
    options: PhotosOptions
    working: list[Working]
    motion: Motion
    alpha: bool
    notes: list[str]

    def scene(self, *, masks: bool = True, world: Frame | None = None, after: Adjustment | None = None) -> Scene:
        """Views with or without their `masks`, of the cameras and lenses that were found, or of those that they are
        `after` all.

        The world, unless it is given (`world`, or that of `after`), is Y-up by level cameras, by the mean of the
        cameras' up where these do not tell. Its sphere comes from the masks, where there are any, else from the sparse
        points that the cameras look at. Raises DataError for what `object_sphere` and `load_scene` refuse.
        """
        from exmesh_graph.io.scene import load_scene

        motion, options = self.motion, self.options
        shots, sized = self._shots(UNCHANGED if after is None else after.lens)
        shots = shots if masks else [replace(shot, mask=None) for shot in shots]
        turn, turned = self._upright()
        poses = turn @ np.stack([shot.camera_to_world for shot in shots])
        if after is not None:
            world = after.world
            poses = cameras_from_normalised(np.stack([after.camera_to_world[shot.name] for shot in shots]), world)
        parts = split([replace(s, camera_to_world=pose) for s, pose in zip(shots, poses, strict=True)],
                      options.holdout, options.first, self.path)  # fmt: skip
        masked = self.alpha or any(shot.mask is not None for shot in shots)
        sphere = None if world is None else sphere_of(world)
        if sphere is None and not masked and (len(motion.points) or motion.found):
            sphere = object_sphere(motion.points @ turn[:3, :3].T, motion.tracks, poses)
        scene = load_scene(
            *parts, up="y", downscale=options.downscale, wrong_masks=options.wrong_masks, sphere=sphere,
            checks=options.checks if masks else "off", size=options,
        )  # fmt: skip
        scene.notes.extend(
            [*self.notes, *(note for note in (sized, turned) if note), *_told(motion, len(self.working))]
        )
        return scene

    def points(self, frame: Frame) -> PointCloud:
        """The sparse points in the normalised world."""
        points = self.motion.points @ self._upright()[0][:3, :3].T
        return PointCloud(
            points_to_normalised(points, frame).astype(np.float32), self.motion.colours.astype(np.float32)
        )

    def _upright(self) -> tuple[np.ndarray, str]:
        cameras = self.motion.camera_to_world
        held = [upright(cameras[one.name], one.quarter) for one in self.working if one.name in cameras]
        return upright_world(np.stack(held))

    def _shots(self, change: LensChange) -> tuple[list[Shot], str]:
        """(views of one size with cameras, a note on those that lose or gain by it)."""
        size = common_size(self.working)
        lenses = [lens if change == UNCHANGED else Changed(lens, change) for lens in self.motion.lenses]
        pinholes = [_straight(lens, size) for lens in lenses]
        shots, odd, least = [], [], 1.0
        for one in self.working:
            if one.name in self.motion.camera_to_world:
                k, where = pinholes[self.motion.camera[one.name]]
                pose = self.motion.camera_to_world[one.name]
                shots.append(Shot(Path(one.name).stem, one.image, pose, k, one.mask, size, places=where))
                if one.size != size:
                    factor = max(size[0] / one.size[0], size[1] / one.size[1])
                    odd.append(one.name)
                    least = min(least, size[0] * size[1] / (factor**2 * one.size[0] * one.size[1]))
        return shots, brought_note(odd, len(shots), size, least) if odd else ""


def _straight(lens: AnyLens, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray | None]:
    """(K, places in the photograph of all pixels; None where they stay) of the views of `size` through a lens."""
    k = lens.calibration_matrix()
    grid, places = pinhole(lens.img_from_cam, k, lens.width, lens.height, size)
    centres = np.stack(np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5), axis=-1)
    stays = (lens.width, lens.height) == size and np.abs(grid - k).max() < _STRAIGHT
    return (k, None) if stays and np.abs(places - centres).max() < _STRAIGHT else (grid, places)


def _told(motion: Motion, pictures: int) -> list[str]:
    """What is to be said of the cameras."""
    notes = []
    if motion.left_out:
        notes.append(
            f"no camera that holds was found for {len(motion.left_out)} of {pictures} pictures, which are left "
            f"out: {some(motion.left_out)}. To have them in: more pictures between these and their neighbours, at most "
            "15 degrees apart, sharp and bright; or larger ones, and a larger `megapixels`"
        )
    if motion.doubtful:
        notes.append(
            f"only {motion.agreeing:.0%} of the matches between pictures agree with the cameras that were found, which "
            "are likely wrong: something looks alike in many places (chequered cloth, tiles, equal windows). Take it "
            "away or cover it, lay printed things of all kinds around the object, and take pictures at most 10 degrees "
            "apart"
        )
    return notes


def object_sphere(points: np.ndarray, tracks: np.ndarray, camera_to_world: np.ndarray) -> tuple[np.ndarray, float]:
    """(centre [3], radius) of what stands amidst the cameras, without masks.

    Of the sparse points, those nearer than the cameras to the point that the optical axes pass most closely, each
    counted by the pictures that see it: their median, and the distance that holds 98 % of them, and a little. No more
    than keeps three quarters of the cameras well outside: a floor that goes on below them is no object.
    """
    origins, axes = camera_to_world[:, :3, 3], camera_to_world[:, :3, 2]
    middle = nearest_point(origins, axes)
    reach = np.median(np.linalg.norm(origins - middle, axis=1))
    near = np.linalg.norm(points - middle, axis=1) < _NEAR * reach
    if near.sum() < 10:
        raise DataError(
            f"{int(near.sum())} sparse points lie where the cameras look, too few to locate the object",
            fix="take pictures closer together and from more sides, or add masks; an object that mirrors or has no "
            "paint has no points of its own: dull it with spray or powder",
        )
    many = np.repeat(points[near], tracks[near], axis=0)
    centre = np.median(many, axis=0)
    radius = _ROOM * float(np.quantile(np.linalg.norm(many - centre, axis=1), 0.98))
    return centre, min(radius, _OUTSIDE * float(np.quantile(np.linalg.norm(origins - centre, axis=1), 0.25)))
