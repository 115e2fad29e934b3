"""Pictures without what their lenses darken."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from exmesh_graph.io.picture_files import Picture, with_pictures
from exmesh_graph.priors.patch_match.estimate import Stereo, patch_match
from exmesh_graph.priors.patch_match.sources import choose_sources
from exmesh_graph.priors.radiometry.pairs import pairs_of, tangents_squared
from exmesh_graph.priors.radiometry.vignetting import Vignetting, vignetting_of
from exmesh_graph.priors.settings import PatchMatchSettings
from exmesh_graph.types import PointCloud, Views

_SIDE, _SOURCES = 360, 8
_ALIKE = 0.02  # of a field of view: zooms rest at different lengths
_FEWEST, _MOST = 6, 60  # views of one lens; views in all, where depth is still to be found


@dataclass(frozen=True)
class Lens:
    """One lens, or one length of a zoom: the longer side of its pictures over the focal length, and how it darkens."""

    field: float
    vignetting: Vignetting

    def took(self, views: Views) -> np.ndarray:
        """bool [N], which of `views` were taken through it."""
        return np.asarray(np.abs(_fields(views) / self.field - 1) < _ALIKE)


def lenses_of(views: Views, stereo: Stereo | None, points: PointCloud | None = None, *, seed: int = 0) -> list[Lens]:
    """The lenses of `views`, told apart by their field of view, and what each does to light.

    stereo  of these views; None: found here, of 60 of them at most, at 360 pixels, beginning at `points`
    Lenses of fewer than six views are left out. Equal arguments give equal results on any number of cores.
    """
    if stereo is None and len(views) > _MOST:
        views = views.subset(np.linspace(0, len(views) - 1, _MOST).round())
    if len(views) < _FEWEST:
        return []
    stereo = stereo or patch_match(views, PatchMatchSettings(side=_SIDE), points=points, seed=seed)
    known = None if points is None else points.points
    sources = choose_sources(views.intrinsics, views.camera_to_world, views.height, views.width, _SOURCES, known)
    pairs = pairs_of(views, stereo.depths, stereo.normals, sources)
    fields, left, found = _fields(views), np.ones(len(views), bool), []
    while left.any():
        field = fields[left.argmax()]
        rows = np.flatnonzero(left & (np.abs(fields / field - 1) < _ALIKE))
        left[rows] = False
        if len(rows) >= _FEWEST:
            inside = np.isin(pairs.first, rows) & np.isin(pairs.second, rows)
            found.append(Lens(float(field), vignetting_of(pairs.of(inside), len(views))))
    return found


def even(views: Views, lenses: Sequence[Lens]) -> Views:
    """`views`, of any size, brightened where their lens darkens them and that was found.

    Where 8-bit pictures are cut off at 1 they stay so: what would be brighter than 1 is as unknown as before.
    """
    known = [(lens.took(views), lens.vignetting) for lens in lenses if lens.vignetting.found]
    of_view = [next((one for took, one in known if took[k]), None) for k in range(len(views))]
    if not any(of_view):
        return views

    def pictures() -> Iterator[Picture]:
        for k, vignetting in enumerate(of_view):
            picture, alpha = np.asarray(views.images[k]), np.asarray(views.alpha[k])
            if vignetting is not None:
                squared = tangents_squared(views.intrinsics[k], views.height, views.width)
                picture = (picture / vignetting.at(squared)[..., None]).astype(np.float32)
                if views.clipped:
                    picture = np.minimum(picture, alpha[..., None])
            yield picture, alpha, None

    return with_pictures(views, pictures(), views.height, views.width)


def _fields(views: Views) -> np.ndarray:
    """float64 [N], as `Lens.field`."""
    return np.asarray(max(views.height, views.width) / views.intrinsics[:, 0, 0])
