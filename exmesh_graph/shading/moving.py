"""Light that moves with the camera: lamps beside a turntable, or a lamp that the camera carries.

An object on a turntable stands still in the frame that its cameras are known in: there camera and lamps go round it
together. The environment is then that of a frame of its own, which every view turns another way:

    x = axis x back, y = axis, z = back      `back` from the object to the camera, at right angles to the axis
    x = right, y = up, z = back              where the light is fixed to the camera

So the middle of the map is what shines from behind the photographer.
"""

from __future__ import annotations

import numpy as np
import torch

from exmesh_graph.shading import envmap
from exmesh_graph.shading.gather import gather_rows

#: A view that is steeper than this sine to the horizon has its azimuth from its upper edge too.
_FLAT = 0.25


def light_turns(axis: np.ndarray | None, camera_to_world: np.ndarray) -> np.ndarray | None:
    """Rotations float64 [N, 3, 3] from world directions to those of the light's frame; None for a light that stands.

    axis  as `types.Asset.light_axis`;  camera_to_world [N, 4, 4] of OpenCV's cameras
    """
    if axis is None:
        return None
    pose = np.asarray(camera_to_world, np.float64)[:, :3, :3]
    right, up, back = pose[..., 0], -pose[..., 1], -pose[..., 2]
    if not np.any(axis):
        return np.stack([right, up, back], axis=1)
    y = np.asarray(axis, np.float64) / np.linalg.norm(axis)
    towards = back - (back @ y)[:, None] * y
    # of a camera that looks along the axis, the upper edge points away from where it would stand; not if upside down
    upper = up * np.where(up @ y < -_FLAT, -1.0, 1.0)[:, None]
    steep = back - (back @ y)[:, None] * upper
    steep -= (steep @ y)[:, None] * y
    z = np.where(np.linalg.norm(towards, axis=1, keepdims=True) < _FLAT, steep, towards)
    z /= np.linalg.norm(z, axis=1, keepdims=True).clip(1e-12)
    return np.stack([np.cross(y, z), np.broadcast_to(y, z.shape), z], axis=1)


def turned(environment: torch.Tensor, turn: np.ndarray | None) -> torch.Tensor:
    """The map [H, W, 3] as it stands in the world, of one in a frame that `turn` [3, 3] takes the world's
    directions to; None: as it is. Bilinear; differentiable in the map."""
    if turn is None:
        return environment
    height, width = environment.shape[:2]
    towards = torch.from_numpy(envmap.texel_directions(height, width).reshape(-1, 3) @ np.asarray(turn).T)
    index, weight = envmap.bilinear(height, width, *envmap.uv_of(towards))
    rows = gather_rows(environment.reshape(-1, 3), index.to(environment.device), weight.to(environment))
    return rows.reshape(height, width, 3)
