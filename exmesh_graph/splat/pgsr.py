"""From views to fitted planar Gaussians: where to begin, the fit, and which views do not agree with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from exmesh_graph.errors import DataError
from exmesh_graph.geometry.hull import SilhouetteField
from exmesh_graph.splat.fit import fit
from exmesh_graph.splat.gaussians import Gaussians
from exmesh_graph.splat.render import render
from exmesh_graph.splat.start import gaussians_at, hull_points, mean_colours, random_points
from exmesh_graph.targets import Targets, prepare_targets
from exmesh_graph.types import PlanarGaussians, PointCloud, Views

if TYPE_CHECKING:
    from exmesh_graph.splat.settings import PgsrSettings

_FAR = 3.0
_BELOW, _SPREADS = 3.0, 2.5


def pgsr(
    views: Views,
    settings: PgsrSettings,
    *,
    points: PointCloud | None = None,
    begin: PlanarGaussians | None = None,
    seed: int = 0,
    device: torch.device | str = "cpu",
    progress: Callable[..., None] | None = None,
    log: Callable[[str], None] = lambda message: None,
    where: str = "init.pgsr",
    checkpoint: Callable[[int, dict[str, Any]], None] | None = None,
    resumed: tuple[int, Mapping[str, Any]] | None = None,
) -> tuple[PlanarGaussians, dict[str, Any]]:
    """Planar Gaussians of `views` and the history of the fit, with "suspects": views drawn far worse than most.

    points   what `settings.start` may begin from (see `started`)
    begin    Gaussians to go on from, in place of a start
    Raises DataError where the chosen start lacks what it needs, and what `fit` raises.
    """
    targets = prepare_targets(views, downscale=settings.downscale, device=device)
    if begin is not None:
        gaussians = Gaussians.of(begin, device)
        if gaussians.sh.shape[1] < 16:
            extra = gaussians.sh.new_zeros((len(gaussians), 16 - gaussians.sh.shape[1], 3))
            gaussians.sh = torch.cat([gaussians.sh, extra], dim=1)
        log(f"goes on from {len(gaussians)} Gaussians")
    else:
        gaussians = started(views, targets, settings, points, seed, log, where).map(lambda t: t.to(device))
    if len(gaussians) > settings.max_gaussians:
        raise DataError(
            f"the start has {len(gaussians)} Gaussians, the limit is {settings.max_gaussians}", where=where,
            fix="raise max_gaussians, or lower count",
        )  # fmt: skip
    gaussians, history = fit(
        gaussians, targets, settings, seed=seed, progress=progress, where=where, checkpoint=checkpoint, resumed=resumed
    )
    history["suspects"] = suspects(gaussians, targets, history.get("gains", {}))
    arrays = {name: t.detach().cpu().numpy() for name, t in gaussians.tensors().items()}
    return PlanarGaussians(**arrays), history


def started(
    views: Views,
    targets: Targets,
    settings: PgsrSettings,
    points: PointCloud | None,
    seed: int,
    log: Callable[[str], None],
    where: str,
) -> Gaussians:
    """Where the fit begins, as `settings.start` says.

    points: from `points`; hull: `count` points in the visual hull of the masks, of which `wrong_masks` may be wrong;
    random: `count` points in the unit sphere; auto: points where there are any, else hull where all views have masks,
    else random. Raises DataError where the chosen start lacks what it needs.
    """
    start, count, masked = settings.start, settings.count, bool(views.masked.all())
    if start == "auto":
        start = "points" if points is not None else "hull" if masked else "random"
    if start == "points":
        return _from_points(points, seed, log, where)
    if start == "hull":
        if not masked:
            bare = [n for n, m in zip(views.names, views.masked, strict=True) if not m]
            raise DataError(
                f"start: hull needs a mask for every view; {len(bare)} of {len(views)} have none, {bare[0]!r} first",
                where=where, fix="add masks, leave these views out, or set start: random",
            )  # fmt: skip
        places, normals = hull_points(SilhouetteField.of_views(views, settings.wrong_masks), count, seed=seed)
        log(f"starts from {len(places)} points on and in the visual hull")
        return gaussians_at(places, mean_colours(places, targets, normals), normals, seed=seed)
    places = random_points(count, seed=seed)
    log(f"starts from {len(places)} random points in the unit sphere")
    return gaussians_at(places, mean_colours(places, targets), seed=seed)


def _from_points(points: PointCloud | None, seed: int, log: Callable[[str], None], where: str) -> Gaussians:
    if points is None:
        raise DataError(
            "start: points, but no points are wired in", where=where,
            fix='wire points: "@photos.points", or set start: hull or random',
        )  # fmt: skip
    kept = np.linalg.norm(points.points, axis=1) < _FAR
    if not kept.any():
        raise DataError(
            f"all {len(points)} points lie more than {_FAR:g} radii of the object from its middle", where=where,
            expected="points of the object in the normalised world", fix="look at the frame's centre and scale",
        )  # fmt: skip
    log(f"starts from {int(kept.sum())} points; {int((~kept).sum())} far outside are left out")
    return gaussians_at(points.points[kept], points.colours[kept], seed=seed)


@torch.no_grad()
def suspects(gaussians: Gaussians, targets: Targets, gains: Mapping[str, list[float]]) -> dict[str, str]:
    """Views drawn far worse than most, after their fitted factors [3] in `gains`: blurred, moved or badly posed
    photographs. View name -> what is wrong."""
    errors = []
    for i in range(len(targets)):
        drawing = render(gaussians, targets.intrinsics[i], targets.world_to_camera[i], targets.height, targets.width)
        colour = drawing.colour * drawing.colour.new_tensor(gains.get(targets.names[i], [1.0, 1.0, 1.0]))
        errors.append(float((colour - targets.images[i]).square().mean()))
    psnr = -10 * np.log10(np.maximum(errors, 1e-10))
    middle = np.median(psnr)
    limit = middle - max(_BELOW, _SPREADS * 1.4826 * float(np.median(np.abs(psnr - middle))))
    return {
        name: f"PSNR {p:.1f} dB where most views have {middle:.1f}: blurred, moved, its camera off, or "
        "shown by few others"
        for name, p in zip(targets.names, psnr, strict=True)
        if p < limit
    }
