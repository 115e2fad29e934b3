"""Small scenes for the rows of Stage II: a sphere with its own atlas, a ring of cameras, analytic pictures of it.

A convex body lit from far away: radiance = a integral of max(n.l, 0) L / pi + the GGX lobe over L, no visibility and
no interreflection. The diffuse integral is a sum over the texels of a finer map, the lobe a mean over many
visible-normal samples: neither uses the precomputed transport, the split sum or the traced correction of the fit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.raster import rasterize
from exmesh_graph.shading import brdf, envmap
from exmesh_graph.shading.brdf_sampling import sample_specular
from exmesh_graph.shading.point_sets import hammersley
from exmesh_graph.shading.transport import trace_transport
from exmesh_graph.stage2.settings import DecompositionSettings
from exmesh_graph.stage2.surface import CarrierGeometry, SurfaceSamples
from exmesh_graph.testing import look_at
from exmesh_graph.types import Asset, Carrier, Transport, Views

SIZE, TEXELS, SKY_ROWS = 40, 16, 16
RINGS = 20

#: Short noise-free fits of a scene without interreflection.
SETTINGS = DecompositionSettings(
    environment_height=SKY_ROWS,
    iterations=100,
    material_rate=0.1,
    environment_rate=0.3,
    rate_decay=0.05,
    ssim_weight=0.0,
    material_weight=0.01,
    environment_weight=0.002,
    chroma_weight=0.05,
    corrections=3,
    correction_samples=32,
)


@dataclass
class Surface:
    """What a picture is made of, at N points: base colour [N, 3], roughness [N], metallic [N]."""

    base_color: torch.Tensor
    roughness: torch.Tensor
    metallic: torch.Tensor


def sphere(radius: float = 0.6) -> Carrier:
    """A lat-long sphere, its longitudes and latitudes the atlas."""
    columns = 2 * RINGS
    t, p = np.meshgrid(np.arange(RINGS + 1) / RINGS, np.arange(columns) / columns, indexing="ij")
    points = np.stack(
        [np.sin(np.pi * t) * np.sin(2 * np.pi * p), np.cos(np.pi * t), np.sin(np.pi * t) * np.cos(2 * np.pi * p)], -1
    )
    index = np.arange(columns * (RINGS + 1)).reshape(RINGS + 1, columns)
    index[0], index[-1] = index[0, 0], index[-1, 0]
    faces, uvs = [], []
    for i in range(RINGS):
        for j in range(columns):
            for cell in ([(i, j), (i + 1, j), (i + 1, j + 1)], [(i, j), (i + 1, j + 1), (i, j + 1)]):
                corner = [index[a, b % columns] for a, b in cell]
                if len(set(corner)) == 3:
                    faces.append(corner)
                    uvs += [(0.02 + 0.96 * b / columns, 0.98 - 0.96 * a / RINGS) for a, b in cell]
    used, faces = np.unique(np.array(faces), return_inverse=True)
    faces = faces.reshape(-1, 3).astype(np.int32)
    return Carrier(
        vertices=(radius * points.reshape(-1, 3)[used]).astype(np.float32),
        faces=faces,
        uvs=np.array(uvs, np.float32),
        uv_faces=np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3),
        texture=np.full((TEXELS, TEXELS, 3), 0.5, np.float32),
    )


def cameras(count: int, size: int = SIZE, turn: float = 0.0, half: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Intrinsics and camera-to-world of `count` cameras around the origin; `half`: from one side only."""
    poses = []
    for k in range(count):
        angle = turn + (np.pi * (k / count - 0.5) / 2 if half else 2 * np.pi * k / count)
        eye = np.array([np.sin(angle), 0.7 * (-1) ** k * (0.5 + k % 3 / 2), np.cos(angle)])
        eye *= 2.4 / np.linalg.norm(eye)
        poses.append(look_at(eye))
    intrinsics = np.array([[1.7 * size, 0, size / 2], [0, 1.7 * size, size / 2], [0, 0, 1.0]])
    return np.repeat(intrinsics[None], count, 0), np.stack(poses)


def sky(direction: tuple[float, float, float] = (0.5, 0.6, 0.6), sharpness: float = 6.0) -> np.ndarray:
    """A gray-blue sky with one bright warm side."""
    axis = np.array(direction) / np.linalg.norm(direction)
    d = envmap.texel_directions(SKY_ROWS, 2 * SKY_ROWS)
    spot = np.exp(sharpness * ((d @ axis) - 1))[..., None] * np.array([3.0, 2.6, 2.0])
    return (np.array([0.35, 0.4, 0.5]) + spot).astype(np.float32)


