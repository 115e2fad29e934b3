"""A tiny scene whose truth is known because it was rendered from the asset itself."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from exmesh_graph.testing import FakeContext, look_at
from exmesh_graph.types import Asset, SceneTruth, Views

SIZE = 40


@pytest.fixture
def context(tmp_path):
    return FakeContext(tmp_path)


@pytest.fixture(scope="session", autouse=True)
def few_lattice_points():
    """The scene is small and smooth: trace the light at few points, on one thread."""
    import torch

    from exmesh_graph.stage2 import render

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(render, "RENDER_POINTS", 400)
        yield
    torch.set_num_threads(threads)


@dataclass(frozen=True)
class Scene:
    asset: Asset
    test: Views
    train: Views
    truth: SceneTruth


@pytest.fixture(scope="session")
def scene(few_lattice_points):
    """An octahedron under a coloured sky: three 40 x 40 test views, one relighting environment."""
    from exmesh_graph.stage2.render import render_transport, render_views

    asset = _asset()
    intrinsics = np.tile(np.array([[60.0, 0, SIZE / 2], [0, 60.0, SIZE / 2], [0, 0, 1]]), (3, 1, 1))
    cameras = np.stack([look_at(2.6 * np.array(p)) for p in ([0, 0.3, 0.95], [0.8, 0.4, -0.4], [-0.7, -0.2, 0.6])])
    transport = render_transport(asset, 1, 64)
    other = np.roll(asset.environment, 6, axis=1)[..., ::-1].copy()

    def render(environment, seed):
        return render_views(
            asset, intrinsics, cameras, SIZE, SIZE, environment=environment, transport=transport, seed=seed
        )

    seen, relit = render(asset.environment, 5), render(other, 6)
    names = ("test_a", "test_b", "test_c")
    test = Views(names, seen.images, seen.alpha, intrinsics, cameras, "test", clipped=False)
    truth = SceneTruth(
        names,
        asset.vertices,
        asset.faces,
        seen.albedo,
        seen.roughness,
        asset.environment,
        {"other": (other, relit.images)},
        {"other": relit.alpha},
    )
    return Scene(asset, test, replace(test, split="train"), truth)


def _asset():
    rng = np.random.default_rng(3)
    vertices = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float32) * 0.9
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]], np.int32)
    corner = np.array([[0.1, 0.1], [0.9, 0.1], [0.1, 0.9]])
    uvs = np.concatenate([corner * [0.25, 0.5] + [(k % 4) / 4, (k // 4) / 2] for k in range(8)])
    blocks = np.kron(rng.uniform(0.05, 0.45, (8, 8, 3)), np.ones((4, 4, 1))).astype(np.float32)
    sky = np.linspace(2.0, 0.1, 8)[:, None, None] * np.array([0.6, 0.8, 1.1])
    sky = sky + np.where(np.arange(16) < 5, 1.5, 0.0)[None, :, None] * np.array([1.0, 0.6, 0.3])
    return Asset(
        vertices=vertices,
        faces=faces,
        uvs=uvs.astype(np.float32),
        uv_faces=np.arange(24, dtype=np.int32).reshape(8, 3),
        texture=np.full((32, 32, 3), 0.5, np.float32),
        base_color=blocks,
        roughness=np.kron(rng.uniform(0.2, 0.9, (8, 8)), np.ones((4, 4))).astype(np.float32),
        seen=np.ones((32, 32), bool),
        environment=np.broadcast_to(sky, (8, 16, 3)).astype(np.float32).copy(),
    )
