"""Every wire type comes back from disk bit for bit, and equal values give equal bytes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from exmesh_graph import types
from exmesh_graph.testing import check_codec
from exmesh_graph.types import (
    Artifact,
    Asset,
    Carrier,
    Decision,
    DepthMaps,
    EnvMap,
    Frame,
    Gallery,
    Mesh,
    Metrics,
    PlanarGaussians,
    PointCloud,
    Region,
    SceneNeeds,
    SceneTruth,
    ScoredViews,
    Stage1State,
    UsdAsset,
    Views,
)


def _examples(folder: Path) -> list[Artifact]:
    rng = np.random.default_rng(1)

    def noise(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape).astype(np.float32)

    tetrahedron = {
        "vertices": np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, -0.0]], np.float32),
        "faces": np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.int32),
    }
    atlas = {
        "uvs": noise(12, 2),
        "uv_faces": np.arange(12, dtype=np.int32).reshape(4, 3),
        "texture": noise(8, 8, 3),
    }
    moments = {
        "vertex_m": noise(4, 3),
        "vertex_v": noise(4),
        "texture_m": noise(8, 8, 3),
        "texture_v": noise(8, 8, 3),
        "gradient_ema": noise(4),
    }
    (folder / "pictures").mkdir(parents=True)
    (folder / "pictures" / "a.png").write_bytes(b"\x89PNG\x00")
    return [
        PlanarGaussians(noise(3, 3), noise(3, 3), noise(3, 4), noise(3), noise(3, 4, 3)),
        PointCloud(noise(5, 3), noise(5, 3)),
        SceneNeeds(
            {
                "bounces": Decision(2, 0.31, 0.04, 1.2, "It pays.", {"concavity": 0.2}),
                "metallic": Decision(False, None, None, 1.0, "Nothing to see."),
            },
            {"occluded": 0.25},
        ),
        Views(
            names=("a", "b"),
            images=noise(2, 4, 6, 3),
            alpha=noise(2, 4, 6),
            intrinsics=rng.standard_normal((2, 3, 3)),
            camera_to_world=rng.standard_normal((2, 4, 4)),
            split="train",
            has_masks=False,
        ),
        Frame(rng.standard_normal((4, 4)), rng.standard_normal((4, 4)), 0.1),
        ScoredViews(
            ({"kind": "held_out", "name": "a", "number": 0, "figures": {"psnr": 31.5}},),
            noise(1, 2, 4, 6, 3).astype(np.float16),
            "a",
            rng.standard_normal((3, 3)),
            rng.standard_normal((4, 4)),
        ),
        ScoredViews(
            ({"kind": "held_out", "name": "a", "number": 0, "figures": {"psnr": 31.5}},),
            noise(1, 2, 4, 6, 3).astype(np.float16),
            "a",
            rng.standard_normal((3, 3)),
            rng.standard_normal((4, 4)),
            rng.integers(0, 4, (1, 4, 6)).astype(np.uint8),
        ),
        DepthMaps(("a",), noise(1, 4, 6)),
        Region(("a",), noise(1, 4, 6) > 0, noise(1, 4, 6), noise(1, 4, 6), "masks"),
        SceneTruth(names=("t",)),
        SceneTruth(
            names=("t",),
            mesh_vertices=noise(4, 3),
            mesh_faces=tetrahedron["faces"],
            albedo=noise(1, 4, 6, 3),
            relit={"sky": (noise(4, 8, 3), noise(1, 4, 6, 3)), "a/b": (noise(4, 8, 3), noise(1, 4, 6, 3))},
            relit_alpha={"sky": noise(1, 4, 6), "a/b": noise(1, 4, 6)},
        ),
        Mesh(**tetrahedron),
        Carrier(**tetrahedron, **atlas),
        Stage1State(**tetrahedron, **atlas, **moments, iteration=7, vertex_steps=3),
        Stage1State(
            **tetrahedron, **atlas, **moments, appearance="per_face", model={"values": np.ones((4, 3), np.float32)}
        ),
        EnvMap(noise(4, 8, 3)),
        Asset(
            **tetrahedron,
            **atlas,
            base_color=noise(8, 8, 3),
            roughness=noise(8, 8),
            seen=rng.random((8, 8)) > 0.5,
            environment=noise(4, 8, 3),
        ),
        Metrics({"psnr": 31.25, "views": {"a": [1, 2.5]}, "closed": True}),
        Gallery(folder / "pictures", "a.png"),
        UsdAsset(folder / "pictures", "a.png", up="z"),
    ]


def _bytes_of(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_every_example_is_exact_and_bytes_are_stable(tmp_path: Path) -> None:
    pairs = zip(_examples(tmp_path / "source"), _examples(tmp_path / "source2"), strict=True)
    for index, (value, again) in enumerate(pairs):
        check_codec(value, tmp_path / str(index))
        other = tmp_path / f"{index}_again"
        other.mkdir()
        again.save(other)
        assert _bytes_of(tmp_path / str(index) / "written") == _bytes_of(other), type(value).__name__


def test_every_exported_type_has_its_own_name() -> None:
    exported = [getattr(types, name) for name in types.__all__]
    wire_types = [t for t in exported if isinstance(t, type) and issubclass(t, Artifact)]
    names = [t.type_name for t in wire_types]
    assert len(set(names)) == len(names)


def test_metrics_refuse_nan(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="Out of range float"):
        Metrics({"psnr": float("nan")}).save(tmp_path)
