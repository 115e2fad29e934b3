"""A new atlas for a mesh that has one, with its texture and the optimiser's moments moved over."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from exmesh_graph.geometry.adjacency import signed_areas_2d
from exmesh_graph.uv.transfer import transfer_texture
from exmesh_graph.uv.unwrap import unwrap


@dataclass(frozen=True, eq=False)
class NewAtlas:
    """uvs [T, 2], uv_faces [F, 3], texture and Adam's texture moments [R, R, 3], covered bool [R, R]."""

    uvs: np.ndarray
    uv_faces: np.ndarray
    texture: np.ndarray
    first_moment: np.ndarray
    second_moment: np.ndarray
    covered: np.ndarray


def regenerate(
    vertices: np.ndarray,
    faces: np.ndarray,
    uvs: np.ndarray,
    uv_faces: np.ndarray,
    texture: np.ndarray,
    first_moment: np.ndarray,
    second_moment: np.ndarray,
    texture_size: int,
    **unwrap_settings: Any,
) -> NewAtlas:
    """Unwrap anew and resample texture and moments (shapes as in types.Stage1State).

    A texel's gradient grows with the surface it stands for, so the moments are scaled by the ratio of texel areas.
    """
    new_uvs, new_faces = unwrap(vertices, faces, texture_size, **unwrap_settings)
    atlas = (uvs, uv_faces, new_uvs, new_faces, texture_size)
    colour, covered = transfer_texture({"texture": texture}, *atlas, bounds=(0.0, 1.0))
    moments, _ = transfer_texture({"m": first_moment, "v": second_moment}, *atlas, sharpen=0)
    old_area = float(np.abs(signed_areas_2d(uvs, uv_faces)).sum()) * texture.shape[0] ** 2
    new_area = float(np.abs(signed_areas_2d(new_uvs, new_faces)).sum()) * texture_size**2
    growth = np.float32(old_area / max(new_area, 1e-300))  # of the surface under one texel
    return NewAtlas(
        new_uvs,
        new_faces,
        colour["texture"],
        moments["m"] * growth,
        moments["v"] * growth**2,
        covered,
    )
