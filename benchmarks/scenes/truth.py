"""What a rendered scene knows about itself, by rays of its own that do not go through the renderer's camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.scenes.cameras import rays
from benchmarks.scenes.lights import directions, lookup
from benchmarks.scenes.model import Model, decode
from exmesh_graph.native import import_open3d

#: Parts of a pixel along each axis that the maps are averaged over.
FINE = 4


@dataclass(frozen=True)
class Surface:
    """What rays [N, 6] meet: hit bool [N], distance [N], normal [N, 3] (smooth, unit, to the outside), base [N, 3]
    linear, roughness, metallic, own [N] (1 on the object, 0 on its ground);
    face [N], 0 without a hit."""

    hit: np.ndarray
    distance: np.ndarray
    normal: np.ndarray
    base: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray
    own: np.ndarray
    face: np.ndarray


class Truth:
    """Ray casting (Embree, through Open3D) on a model, and its maps read bilinearly."""

    def __init__(self, model: Model) -> None:
        o3d = import_open3d()
        self.model = model
        self.tensor = o3d.core.Tensor
        self.scene = o3d.t.geometry.RaycastingScene()
        self.scene.add_triangles(self.tensor(model.vertices), self.tensor(model.faces.astype(np.uint32)))
        single = (model.roughness, model.metallic, model.object)
        self.maps = np.concatenate(
            [decode(model.base / 255.0), *(m[..., None] / 255.0 for m in single)], axis=-1
        ).astype(np.float32)

    def cast(self, along: np.ndarray) -> Surface:
        """Surface that the rays meet first."""
        model = self.model
        found = self.scene.cast_rays(self.tensor(np.ascontiguousarray(along, np.float32)))
        distance = found["t_hit"].numpy()
        hit = np.isfinite(distance)
        bary = found["primitive_uvs"].numpy()
        bary = np.concatenate([1 - bary.sum(1, keepdims=True), bary], axis=1)[..., None]
        face = np.where(hit, found["primitive_ids"].numpy(), 0).astype(np.int64)
        corners = model.faces[face]
        normal = (model.normals[corners] * bary).sum(1)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True).clip(1e-9)
        values = self.read((model.uv[corners] * bary).sum(1))
        return Surface(hit, distance, normal, values[:, :3], *values[:, 3:].T, face)

    def read(self, uv: np.ndarray) -> np.ndarray:
        """(base, roughness, metallic, own) [N, 6] at texture coordinates [N, 2], bilinear."""
        size = len(self.maps)
        x, y = uv[:, 0] * size - 0.5, (1 - uv[:, 1]) * size - 0.5
        c, r = np.floor(x).astype(int), np.floor(y).astype(int)
        a, b = (x - c)[:, None], (y - r)[:, None]
        (c0, c1), (r0, r1) = (c % size, (c + 1) % size), (r % size, (r + 1) % size)
        above = (1 - a) * self.maps[r0, c0] + a * self.maps[r0, c1]
        return (1 - b) * above + b * ((1 - a) * self.maps[r1, c0] + a * self.maps[r1, c1])

    def free(self, origins: np.ndarray, towards: np.ndarray) -> np.ndarray:
        """Whether rays [N, 3] from just off the surface leave the scene."""
        along = np.concatenate([origins, towards], axis=1).astype(np.float32)
        return ~self.scene.test_occlusions(self.tensor(along)).numpy()

    def view(self, pose: np.ndarray, size: int) -> dict[str, np.ndarray]:
        """albedo [H, W, 3] linear, rough, metallic [H, W], each the mean over the covered part of a pixel; alpha
        and own [H, W], coverage by anything and by the object; normal [H, W, 3] and depth
        [H, W] (along -z of the camera) at the pixels' middles, 0 outside."""
        total = np.zeros((size, size, 7))
        rows = max(1, 2**19 // (size * FINE * FINE))
        fine = rays(pose, size, FINE)
        for first in range(0, size, rows):
            part = fine[first * FINE : (first + rows) * FINE].reshape(-1, 6)
            met = self.cast(part)
            values = np.column_stack([met.base, met.roughness, met.metallic, met.own > 0.5, np.ones(len(part))])
            total[first : first + rows] = (values * met.hit[:, None]).reshape(-1, FINE, size, FINE, 7).mean((1, 3))
        alpha = total[..., 6]
        mean = total[..., :5] / alpha[..., None].clip(1e-9)
        middle = rays(pose, size)
        met = self.cast(middle.reshape(-1, 6))
        along = np.where(met.hit, met.distance * (middle.reshape(-1, 6)[:, 3:] @ -pose[:3, 2]), 0)
        return {
            "albedo": mean[..., :3], "rough": mean[..., 3], "metallic": mean[..., 4], "alpha": alpha,
            "own": total[..., 5],
            "normal": (met.normal * met.hit[:, None]).reshape(size, size, 3), "depth": along.reshape(size, size),
        }  # fmt: skip

    def direct(self, along: np.ndarray, light: np.ndarray, rows: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """(radiance [N, 3] of rays [N, 6] from light met once, hit [N]): the sum of the BRDF over all texels of the
        map, each divided into `rows` x `rows` parts, with visibility by rays."""
        met = self.cast(along)
        towards = directions(rows * light.shape[0]).reshape(-1, 3)
        height = rows * light.shape[0]
        polar = (np.arange(height) + 0.5) / height * np.pi
        weight = np.repeat(np.sin(polar) * (np.pi / height) ** 2, 2 * height)
        arriving = lookup(light, towards) * weight[:, None]
        found = np.zeros((len(along), 3))
        for k in np.flatnonzero(met.hit):
            point = along[k, :3] + met.distance[k] * along[k, 3:]
            cosine = towards @ met.normal[k]
            lit = np.flatnonzero(cosine > 1e-4)
            off = np.broadcast_to(point - 2e-4 * along[k, 3:] + 2e-4 * met.normal[k], (len(lit), 3))
            lit = lit[self.free(off, towards[lit])]
            value = brdf(met.base[k], met.roughness[k], met.metallic[k], met.normal[k], -along[k, 3:], towards[lit])
            found[k] = (value * cosine[lit, None] * arriving[lit]).sum(0)
        return found, met.hit


def brdf(base: np.ndarray, roughness: float, metallic: float, n: np.ndarray, v: np.ndarray, l: np.ndarray) -> Any:
    """The reflectance of the scenes [N, 3] for one point, one view and light from directions l [N, 3]."""
    half = l + v
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    n_l, n_v, n_h, v_h = l @ n, n @ v, half @ n, half @ v
    a2 = max(roughness**2, 3.6e-4) ** 2
    d = a2 / (np.pi * (n_h**2 * (a2 - 1) + 1) ** 2)

    def smith(c: np.ndarray) -> np.ndarray:
        return (np.sqrt(1 + a2 * (1 / c**2 - 1)) - 1) / 2

    g = 1 / (1 + smith(n_l) + smith(n_v))
    f0 = 0.04 * (1 - metallic) + metallic * base
    fresnel = f0 + (1 - f0) * (1 - v_h[:, None]) ** 5
    return (1 - metallic) * base / np.pi + (d * g / (4 * n_l * n_v))[:, None] * fresnel
