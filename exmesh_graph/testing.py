"""For the tests of your own nodes and wire types: a context to call a node with, and scenes of a few hundred faces.

The scene is a ball with a UV atlas and a smooth colour pattern, seen by cameras around it; its shape, colours and
depths are known. Everything is deterministic and made in milliseconds, but for `views` and `depth_maps`, which load
torch and Warp and render.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from exmesh_graph.types import Artifact, Asset, Carrier, DepthMaps, Mesh, Stage1State, Views
from exmesh_graph.types.pictures import Pictures


@dataclass
class FakeContext:
    """The context that a node is called with (graph.declare.node.Context), without a run: it keeps what the node says.

        context = FakeContext(scratch=tmp_path)
        out = my_node(context, mesh(), p=MyParams(steps=3))
        assert context.warnings == []

    scratch   where the node may write; outputs of type Files lie there
    resumed   what `resume()` answers: (step, state) of an earlier attempt, or None
    steps     (step, total) of every `progress`;  figures: the last one's
    offered   (step, state) of the last `checkpoint`;  lines, warnings: what was logged and warned
    """

    scratch: Path = Path()
    node: str = "node"
    key: str = "0" * 64
    seed: int = 0
    threads: int = 1
    resumed: tuple[int, dict[str, Any]] | None = None
    steps: list[tuple[int, int]] = field(default_factory=list)
    figures: dict[str, float] = field(default_factory=dict)
    offered: tuple[int, Mapping[str, Any]] | None = None
    lines: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def progress(self, step: int, total: int, **figures: float) -> None:
        self.steps.append((step, total))
        self.figures = figures

    def checkpoint(self, step: int, state: Mapping[str, Any]) -> None:
        self.offered = step, state

    def resume(self) -> tuple[int, dict[str, Any]] | None:
        return self.resumed

    def log(self, message: str) -> None:
        self.lines.append(message)

    def warn(self, message: str) -> None:
        self.warnings.append(message)


def mesh(levels: int = 2, radius: float = 0.6) -> Mesh:
    """A closed ball of 20 * 4**levels even faces."""
    from exmesh_graph.geometry.shapes import icosphere

    return Mesh(*icosphere(levels, radius))


def carrier(radius: float = 0.6, *, rings: int = 10, sectors: int = 16, texels: int = 32) -> Carrier:
    """A closed ball with one chart, which is cut along a meridian, and `pattern(texels)` as its texture."""
    return Carrier(*latlong_ball(rings, sectors, radius), pattern(texels))


def state(start: Carrier | None = None, fill: float | None = None) -> Stage1State:
    """Stage I before its first step: zero moments. `fill`: this value all over in place of the texture."""
    on = start or carrier()
    count, texture = len(on.vertices), on.texture if fill is None else np.full_like(on.texture, fill)
    return Stage1State(
        on.vertices, on.faces, on.uvs, on.uv_faces, texture,
        np.zeros((count, 3), np.float32), np.zeros(count, np.float32),
        np.zeros_like(texture), np.zeros_like(texture), np.zeros(count, np.float32),
    )  # fmt: skip


def asset(start: Carrier | None = None, *, roughness: float = 0.5, **maps: np.ndarray) -> Asset:
    """A finished asset: the carrier's colours as base colour, one roughness, all texels seen, under `sky()`.

    maps  other fields of Asset, in place of these or beside them: `metallic`, `normal`, `environment`, ...
    """
    from exmesh_graph.io.color import srgb_to_linear

    on = start or carrier()
    size = on.texture.shape[:2]
    values: dict[str, Any] = {
        **{f.name: getattr(on, f.name) for f in fields(Carrier)},
        "base_color": srgb_to_linear(on.texture),
        "roughness": np.full(size, roughness, np.float32),
        "seen": np.ones(size, bool),
        "environment": sky(),
    }
    return Asset(**{**values, **maps})


def views(of: Carrier | None = None, count: int = 8, size: int = 48, *, split: str = "train") -> Views:
    """Square photographs with masks from `cameras`, linear and premultiplied: an Asset under its light, else the
    texture as it is.
    """
    of = of or carrier()
    intrinsics, poses = cameras(count, size)
    names = tuple(f"v{i}" for i in range(count))
    blank = np.zeros((count, size, size), np.float32)
    if isinstance(of, Asset):
        from exmesh_graph.stage2.render import render_transport, render_views

        light = render_transport(of, 1, directions=64, points=400)
        shown = render_views(of, intrinsics, poses, size, size, transport=light, specular_samples=4)
        return Views(names, shown.images, shown.alpha, intrinsics, poses, split, clipped=False)
    from exmesh_graph.io.color import srgb_to_linear
    from exmesh_graph.stage1.render import render_carrier

    colours, alpha = render_carrier(
        of, Views(names, np.repeat(blank[..., None], 3, -1), blank, intrinsics, poses, split)
    )
    straight = np.clip(colours / np.maximum(alpha, 1e-6)[..., None], 0, 1)
    return Views(
        names, (srgb_to_linear(straight) * alpha[..., None]).astype(np.float32), alpha, intrinsics, poses, split
    )


def depth_maps(of: Mesh, seen_by: Views) -> DepthMaps:
    """The mesh's true depth at the pixel centres of the views, 0 beside it."""
    import torch

    from exmesh_graph.raster import rasterize

    vertices, faces = torch.from_numpy(of.vertices), torch.from_numpy(of.faces)
    cameras = torch.from_numpy(seen_by.intrinsics), torch.from_numpy(seen_by.world_to_camera)
    return DepthMaps(seen_by.names, rasterize(vertices, faces, *cameras, seen_by.height, seen_by.width).depth.numpy())


