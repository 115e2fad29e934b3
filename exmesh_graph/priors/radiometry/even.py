"""Pictures without what their lenses darken."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from exmesh_graph.io.picture_files import Picture, with_pictures
from exmesh_graph.priors.patch_match.estimate import patch_match
from exmesh_graph.priors.patch_match.sources import choose_sources
from exmesh_graph.priors.radiometry.pairs import pairs_of, tangents_squared
from exmesh_graph.priors.radiometry.vignetting import Vignetting, vignetting_of
from exmesh_graph.priors.settings import PatchMatchSettings
from exmesh_graph.types import DepthMaps, PointCloud, Views

_SIDE, _SOURCES = 360, 8
_ALIKE = 0.02  # of a field of view: zooms rest at different lengths
_FEWEST = 6  # views of one lens


@dataclass(frozen=True)
class Lens:
    """One lens, or one length of a zoom: the names of the views it took, and how it darkens them."""

    names: frozenset[str]
    vignetting: Vignetting

    @property
    def told(self) -> str:
        """Which pictures."""
        return f"{len(self.names)} pictures"


def lenses_of(views: Views, depths: DepthMaps | None, points: PointCloud | None = None, *, seed: int = 0) -> list[Lens]:
    """The lenses of `views`, told apart by their field of view, and what each does to light.

    depths  of these views; None: found here, by stereo at 360 pixels that begins at `points`
    Lenses of fewer than six views are left out. Equal arguments give equal results on any number of cores.
    """
    if len(views) < _FEWEST:
        return []
    if depths is None:
        depths = patch_match(views, PatchMatchSettings(side=_SIDE), points=points, seed=seed).depths
    known = None if points is None else points.points
    sources = choose_sources(views.intrinsics, views.camera_to_world, views.height, views.width, _SOURCES, known)
    pairs = pairs_of(views, depths, sources)
    found = []
    for rows in _alike(views):
        if len(rows) >= _FEWEST:
            inside = np.isin(pairs.first, rows) & np.isin(pairs.second, rows)
            names = frozenset(views.names[row] for row in rows)
            found.append(Lens(names, vignetting_of(pairs.of(inside), len(views))))
    return found


def even(views: Views, lenses: Sequence[Lens]) -> Views:
    """`views`, of any size, brightened where their lens darkens them and that was found.

    Where 8-bit pictures are cut off at 1 they stay so: what would be brighter than 1 is as unknown as before.
    """
    lens_of = {name: lens.vignetting for lens in lenses if lens.vignetting.found for name in lens.names}
    if not any(name in lens_of for name in views.names):
        return views

    def pictures() -> Iterator[Picture]:
        for k, name in enumerate(views.names):
            picture, alpha = np.asarray(views.images[k]), np.asarray(views.alpha[k])
            if name in lens_of:
                squared = tangents_squared(views.intrinsics[k], views.height, views.width)
                picture = (picture / lens_of[name].at(squared)[..., None]).astype(np.float32)
                if views.clipped:
                    picture = np.minimum(picture, alpha[..., None])
            yield picture, alpha, None

    return with_pictures(views, pictures(), views.height, views.width)


def _alike(views: Views) -> list[np.ndarray]:
    """Rows of views whose field of view is about the same, each row once."""
    width = max(views.height, views.width) / views.intrinsics[:, 0, 0]
    left, groups = np.arange(len(views)), []
    while len(left):
        near = np.abs(width[left] / width[left[0]] - 1) < _ALIKE
        groups.append(left[near])
        left = left[~near]
    return groups
