"""Depth from a network: Depth Anything 3 (Lin et al. 2025), through its own package.

The package (`depth-anything-3`, Apache-2.0) and the weights are the user's to install: DA3-SMALL, DA3-BASE,
DA3METRIC-LARGE and DA3MONO-LARGE are Apache-2.0, the larger ones CC BY-NC 4.0. Nothing else in this project needs them.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from exmesh_graph.colour import display
from exmesh_graph.errors import DataError, NumericsError
from exmesh_graph.native import import_depth_anything
from exmesh_graph.priors.settings import NetworkSettings
from exmesh_graph.types import DepthMaps, Views

_FILES = ("config.json", "model.safetensors")


def weight_files(folder: Path) -> list[Path]:
    """The files of a folder of weights. DataError where one is missing."""
    for name in _FILES:
        if not (folder / name).is_file():
            raise DataError(
                f"there is no {name}", where=str(folder), expected=" and ".join(_FILES),
                fix="download both from the model's page, or leave `weights` out to load them from the hub",
            )  # fmt: skip
    return [folder / name for name in _FILES]


def estimate(
    views: Views,
    settings: NetworkSettings,
    *,
    device: torch.device | str = "cpu",
    progress: Callable[[int, int], None] | None = None,
) -> DepthMaps:
    """Relative depth of all views, `batch` views at a time; 0 outside the masks.

    With `cameras` the network is told the poses, which makes the views of a batch agree; monocular models take none.
    Raises MissingLibraryError without the package, DataError without weights, NumericsError for depths that are not
    finite or not positive.
    """
    model = _load(settings).to(device)
    model.eval()
    poses = views.world_to_camera.astype(np.float32)
    intrinsics = np.asarray(views.intrinsics, np.float32)
    maps = []
    for start in range(0, len(views), settings.batch):
        part = slice(start, min(start + settings.batch, len(views)))
        known = {"extrinsics": poses[part], "intrinsics": intrinsics[part]} if settings.cameras else {}
        prediction = model.inference(
            [_codes(views, i) for i in range(part.start, part.stop)], process_res=settings.resolution, **known
        )
        depth = torch.from_numpy(np.array(prediction.depth, np.float32))[:, None]
        # nearest, not a mean: depths must not be mixed across an edge
        size = (views.height, views.width)
        maps.append(torch.nn.functional.interpolate(depth, size=size, mode="nearest-exact")[:, 0].numpy())
        _check(maps[-1], views.names[part])
        if progress is not None:
            progress(part.stop, len(views))
    depths = np.concatenate(maps)
    for depth, alpha in zip(depths, views.alpha, strict=True):
        depth[~(alpha > 0.5)] = 0
    return DepthMaps(views.names, depths.astype(np.float32, copy=False), "relative")


def _codes(views: Views, i: int) -> np.ndarray:
    """uint8 [H, W, 3], a view as displayed over black."""
    shown = display(torch.from_numpy(np.array(views.images[i])), torch.from_numpy(np.array(views.alpha[i]))).numpy()
    return np.rint(255 * np.clip(shown, 0, 1)).astype(np.uint8)


def _load(settings: NetworkSettings) -> Any:
    network = import_depth_anything().DepthAnything3
    if settings.weights is not None:
        weight_files(settings.weights)
        return network.from_pretrained(str(settings.weights))
    try:
        return network.from_pretrained(settings.model, **({"revision": settings.revision} if settings.revision else {}))
    except (OSError, ValueError) as error:  # what the hub's client raises: no network, no such model, no access
        raise DataError(
            f"the weights of {settings.model} cannot be loaded ({error})", where="prior.depth_anything",
            expected="a model of the Hugging Face hub, or a folder of weights",
            fix="check the name and the network, or give `weights`: a folder with " + " and ".join(_FILES),
        ) from error  # fmt: skip


def _check(depth: np.ndarray, names: tuple[str, ...]) -> None:
    good = np.isfinite(depth) & (depth > 0)
    for name, of in zip(names, good, strict=True):
        if not of.all():
            raise NumericsError(
                f"{int((~of).sum())} depths of the network are not finite or not positive",
                where=f"prior.depth_anything, view {name!r}",
                fix="try device: cuda, or another model",
            )
