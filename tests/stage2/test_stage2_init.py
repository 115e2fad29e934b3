"""Where fits start: neutral assets, assets of earlier fits, and those that do not fit."""

import dataclasses

import numpy as np
import pytest
import torch
from exmesh_nodes import stage2
from pydantic import ValidationError

from exmesh_graph.errors import DataError, GeometryError
from exmesh_graph.shading import envmap
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.init import neutral_asset
from exmesh_graph.stage2.settings import DecompositionSettings, StartSettings
from exmesh_graph.testing import FakeContext
from exmesh_graph.uv.raster import rasterize_atlas

SHORT = DecompositionSettings(
    texture_size=48, environment_height=16, iterations=40, material_rate=0.1, environment_rate=0.3, factor_rate=0.06,
    ssim_weight=0.0, material_weight=0.003, environment_weight=0.001, chroma_weight=0.0, indirect_ramp=0,
    corrections=1, correction_samples=4,
)  # fmt: skip


def test_the_node_starts_from_the_texture_or_from_gray(carrier):
    texture = np.random.default_rng(0).uniform(0, 1, (16, 16, 3)).astype(np.float32)
    textured = dataclasses.replace(carrier, texture=texture)
    ctx = FakeContext(node="neutral")
    asset = stage2.init(ctx, textured, p=StartSettings(roughness=0.4)).asset
    linear = np.where(texture <= 0.04045, texture / 12.92, ((texture + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(asset.base_color, linear.clip(0.02, 0.98), rtol=1e-4)
    assert np.unique(asset.roughness).tolist() == [np.float32(0.4)]
    assert asset.metallic is None
    assert not asset.seen.any()
    assert np.unique(asset.environment).tolist() == [1]
    gray = stage2.init(ctx, textured, p=StartSettings(base_color="gray", metallic=0.3)).asset
    assert np.unique(gray.base_color).tolist() == [0.5]
    assert np.unique(gray.metallic).tolist() == [np.float32(0.3)]
    with pytest.raises(ValidationError):
        StartSettings(base_color="blue")


def test_a_tinted_start_has_the_textures_mean_colour_at_the_level_asked_for(carrier):
    texture = np.zeros((32, 32, 3), np.float32)
    face, _ = rasterize_atlas(carrier.uvs, carrier.uv_faces, 32)
    texture[face >= 0] = 0.735, 0.5, 0.25
    texture[face < 0] = 0, 0, 1  # between the charts: nothing that the object shows
    found = neutral_asset(dataclasses.replace(carrier, texture=texture), StartSettings(base_color="tint", level=0.3))
    color = found.base_color.reshape(-1, 3)
    assert (color == color[0]).all()
    assert color[0] @ np.array([0.2126, 0.7152, 0.0722]) == pytest.approx(0.3, rel=1e-5)
    linear = ((np.array([0.735, 0.5, 0.25]) + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(color[0] / color[0][1], linear / linear[1], rtol=1e-4)
    black = dataclasses.replace(carrier, texture=np.zeros_like(texture))
    assert np.unique(neutral_asset(black, StartSettings(base_color="tint")).base_color) == pytest.approx(0.36)


def test_an_unwired_start_is_the_nodes_default(carrier, train_views, transport):
    ctx = FakeContext(node="neutral")
    start = stage2.init(ctx, carrier, p=StartSettings()).asset
    settings = SHORT.replaced(iterations=4)
    (wired, _), (bare, _) = (fit(carrier, train_views, transport, settings, start=s) for s in (start, None))
    for name in ("base_color", "roughness", "environment"):
        assert getattr(wired, name).tobytes() == getattr(bare, name).tobytes()


@pytest.mark.thorough
def test_a_fit_goes_on_from_an_earlier_one(carrier, train_views, transport):
    """Maps and light are taken over as they are; the first step is as good as the last was."""
    first, curves = fit(carrier, train_views, transport, SHORT, seed=1)
    model = Decomposition(carrier, train_views, transport, SHORT, "cpu", start=first)
    values, rows = model.maps.values().detach(), model.maps.texels
    inside = torch.from_numpy(first.seen.reshape(-1))[rows]
    for name, columns in (("base_color", values[:, :3]), ("roughness", values[:, 3:4])):
        kept = torch.from_numpy(getattr(first, name)).reshape(48 * 48, -1)[rows]
        torch.testing.assert_close(columns[inside], kept[inside], atol=2e-3, rtol=0)
    torch.testing.assert_close(
        envmap.radiance_of(model.environment.detach()), torch.from_numpy(first.environment), atol=2e-4, rtol=1e-3
    )
    again, more = fit(carrier, train_views, transport, SHORT, seed=1, start=first)
    assert max(more["image"]) < 0.5 * curves["image"][0]
    assert more["image"][-1] < 1.1 * curves["image"][-1]
    assert not np.array_equal(again.base_color, first.base_color)


def test_starts_that_do_not_fit_are_refused(carrier, train_views, transport):
    other = dataclasses.replace(neutral_asset(carrier), uvs=carrier.uvs[:, ::-1].copy())
    with pytest.raises(GeometryError, match="another mesh or atlas"):
        fit(carrier, train_views, transport, SHORT, start=other)
    metal = neutral_asset(carrier, StartSettings(metallic=0.5))
    with pytest.raises(DataError, match="metallic"):
        fit(carrier, train_views, transport, SHORT, start=metal)
    model = Decomposition(carrier, train_views, transport, SHORT.replaced(metallic=True), "cpu", start=metal)
    torch.testing.assert_close(model.maps.values()[:, 4].detach(), torch.full((len(model.maps.texels),), 0.5))
    pure = neutral_asset(carrier, StartSettings(metallic=1.0))
    assert float(pure.metallic.max()) < 0.99  # a texel at 1 could never leave it


@pytest.mark.parametrize("fitted", [0.004, 0.996])
def test_a_fitted_metallic_is_kept(carrier, train_views, transport, fitted):
    neutral = neutral_asset(carrier)
    start = dataclasses.replace(neutral, metallic=np.full_like(neutral.roughness, fitted))
    model = Decomposition(carrier, train_views, transport, SHORT.replaced(metallic=True), "cpu", start=start)
    torch.testing.assert_close(model.maps.values()[:, 4].detach(), torch.full((len(model.maps.texels),), fitted))
