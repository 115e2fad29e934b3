"""Values that a wire type refuses when it is made: which field, what it is, what was expected."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest

from exmesh_graph import testing
from exmesh_graph.errors import DataError
from exmesh_graph.types import (
    ArrayArtifact,
    Artifact,
    DepthMaps,
    EnvMap,
    Frame,
    LitViews,
    PlanarGaussians,
    PointCloud,
    Region,
    SceneTruth,
    Transport,
    Views,
)

F32 = np.float32


def views(count: int = 2) -> Views:
    poses = np.repeat(np.eye(4)[None], count, axis=0)
    return Views(
        names=tuple(f"view {i}" for i in range(count)),
        images=np.zeros((count, 4, 6, 3), F32),
        alpha=np.ones((count, 4, 6), F32),
        intrinsics=poses[:, :3, :3].copy(),
        camera_to_world=poses,
        split="train",
    )


def transport() -> Transport:
    return Transport(
        directions=np.zeros((8, 3), F32), steps=np.ones(4, np.int32), face_points=np.zeros(12, np.int32),
        points=np.zeros((4, 3), F32), normals=np.zeros((4, 3), F32),
        point_face=np.zeros(4, np.int32), point_bary=np.zeros((4, 3), F32),
        visible=np.zeros((4, 1), np.uint8), hit_point=np.zeros(5, np.int32), hit_direction=np.zeros(5, np.uint16),
        hit_face=np.zeros(5, np.int32), hit_bary=np.zeros((5, 2), F32),
    )  # fmt: skip


def gaussians() -> PlanarGaussians:
    zeros = np.zeros
    return PlanarGaussians(
        zeros((3, 3), F32), zeros((3, 3), F32), zeros((3, 4), F32), zeros(3, F32), zeros((3, 1, 3), F32)
    )


MESH, CARRIER, STATE, ASSET = testing.mesh(1), testing.carrier(), testing.state(), testing.asset()
LIT = LitViews(**vars(views()), environments=np.ones((2, 2, 4, 3), F32))

REGION = Region(("a",), np.ones((1, 4, 6), bool), np.zeros((1, 4, 6), F32), np.ones((1, 4, 6), F32))

REFUSED: list[tuple[Artifact, dict[str, Any], str]] = [
    (MESH, {"vertices": MESH.vertices.astype(float)}, r"Mesh\.vertices: is float64 \[42, 3\]"),
    (MESH, {"vertices": MESH.vertices[:, :2]}, r"Mesh\.vertices: is float32 \[42, 2\]\n  expected: float32 \[V, 3\]"),
    (
        MESH,
        {"faces": MESH.faces.astype(np.int64)},
        r"Mesh\.faces: is int64 .*\n.*\n  fix: np\.asarray\(faces, ",
    ),
    (MESH, {"faces": MESH.faces.tolist()}, r"Mesh\.faces: is a list"),
    (MESH, {"faces": MESH.faces + 1}, r"faces\[\d+, \d\] = 42 points outside the 42 vertices\n  expected: .* 0 to 41"),
    (MESH, {"faces": MESH.faces - 1}, r"faces\[\d+, \d\] = -1 points outside the 42 vertices"),
    (CARRIER, {"uv_faces": CARRIER.uv_faces[1:]}, r"Carrier\.uv_faces: .*\n.*F = \d+ as in faces$"),
    (CARRIER, {"uvs": CARRIER.uvs[:-1]}, r"Carrier\.uv_faces: uv_faces\[\d+, \d\] = \d+ points outside the \d+ uvs"),
    (CARRIER, {"texture": CARRIER.texture[:-1]}, r"Carrier\.texture: is float32 \[31, 32, 3\]"),
    (STATE, {"vertex_m": STATE.vertex_m[1:]}, r"Stage1State\.vertex_m: .*\n.*V = \d+ as in vertices"),
    (STATE, {"gradient_ema": STATE.gradient_ema[:, None]}, r"Stage1State\.gradient_ema"),
    (STATE, {"texture_v": STATE.texture_v[::2, ::2]}, r"Stage1State\.texture_v: .*\n.*R = 32 as in texture"),
    (ASSET, {"roughness": ASSET.roughness[..., None]}, r"Asset\.roughness"),
    (ASSET, {"seen": ASSET.seen.astype(F32)}, r"Asset\.seen: is float32"),
    (ASSET, {"normal": np.zeros((2, 2, 3), F32)}, r"Asset\.normal: .*\n.*as in base_color"),
    (ASSET, {"environment": np.zeros((4, 8), F32)}, r"Asset\.environment: is float32 \[4, 8\]"),
    (EnvMap(np.zeros((4, 8, 3), F32)), {"radiance": np.zeros((4, 8, 4), F32)}, r"EnvMap\.radiance"),
    (views(), {"images": views().images[..., :1]}, r"Views\.images"),
    (views(), {"images": np.zeros((2, 4, 6, 3), np.uint8)}, r"Views\.images: is uint8"),
    (views(), {"alpha": views(3).alpha}, r"Views\.alpha: .*\n.*N = 2 as in images"),
    (views(), {"intrinsics": views().intrinsics.astype(F32)}, r"Views\.intrinsics: is float32"),
    (views(), {"names": ("a",)}, r"Views\.names: holds 1 names"),
    (
        LitViews(**vars(views()), environments=np.ones((2, 2, 4, 3), F32)),
        {"environments": None},
        r"environments: is None",
    ),
    (DepthMaps(("a",), np.zeros((1, 4, 6), F32)), {"depth": np.zeros((4, 6), F32)}, r"DepthMaps\.depth"),
    (DepthMaps(("a",), np.zeros((1, 4, 6), F32)), {"names": ("a", "b")}, r"DepthMaps\.names"),
    (REGION, {"near": np.zeros((2, 4, 6), F32)}, r"Region\.near: .*\n.*N = 1 as in inside"),
    (REGION, {"names": ("a", "b")}, r"Region\.names: holds 2 names"),
    (Frame(np.eye(4), np.eye(4)), {"dataset_from_scene": np.eye(3)}, r"Frame\.dataset_from_scene: is float64 \[3, 3\]"),
    (SceneTruth(("a",)), {"albedo": np.zeros((4, 4, 3), F32)}, r"SceneTruth\.albedo"),
    (gaussians(), {"rotations": np.zeros((3, 3), F32)}, r"PlanarGaussians\.rotations"),
    (
        PointCloud(np.zeros((2, 3), F32), np.zeros((2, 3), F32)),
        {"colours": np.zeros((3, 3), F32)},
        r"PointCloud\.colours",
    ),
    (transport(), {"hit_direction": np.zeros(5, np.int32)}, r"Transport\.hit_direction: is int32"),
    (transport(), {"point_bary": np.zeros((3, 3), F32)}, r"Transport\.point_bary: .*\n.*P = 4 as in points"),
]


@pytest.mark.parametrize(("value", "changes", "message"), REFUSED, ids=lambda v: "" if isinstance(v, str) else None)
def test_a_wrong_array_is_named_when_the_value_is_made(value, changes, message):
    with pytest.raises(DataError, match=message):
        replace(value, **changes)


def test_a_tensor_is_told_from_an_array():
    torch = pytest.importorskip("torch")
    with pytest.raises(DataError, match=r"Mesh\.vertices: is a torch tensor, float32 \[42, 3\]"):
        replace(MESH, vertices=torch.from_numpy(MESH.vertices))


@dataclass(frozen=True, eq=False)
class Strokes(ArrayArtifact):
    type_name: ClassVar[str] = "Strokes"
    layout: ClassVar[dict[str, str]] = {"points": "float32 P 3", "widths": "float32? P|1"}
    points: np.ndarray
    widths: np.ndarray | None = None


def test_letters_are_shared_lengths_and_a_field_may_have_several_shapes(tmp_path):
    points = np.zeros((4, 3), F32)
    for widths in (None, np.ones(4, F32), np.ones(1, F32)):
        testing.check_codec(Strokes(points, widths), tmp_path / str(None if widths is None else len(widths)))
    with pytest.raises(DataError, match=r"Strokes\.widths: .*\n.*\[P\] or \[1\], P = 4 as in points"):
        Strokes(points, np.ones(3, F32))