def photographs(carrier: Carrier, light: np.ndarray, paint, count: int = 8, **camera) -> Views:  # type: ignore[no-untyped-def]
    """Analytic pictures; `paint(position [N, 3]) -> Surface`."""
    geometry = CarrierGeometry(carrier)
    intrinsics, poses = cameras(count, **camera)
    size = camera.get("size", SIZE)
    images = np.zeros((count, size, size, 3), np.float32)
    alpha = np.zeros((count, size, size), np.float32)
    for k in range(count):
        fragments = rasterize(
            geometry.vertices,
            geometry.faces.int(),
            tensor_of(intrinsics[k]),
            torch.from_numpy(np.linalg.inv(poses[k])),
            size,
            size,
        )
        row, column = torch.nonzero(fragments.face_id >= 0, as_tuple=True)
        seen = geometry.samples(
            fragments.face_id[row, column].long(),
            fragments.bary[row, column],
            torch.from_numpy(poses[k][:3, 3].astype(np.float32)),
        )
        images[k, row, column] = radiance(seen, paint(seen.position), light).numpy()
        alpha[k, row, column] = 1
    names = tuple(f"v{k}" for k in range(count))
    return Views(names, images, alpha, intrinsics, poses, "train", clipped=False)


def radiance(seen: SurfaceSamples, material: Surface, light: np.ndarray, samples: int = 256) -> torch.Tensor:
    """Radiance [N, 3] of points of a convex body."""
    diffuse = brdf.diffuse(material.base_color, material.metallic)
    f0 = brdf.base_reflectance(material.base_color, material.metallic)
    grid = hammersley(samples)
    shift = torch.rand(len(seen), 1, 2, generator=torch.Generator().manual_seed(1))
    towards, weight, _, v_h = sample_specular(
        seen.normal, seen.view, brdf.alpha_of(material.roughness), (grid + shift) % 1
    )
    incoming = envmap.lookup(tensor_of(light), towards)
    lobe = (incoming * brdf.schlick(v_h, f0[:, None]) * weight[..., None]).mean(1)
    return (diffuse * irradiance(seen.normal, light)).float() + lobe


def irradiance(normal: torch.Tensor, light: np.ndarray) -> torch.Tensor:
    """Integral of max(n.l, 0) L over the sphere, float64 [N, 3], on a map four times as fine (bilinear, as lookups)."""
    rows = 4 * light.shape[0]
    towards = torch.from_numpy(envmap.texel_directions(rows, 2 * rows)).reshape(-1, 3)
    angle = torch.from_numpy(envmap.solid_angles(rows, 2 * rows)).repeat_interleave(2 * rows)
    energy = envmap.lookup(tensor_of(light).double(), towards) * angle[:, None]
    return (normal.double() @ towards.T).clamp_min(0) @ energy


def uniform(base: tuple[float, float, float], roughness: float, metallic: float = 0.0):  # type: ignore[no-untyped-def]
    """A paint of one material."""

    def paint(position: torch.Tensor) -> Surface:
        one = torch.ones(len(position))
        return Surface(torch.tensor(base).expand(len(position), 3), roughness * one, metallic * one)

    return paint


def transport_of(carrier: Carrier, directions: int = 512) -> Transport:
    return trace_transport(carrier.vertices, carrier.faces, directions)


def worst_error(found: np.ndarray, seen: np.ndarray, truth: object) -> float:
    """Largest error over channels of the mean over seen texels, plus the spread (standard deviation) around it."""
    values = found[seen].reshape(int(seen.sum()), -1).astype(np.float64)
    return float((np.abs(values.mean(0) - np.asarray(truth)) + values.std(0)).max())


def texel_error(asset: Asset, channel: str, truth: np.ndarray) -> float:
    """Mean absolute error of a map over its seen texels; `truth` as the map."""
    return float(np.abs(getattr(asset, channel)[asset.seen] - truth[asset.seen]).mean())


def texel_positions(carrier: Carrier) -> np.ndarray:
    """Unit directions [R, R, 3] of the sphere's texels."""
    v, u = np.meshgrid((np.arange(TEXELS) + 0.5) / TEXELS, (np.arange(TEXELS) + 0.5) / TEXELS, indexing="ij")
    p, t = 2 * math.pi * (u - 0.02) / 0.96, np.pi * (0.98 - (1 - v)) / 0.96
    return np.stack([np.sin(t) * np.sin(p), np.cos(t), np.sin(t) * np.cos(p)], -1)


def lamps() -> np.ndarray:
    """A dim sky with six coloured lamps all around: highlights everywhere tell shiny from matt."""
    d = envmap.texel_directions(SKY_ROWS, 2 * SKY_ROWS)
    light = np.full((SKY_ROWS, 2 * SKY_ROWS, 3), 0.25)
    for axis, tint in zip(np.concatenate([np.eye(3), -np.eye(3)]), np.eye(3)[[0, 1, 2, 1, 2, 0]], strict=True):
        turned = np.array([axis[0] + 0.4 * axis[1], axis[1] - 0.4 * axis[0], axis[2] + 0.2])
        spot = np.exp(25 * (d @ (turned / np.linalg.norm(turned)) - 1))
        light += spot[..., None] * (6 + 4 * tint)
    return light.astype(np.float32)
