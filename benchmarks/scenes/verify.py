"""What a made scene is checked by: cameras, masks and depth against the mesh; each light's pictures against a sum over
all texels of its file."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.scenes.cameras import rays
from benchmarks.scenes.render import Stage, environment_error
from benchmarks.scenes.truth import Truth

POINTS, PATHS = 24, 4096


def verify(
    stage: Stage, truth: Truth, poses: list[np.ndarray], lights: dict[str, np.ndarray], size: int, *, masked: bool
) -> dict[str, Any]:
    """Figures of the test views: silhouettes from the files' cameras against the renderer's alpha (where there are
    masks); depth carried back to the mesh; per light the renderer's direct light over the sum (median, 10 and 90 %) and
    the renderer's lookup against the definition of the files."""
    found: dict[str, Any] = {"vertices": len(truth.model.vertices), "faces": len(truth.model.faces)}
    if masked:
        found["iou"] = [round(silhouette(stage, truth, pose, min(size, 256)), 5) for pose in poses[:4]]
    found["depth_to_mesh_max"] = depth_error(truth, poses[0], size)
    found["light"] = {}
    for number, (name, light) in enumerate(lights.items()):
        ratio = direct_light(stage, truth, poses[number % len(poses)], name, light, size)
        low, middle, high = (round(float(v), 4) for v in np.percentile(ratio, [10, 50, 90]))
        found["light"][name] = {
            "render_over_sum": [low, middle, high],
            "points": len(ratio),
            "lookup_error": environment_error(stage.mi, light),
        }
    return found


def silhouette(stage: Stage, truth: Truth, pose: np.ndarray, size: int) -> float:
    """Intersection over union of the renderer's coverage and of rays through the files' camera, at half coverage."""
    scene = stage.lit("white", np.ones((16, 32, 3), np.float32), 2)
    drawn = stage.picture(scene, pose, size, 16, 1)[..., 3] > 0.5
    cast = truth.view(pose, size)["alpha"] > 0.5
    return float((drawn & cast).sum() / (drawn | cast).sum())


def depth_error(truth: Truth, pose: np.ndarray, size: int) -> float:
    """Largest distance of the points which the depth picture stands for, as float32, to the plane of the face there."""
    depth = truth.view(pose, size)["depth"].astype(np.float32).reshape(-1)
    along = rays(pose, size).reshape(-1, 6)
    met = truth.cast(along)
    step = depth / (along[:, 3:] @ -pose[:3, 2])
    points = (along[:, :3] + step[:, None] * along[:, 3:])[met.hit]
    corners = truth.model.vertices[truth.model.faces[met.face[met.hit]]].astype(np.float64)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return float(np.abs(((points - corners[:, 0]) * across).sum(1)).max())


def direct_light(stage: Stage, truth: Truth, pose: np.ndarray, name: str, light: np.ndarray, size: int) -> np.ndarray:
    """Light met once along the rays of random pixels: Mitsuba's over the sum over all texels [N], of the colours' mean.

    Pixels are left out that see nothing, see it at a grazing angle, or get less than a hundredth of the usual."""
    along = rays(pose, size).reshape(-1, 6)
    chosen = np.random.default_rng(3).permutation(len(along))[: 40 * POINTS]
    met = truth.cast(along[chosen])
    facing = -(met.normal * along[chosen, 3:]).sum(1)
    chosen = chosen[met.hit & (facing > 0.2)][:POINTS]
    summed, _ = truth.direct(along[chosen], light)
    drawn = stage.along(stage.lit(name, light, 2), along[chosen], PATHS, 5)
    bright = summed.mean(1) > 0.01 * np.median(summed.mean(1))
    return drawn[bright].mean(1) / summed[bright].mean(1)
