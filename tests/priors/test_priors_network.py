"""Depth Anything 3: what the network is given and what becomes of its answer, with a stand-in for the package."""

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import torch
from exmesh_nodes import prior
from prior_scenes import wall

from exmesh_graph.errors import DataError, MissingLibraryError, NumericsError
from exmesh_graph.losses import linear_to_srgb
from exmesh_graph.testing import FakeContext


class Network:
    """Answers with the pictures' red channel at half the size, as depth; keeps what it was asked."""

    calls: list = []  # noqa: RUF012
    loaded: list = []  # noqa: RUF012
    factor = 1.0

    @classmethod
    def from_pretrained(cls, name, **options):
        cls.loaded.append((name, options))
        if name == "nobody/nothing":
            raise OSError("nobody/nothing is not a model")
        return cls()

    def to(self, device):
        assert torch.device(device).type == "cpu"
        return self

    def eval(self):
        return self

    def inference(self, image, process_res, extrinsics=None, intrinsics=None):
        self.calls.append((image, process_res, extrinsics, intrinsics))
        return SimpleNamespace(depth=self.factor * np.stack([(1 + i[::2, ::2, 0]).astype(np.float32) for i in image]))


@pytest.fixture
def package(monkeypatch):
    module = ModuleType("depth_anything_3.api")
    module.DepthAnything3 = Network
    monkeypatch.setitem(sys.modules, "depth_anything_3", ModuleType("depth_anything_3"))
    monkeypatch.setitem(sys.modules, "depth_anything_3.api", module)
    monkeypatch.setattr(Network, "calls", [])
    monkeypatch.setattr(Network, "loaded", [])
    return module


@pytest.fixture
def params():
    return prior.DepthAnythingParams(batch=2, resolution=126, device="cpu")


def test_pictures_and_cameras_go_in_and_relative_maps_come_out(package, params):
    views, _ = wall(count=3, size=32)
    context = FakeContext()
    depths = prior.depth_anything(context, views, p=params).depths
    assert depths.units == "relative"
    assert depths.facets()["units"] == "relative"
    assert depths.names == views.names
    assert depths.depth.shape == (3, 32, 32)
    assert Network.loaded == [("depth-anything/DA3-BASE", {})]
    assert [len(call[0]) for call in Network.calls] == [2, 1]
    image, resolution, extrinsics, intrinsics = Network.calls[1]
    assert resolution == 126
    assert image[0].dtype == np.uint8
    shown = linear_to_srgb(torch.from_numpy(views.images[2])).numpy()
    assert np.abs(image[0] / 255 - shown).max() < 0.003
    assert extrinsics[0] == pytest.approx(views.world_to_camera[2], abs=1e-6)
    assert intrinsics[0] == pytest.approx(views.intrinsics[2], abs=1e-4)
    large = (1.0 + image[0][::2, ::2, 0]).repeat(2, 0).repeat(2, 1)
    assert np.array_equal(depths.depth[2], large)
    assert context.steps[-1] == (3, 3)


def test_monocular_models_get_no_cameras_and_weights_may_lie_in_a_folder(package, params, tmp_path):
    views, _ = wall(count=3, size=32)
    p = params.model_copy(update={"cameras": False, "weights": tmp_path})
    with pytest.raises(DataError, match=r"there is no config\.json"):
        prior._weights(p)
    with pytest.raises(DataError, match=r"there is no config\.json"):
        prior.depth_anything(FakeContext(), views, p=p)
    for name in ("config.json", "model.safetensors"):
        (tmp_path / name).write_text("{}")
    assert set(prior._weights(p)) == {"config.json", "model.safetensors"}
    prior.depth_anything(FakeContext(), views, p=p)
    assert Network.loaded == [(str(tmp_path), {})]
    assert Network.calls[0][2:] == (None, None)
    named = params.model_copy(update={"model": "some/model", "revision": "v1"})
    prior.depth_anything(FakeContext(), views, p=named)
    assert Network.loaded[-1] == ("some/model", {"revision": "v1"})


def test_what_is_missing_is_named(package, params, monkeypatch):
    views, _ = wall(count=2, size=32)
    with pytest.raises(DataError, match="nobody/nothing cannot be loaded"):
        prior.depth_anything(FakeContext(), views, p=params.model_copy(update={"model": "nobody/nothing"}))
    monkeypatch.setattr(Network, "factor", np.nan)
    with pytest.raises(NumericsError, match="view 'w0'"):
        prior.depth_anything(FakeContext(), views, p=params)
    monkeypatch.setitem(sys.modules, "depth_anything_3.api", None)
    with pytest.raises(MissingLibraryError, match="depth-anything-3") as caught:
        prior.depth_anything(FakeContext(), views, p=params)
    assert "exmesh-graph[depth]" in str(caught.value)


def test_masked_pixels_get_no_depth(package, params):
    from dataclasses import replace

    views, _ = wall(count=2, size=32)
    alpha = np.ones_like(views.alpha)
    alpha[:, :10] = 0
    masked = replace(views, alpha=alpha, images=views.images * alpha[..., None], has_masks=True)
    depth = prior.depth_anything(FakeContext(), masked, p=params).depths.depth
    assert (depth[:, :10] == 0).all()
    assert (depth[:, 10:] > 0).all()
