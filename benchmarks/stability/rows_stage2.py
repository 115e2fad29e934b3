"""Rows of Stage II: fits of small scenes whose materials and light are known (benchmarks.stability.stage2_scenes)."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import torch

from benchmarks.stability import stage2_scenes as scenes
from benchmarks.stability.table import Reached, row
from exmesh_graph.shading import envmap
from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.init import neutral_asset
from exmesh_graph.stage2.settings import StartSettings
from exmesh_graph.types import Asset, Carrier, Transport, Views

BASE = (0.6, 0.4, 0.25)
QUICK = scenes.SETTINGS.replaced(iterations=120, material_rate=0.4, corrections=2, correction_samples=8)
LONG = scenes.SETTINGS.replaced(iterations=800, material_rate=0.5, rate_decay=0.05, corrections=10, material_weight=0.1)


@cache
def ball() -> tuple[Carrier, Transport]:
    carrier = scenes.sphere()
    return carrier, scenes.transport_of(carrier)


def fitted(views: Views, light: np.ndarray | None = None, **settings: object) -> Asset:
    carrier, transport = ball()
    said: list[str] = []
    start = neutral_asset(carrier, StartSettings(base_color="gray"))
    if light is not None:
        start, settings = replace(start, environment=light), {**settings, "keep_light": True}
    asset, _ = fit(carrier, views, transport, QUICK.replaced(**settings), start=start, warn=said.append)
    assert not said, said
    return asset


@cache
def one_material(roughness: float) -> tuple[float, float]:
    """Worst error of the mean base colour (relative) and of the mean roughness under known light."""
    carrier, transport = ball()
    views = scenes.photographs(carrier, scenes.sky(), scenes.uniform(BASE, roughness))
    start = replace(neutral_asset(carrier, StartSettings(base_color="gray")), environment=scenes.sky())
    asset, _ = fit(carrier, views, transport, LONG.replaced(keep_light=True), start=start)
    base, rough = asset.base_color[asset.seen], asset.roughness[asset.seen]
    return float(np.abs(base.mean(0) / BASE - 1).max()), float(np.abs(np.median(rough) - roughness))


ROUGHNESS = (0.1, 0.2, 0.4, 0.7, 1.0)


@row("stage2", "known light, sphere of one colour, roughness 0.1 to 1", "base colour, relative", high=0.01, slow=True)
def sphere_color() -> Reached:
    return Reached(max(one_material(roughness)[0] for roughness in ROUGHNESS))


@row("stage2", "the same sphere", "error of the median roughness", high=0.02, slow=True)
def sphere_roughness() -> Reached:
    return Reached(max(one_material(roughness)[1] for roughness in ROUGHNESS))


@row("stage2", "known light, sphere of one colour, roughness 0.4", "base colour, relative", high=0.02)
def sphere_quick() -> Reached:
    views = scenes.photographs(ball()[0], scenes.sky(), scenes.uniform(BASE, 0.4), 6)
    base = fitted(views, scenes.sky())
    return Reached(float(np.abs(base.base_color[base.seen].mean(0) / BASE - 1).max()))


@row("stage2", "known light with a sun of 1e5 times the rest, one texel", "base colour, relative", high=0.05)
def small_sun() -> Reached:
    light = np.full((scenes.SKY_ROWS, 2 * scenes.SKY_ROWS, 3), 1.5e-3, np.float32)
    light[4, 20] = 150
    views = scenes.photographs(ball()[0], light, scenes.uniform(BASE, 0.7), 6)
    found = fitted(views, light)
    return Reached(float(np.abs(np.median(found.base_color[found.seen], axis=0) / BASE - 1).max()))


@row("stage2", "black photographs", "brightest texel of the sky", high=0.02)
def black() -> Reached:
    views = scenes.photographs(ball()[0], scenes.sky(), scenes.uniform(BASE, 0.5), 4)
    found = fitted(replace(views, images=np.zeros_like(views.images)))
    assert all(np.isfinite(m).all() for m in (found.base_color, found.roughness))
    return Reached(float(found.environment.max()))


@row("stage2", "8-bit highlights cut off at 1 (a fifth of the pixels)", "base colour, relative", high=0.03)
def saturated() -> Reached:
    light = 1.6 * scenes.sky()
    views = scenes.photographs(ball()[0], light, scenes.uniform((0.7, 0.6, 0.5), 0.35), 6)
    cut = (views.images.max(-1) > 1)[views.alpha > 0].mean()
    assert 0.1 < cut < 0.5, cut
    found = fitted(replace(views, images=views.images.clip(0, 1), clipped=True), light)
    return Reached(float(np.abs(np.median(found.base_color[found.seen], axis=0) / [0.7, 0.6, 0.5] - 1).max()))


def halves() -> tuple[np.ndarray, np.ndarray]:
    """Texels well inside the sphere's halves x > 0 and x < 0."""
    x = scenes.texel_positions(ball()[0])[..., 0]
    return x > 0.3, x < -0.3