def cameras(count: int = 8, size: int = 48, distance: float = 2.5) -> tuple[np.ndarray, np.ndarray]:
    """Cameras around the Y axis, some from above and below, principal points off centre: intrinsics [N, 3, 3],
    camera_to_world [N, 4, 4].
    """
    poses = []
    for i in range(count):
        angle, height = 2 * math.pi * i / count, 0.5 * math.sin(2.4 * i)
        eye = np.array([math.sin(angle), height, math.cos(angle)])
        poses.append(look_at(distance * eye / np.linalg.norm(eye)))
    intrinsics = np.array([[1.6 * size, 0, size / 2 + 1.5], [0, 1.6 * size, size / 2 - 1], [0, 0, 1]])
    return np.repeat(intrinsics[None], count, 0), np.stack(poses)


def look_at(eye: Sequence[float] | np.ndarray) -> np.ndarray:
    """Camera-to-world [4, 4] of an OpenCV camera at `eye` that looks at the origin, level; not from straight above."""
    forward = -np.asarray(eye, float) / np.linalg.norm(eye)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = eye
    return pose


def latlong_ball(
    rings: int = 10, sectors: int = 16, radius: float = 0.6
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A closed ball cut into rings and sectors: vertices [V, 3], faces [F, 3], uvs [T, 2], uv_faces [F, 3]."""
    lat = np.linspace(-math.pi / 2, math.pi / 2, rings + 1)
    lon = np.linspace(-math.pi, math.pi, sectors + 1)
    vertices = [
        [math.cos(a) * math.sin(b), math.sin(a), math.cos(a) * math.cos(b)]
        for k, a in enumerate(lat)
        for b in (lon[:1] if k in (0, rings) else lon[:-1])  # the poles are one vertex each
    ]
    i, j = np.meshgrid(np.arange(rings + 1), np.arange(sectors + 1), indexing="ij")
    index = (1 + (i - 1) * sectors + j % sectors).clip(0, len(vertices) - 1)
    index[0] = 0
    index[-1] = len(vertices) - 1

    def triangles(grid: np.ndarray) -> np.ndarray:
        """Two of each quadrangle of a grid of indices."""
        a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
        return np.stack([a, b, c, a, c, d], -1).reshape(-1, 3)

    faces, uv_faces = triangles(index), triangles(i * (sectors + 1) + j)
    whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    uvs = np.stack([(lon[j] + math.pi) / (2 * math.pi), (lat[i] + math.pi / 2) / math.pi], -1).reshape(-1, 2)
    return (
        radius * np.array(vertices, np.float32),
        faces[whole].astype(np.int32),
        (uvs * 0.9 + 0.05).astype(np.float32),
        uv_faces[whole].astype(np.int32),
    )


def pattern(size: int = 32) -> np.ndarray:
    """Smooth display colours float32 [size, size, 3] in [0.2, 0.8]."""
    v, u = np.meshgrid(np.linspace(0, 1, size), np.linspace(0, 1, size), indexing="ij")
    waves = [np.sin(6 * u + 2 * v), np.cos(5 * v - 1), np.sin(9 * u * v)]
    return (0.5 + 0.3 * np.stack(waves, -1)).astype(np.float32)


def sky(height: int = 8) -> np.ndarray:
    """An uneven light, float32 [H, 2H, 3] in [0.1, 3.5]: brighter above, a warm lamp on one side."""
    light = np.linspace(2.0, 0.1, height)[:, None, None] * np.array([0.6, 0.8, 1.1])
    lamp = np.where(np.arange(2 * height) < 0.3 * 2 * height, 1.5, 0.0)[None, :, None] * np.array([1.0, 0.6, 0.3])
    return np.ascontiguousarray(np.broadcast_to(light + lamp, (height, 2 * height, 3)), np.float32)


def check_codec(value: Artifact, folder: Path) -> None:
    """What the store needs of a wire type: `load(save(x))` equals x bit for bit, and saves to the same bytes again.

    folder  where two copies are written.  Raises AssertionError that names the field or file that differs. Compares the
    fields of a dataclass: arrays by dtype, shape and bytes, folders by their files, the rest by type and value.
    """
    kind, copies = type(value).__name__, [folder / "written", folder / "again"]
    for copy in copies:
        copy.mkdir(parents=True)
    value.save(copies[0])
    back = type(value).load(copies[0])
    back.save(copies[1])
    for f in fields(value):  # type: ignore[arg-type]
        before, after = _plain(getattr(value, f.name)), _plain(getattr(back, f.name))
        assert before == after, f"{kind}.{f.name} changes when it is written and read: {before} becomes {after}"
    assert back.facets() == value.facets(), f"the facets of {kind} change when it is written and read"
    first, second = (_plain(copy) for copy in copies)
    differ = sorted(name for name in {**first, **second} if first.get(name) != second.get(name))
    assert not differ, f"{kind} is written with other bytes the second time: {', '.join(differ)}"


def _plain(value: Any) -> Any:
    """Something that compares bit for bit, and prints short."""
    value = np.asarray(value) if isinstance(value, Pictures) else value
    if isinstance(value, np.ndarray):
        return "array", value.dtype.str, value.shape, hashlib.sha256(value.tobytes()).hexdigest()[:12]
    if isinstance(value, Path):
        files = sorted(path for path in value.rglob("*") if path.is_file())
        return {str(path.relative_to(value)): hashlib.sha256(path.read_bytes()).hexdigest()[:12] for path in files}
    if is_dataclass(value) and not isinstance(value, type):
        return type(value).__name__, {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value).__name__, [_plain(item) for item in value]
    return type(value).__name__, repr(value) if isinstance(value, float) else value
