"""Where the fit starts: base colour from Stage I's texture, the rest neutral (paper, section 5)."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import torch
import torch.nn.functional as F

from exmesh_graph.colour import srgb_to_linear
from exmesh_graph.errors import DataError, GeometryError
from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.stage2.settings import StartSettings
from exmesh_graph.stage2.start_light import KeyLight, white_light, with_key
from exmesh_graph.types import Asset, Carrier

#: The logit's usable range: a texel that starts at exactly 0 or 1 could never leave it. A start that was fitted before
#: is kept as it is but for `NARROW_MARGIN`.
MARGIN, NARROW_MARGIN = 0.02, 1e-3

#: Rows of a starting light with a key light.
FINE_SKY = 64
#: Luminance of linear sRGB (BT.709), and that below which a mean colour is noise.
LUMINANCE, DARKEST = np.array([0.2126, 0.7152, 0.0722]), 1e-4


def resize_texture(texture: np.ndarray, size: int) -> torch.Tensor:
    """`texture` [R, R, C] at size x size texels, float32: area average down, bilinear up."""
    image = tensor_of(np.asarray(texture, np.float32)).permute(2, 0, 1)[None]
    if image.shape[-1] != size or image.shape[-2] != size:
        image = F.interpolate(image, (size, size), mode="bilinear", align_corners=False, antialias=True)
    return image[0].permute(1, 2, 0).contiguous()


def logit(value: torch.Tensor, margin: float = MARGIN) -> torch.Tensor:
    """Inverse of the sigmoid, for values kept `margin` away from its ends."""
    inside = value.clamp(margin, 1 - margin)
    return torch.log(inside / (1 - inside))


def initial_base_color(texture: np.ndarray, size: int, source: str) -> torch.Tensor:
    """Linear base colour [size, size, 3]: the appearance under an environment of radiance 1, or mid-gray."""
    if source == "gray":
        return torch.full((size, size, 3), 0.5)
    return srgb_to_linear(resize_texture(texture, size).clamp(0, 1))


def tint(carrier: Carrier, level: float) -> np.ndarray:
    """One linear colour float32 [3]: the mean of the Stage I texture over its charts, brought to the luminance `level`.

    A sky is white on the whole far more often than an object is gray, so the colour that photographs have on average
    is the object's until they tell otherwise (the gray-world assumption, about light).
    """
    from exmesh_graph.uv.raster import rasterize_atlas

    face, _ = rasterize_atlas(carrier.uvs, carrier.uv_faces, carrier.texture.shape[0])
    shown = carrier.texture[face >= 0] if (face >= 0).any() else carrier.texture.reshape(-1, 3)
    mean = srgb_to_linear(tensor_of(np.asarray(shown, np.float32)).clamp(0, 1)).double().mean(dim=0).numpy()
    luminance = float(mean @ LUMINANCE)
    if luminance < DARKEST:  # black pictures have no colour
        return np.full(3, level, np.float32)
    return (mean * (level / luminance)).astype(np.float32)


def neutral_asset(
    carrier: Carrier,
    settings: StartSettings | None = None,
    size: int = 0,
    key: KeyLight | None = None,
    axis: np.ndarray | None = None,
) -> Asset:
    """Where a fit starts that knows no better: one roughness, one metallic, white light (`white_light`).

    Base colour is kept `MARGIN` away from 0 and 1, metallic `MARGIN` below 1; metallic 0 is no map.
    size  side of the maps in texels; 0: the texture's
    key   shines beside the white light
    axis  what the light turns about with the camera (types.Asset.light_axis)
    """
    settings = settings or StartSettings()
    size, metallic = size or carrier.texture.shape[0], settings.metallic
    if settings.base_color == "tint":
        color = torch.from_numpy(tint(carrier, settings.level)).expand(size, size, 3).clone()
    else:
        color = initial_base_color(carrier.texture, size, settings.base_color)
    color = color.clamp(MARGIN, 1 - MARGIN)
    light = white_light(settings.above) if key is None else with_key(white_light(settings.above, FINE_SKY), key)
    return Asset(
        **{field.name: getattr(carrier, field.name) for field in fields(Carrier)},
        base_color=color.numpy(),
        roughness=np.full((size, size), settings.roughness, np.float32),
        seen=np.zeros((size, size), bool),
        environment=light,
        metallic=np.full((size, size), min(metallic, 1 - MARGIN), np.float32) if metallic > 0 else None,
        light_axis=axis,
    )


def check_start(start: Asset, carrier: Carrier, metallic: bool, normal_map: bool) -> None:
    """Raises GeometryError where `start` has another atlas, DataError where it has a map that the fit would drop."""
    same = np.array_equal(start.faces, carrier.faces) and np.array_equal(start.uv_faces, carrier.uv_faces)
    if not (same and start.uvs.shape == carrier.uvs.shape and np.allclose(start.uvs, carrier.uvs, atol=1e-5)):
        raise GeometryError(
            "the asset that the fit is to start from has another mesh or atlas than the carrier",
            expected="one carrier for both",
            fix="wire the same output into stage2.init's and stage2.fit's `carrier`, or leave `start` unwired",
        )
    if not metallic and start.metallic is not None and bool((start.metallic > 0).any()):
        raise DataError(
            "the asset that the fit is to start from is metallic, which the fit leaves out",
            fix="set metallic: true in stage2.fit",
        )
    if not normal_map and start.normal is not None and bool((start.normal[..., 2] < 1 - 1e-6).any()):
        raise DataError(
            "the asset that the fit is to start from has a normal map, which the fit leaves out",
            fix="set normal_map: true in stage2.fit",
        )
