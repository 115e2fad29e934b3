"""A small scene whose true shape and texture are known: a textured ball among eight cameras."""

import math

import numpy as np
import torch

from exmesh_graph.losses import srgb_to_linear
from exmesh_graph.stage1.render import render_carrier
from exmesh_graph.types import Carrier, Stage1State, Views

SIZE = 48
TEXELS = 32


def grid_ball(rings: int = 10, sectors: int = 16, radius: float = 0.6):
    """A closed latitude-longitude ball with its natural atlas: vertices, faces, uvs, uv_faces."""
    lat = np.linspace(-math.pi / 2, math.pi / 2, rings + 1)
    lon = np.linspace(-math.pi, math.pi, sectors + 1)
    index = np.zeros((rings + 1, sectors + 1), int)
    vertices = []
    for i, a in enumerate(lat):
        for j in range(sectors):
            if i in (0, rings) and j > 0:
                index[i, j] = index[i, 0]
                continue
            index[i, j] = len(vertices)
            vertices.append([math.cos(a) * math.sin(lon[j]), math.sin(a), math.cos(a) * math.cos(lon[j])])
        index[i, sectors] = index[i, 0]
    uvs = np.stack(np.meshgrid((lon + math.pi) / (2 * math.pi), (lat + math.pi / 2) / math.pi), -1).reshape(-1, 2)
    uv_index = np.arange((rings + 1) * (sectors + 1)).reshape(rings + 1, sectors + 1)
    faces, uv_faces = [], []
    for i in range(rings):
        for j in range(sectors):
            quad = [(i, j), (i, j + 1), (i + 1, j + 1), (i + 1, j)]
            for triple in ((0, 1, 2), (0, 2, 3)):
                corners = [quad[k] for k in triple]
                ids = [index[c] for c in corners]
                if len(set(ids)) == 3:
                    faces.append(ids)
                    uv_faces.append([uv_index[c] for c in corners])
    return (
        radius * np.array(vertices, np.float32),
        np.array(faces, np.int32),
        (uvs * 0.9 + 0.05).astype(np.float32),
        np.array(uv_faces, np.int32),
    )


def texture(size: int = TEXELS) -> np.ndarray:
    """A smooth coloured pattern in [0.2, 0.8]."""
    v, u = np.meshgrid(np.linspace(0, 1, size), np.linspace(0, 1, size), indexing="ij")
    waves = [np.sin(6 * u + 2 * v), np.cos(5 * v - 1), np.sin(9 * u * v)]
    return (0.5 + 0.3 * np.stack(waves, -1)).astype(np.float32)


def ball(radius: float = 0.6, **options) -> Carrier:
    vertices, faces, uvs, uv_faces = grid_ball(radius=radius, **options)
    return Carrier(vertices, faces, uvs, uv_faces, texture())


def cameras(count: int = 8, size: int = SIZE, distance: float = 2.5):
    """Cameras around the Y axis, some from above and below: intrinsics [N, 3, 3], camera_to_world [N, 4, 4]."""
    poses = []
    for i in range(count):
        angle, height = 2 * math.pi * i / count, 0.5 * math.sin(2.4 * i)
        eye = np.array([math.sin(angle), height, math.cos(angle)])
        forward = -eye / np.linalg.norm(eye)
        right = np.cross(forward, [0, 1, 0])
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
        pose[:3, 3] = -distance * forward
        poses.append(pose)
    intrinsics = np.array([[1.6 * size, 0, size / 2 + 1.5], [0, 1.6 * size, size / 2 - 1], [0, 0, 1]])
    return np.repeat(intrinsics[None], count, 0), np.stack(poses)


def photographs(carrier: Carrier, count: int = 8, size: int = SIZE, exposure=None) -> Views:
    """What `carrier` looks like from `cameras`: linear, premultiplied."""
    intrinsics, poses = cameras(count, size)
    blank = np.zeros((count, size, size), np.float32)
    names = tuple(f"v{i}" for i in range(count))
    empty = Views(names, np.zeros((count, size, size, 3), np.float32), blank, intrinsics, poses, "train")
    colours, alpha = render_carrier(carrier, empty)
    if exposure is not None:
        colours = np.clip(colours * np.asarray(exposure, np.float32)[:, None, None, None], 0, 1)
    straight = torch.from_numpy(colours / np.maximum(alpha, 1e-6)[..., None]).clamp(0, 1)
    images = (srgb_to_linear(straight).numpy() * alpha[..., None]).astype(np.float32)
    return Views(names, images, alpha, intrinsics, poses, "train")


def fresh_state(carrier: Carrier, fill: float | None = None) -> Stage1State:
    count, size = len(carrier.vertices), carrier.texture.shape[0]
    start = carrier.texture if fill is None else np.full_like(carrier.texture, fill)
    return Stage1State(
        carrier.vertices, carrier.faces, carrier.uvs, carrier.uv_faces, start,
        np.zeros((count, 3), np.float32), np.zeros(count, np.float32),
        np.zeros((size, size, 3), np.float32), np.zeros((size, size, 3), np.float32), np.zeros(count, np.float32),
    )  # fmt: skip