@row("stage2", "base colour 1 on one half, 0 on the other", "mean error of base colour", high=0.03)
def white_and_black() -> Reached:
    def paint(position: torch.Tensor) -> scenes.Surface:
        one = torch.ones(len(position))
        return scenes.Surface((position[:, :1] > 0).float().expand(-1, 3), 0.5 * one, 0 * one)

    found = fitted(scenes.photographs(ball()[0], scenes.lamps(), paint), scenes.lamps(), iterations=200, corrections=4)
    white, dark = (found.base_color[part & found.seen] for part in halves())
    return Reached(float(max(np.abs(white - 1).mean(), np.abs(dark).mean())))


@row("stage2", "metal and dielectric side by side, known light", "share of texels on the wrong side of 0.5", high=0.2)
def metal_beside_dielectric() -> Reached:
    def paint(position: torch.Tensor) -> scenes.Surface:
        one = torch.ones(len(position))
        metal = (position[:, 0] > 0).float()
        return scenes.Surface(torch.tensor((0.8, 0.6, 0.3)).expand(len(position), 3), 0.35 * one, metal)

    views = scenes.photographs(ball()[0], scenes.lamps(), paint)
    found = fitted(views, scenes.lamps(), metallic=True, iterations=200, corrections=4)
    assert found.metallic is not None
    metal, other = (found.metallic[part & found.seen] for part in halves())
    return Reached(float(max((metal < 0.5).mean(), (other > 0.5).mean())))


@cache
def one_side() -> tuple[Asset, np.ndarray]:
    views = scenes.photographs(ball()[0], scenes.sky(), scenes.uniform(BASE, 0.5), 4, half=True)
    asset = fitted(views, scenes.sky())
    return asset, scenes.texel_positions(ball()[0])


@row(
    "stage2", "texels that no view sees, behind the sphere", "base colour, relative, mean of the filled ones", high=0.06
)
def unseen_filled() -> Reached:
    asset, position = one_side()
    behind = position[..., 2] < -0.75
    assert not asset.seen[behind].any()
    return Reached(float(np.abs(asset.base_color[behind] / BASE - 1).mean()))


@row("stage2", "the same texels", "largest confidence of an unseen texel over least of a well seen one", high=0.05)
def unseen_flagged() -> Reached:
    asset, position = one_side()
    behind, front = position[..., 2] < -0.75, (position[..., 2] > 0.8) & asset.seen
    return Reached(float(asset.confidence[behind].max() / asset.confidence[front].min()))


@row("stage2", "three of six views with one pixel of the object", "base colour, relative", high=0.03, slow=True)
def one_pixel() -> Reached:
    views = scenes.photographs(ball()[0], scenes.sky(), scenes.uniform(BASE, 0.5), 6)
    alpha = views.alpha.copy()
    alpha[::2] = 0
    alpha[::2, scenes.SIZE // 2, scenes.SIZE // 2] = 1
    found = fitted(replace(views, alpha=alpha, images=views.images * alpha[..., None]), scenes.sky(), ssim_weight=0.1)
    return Reached(float(np.abs(np.median(found.base_color[found.seen], axis=0) / BASE - 1).max()))


@row("stage2", "one view of eight exposed 1.5 times, exposure fitted", "base colour, relative", high=0.02, slow=True)
def wrong_exposure() -> Reached:
    views = scenes.photographs(ball()[0], scenes.sky(), scenes.uniform(BASE, 0.5))
    images = views.images.copy()
    images[3] *= 1.5
    found = fitted(replace(views, images=images), scenes.sky(), exposure=True)
    return Reached(float(np.abs(np.median(found.base_color[found.seen], axis=0) / BASE - 1).max()))


SPOTS = {"front": (0.0, 0.3, 1.0), "seam": (0.0, 0.3, -1.0), "pole": (0.0, 1.0, 0.0)}


@cache
def sky_error(spot: str) -> float:
    """Error of a recovered sky with a bright spot, relative and after the best common factor."""
    light = scenes.sky(SPOTS[spot])
    views = scenes.photographs(ball()[0], light, scenes.uniform((0.5, 0.5, 0.5), 0.3), 8, turn=0.3)
    found = fitted(views).environment
    angle = envmap.solid_angles(*light.shape[:2])[:, None, None]
    factor = (found * light * angle).sum() / (found**2 * angle).sum()
    return float(np.sqrt(((factor * found - light) ** 2 * angle).sum() / (light**2 * angle).sum()))


@row(
    "stage2",
    "brightest part of an unknown sky on the map's seam",
    "error over that at the centre",
    high=1.25,
    slow=True,
)
def seam() -> Reached:
    return Reached(sky_error("seam") / sky_error("front"))


@row("stage2", "brightest part of an unknown sky at the pole", "error over that at the centre", high=1.5)
def pole() -> Reached:
    return Reached(sky_error("pole") / sky_error("front"))
