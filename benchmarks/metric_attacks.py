"""Attacks on the scores: what deleted faces, a sheet behind the object, a swollen mesh do to every headline figure.

    python -m benchmarks.metric_attacks              # the sample, with all masks, none, those of training
    python -m benchmarks.metric_attacks SCENE        # another folder in a known layout: the poor asset alone
    python -m benchmarks.metric_attacks SCENE --run RUN   # what a finished run holds at `settle.state`, `pbr.asset`
    python -m benchmarks.metric_attacks --quick      # two views, few attacks

Faces go at random (several seeds) and in clusters, 5 to 95 %; and those go that an adversary who knows the held-out
photographs would pick, where black is nearer to the photograph than they are. A sheet is a floor or a wall of the
photographs' mean colour, below or behind the object, a roof that no held-out view sees, and a floor of small faces at
the object's feet; beside the whole mesh and beside what deletion left of it.
Swelling and shrinking by 1 and 3 % of the radius count for the true asset: a poor one may well get better by them.
Every figure that gets better by 1e-4 is named, and the exit status is then 1. Chamfer may move by 1 %, which is its
sampling.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.blender import true_asset
from benchmarks.coarse_work import fused, hull, load_scene
from exmesh_graph.evaluate.asset import score_asset
from exmesh_graph.evaluate.carrier import score_carrier
from exmesh_graph.evaluate.mesh import score_mesh
from exmesh_graph.evaluate.region import find_region
from exmesh_graph.evaluate.scores import add_lpips
from exmesh_graph.evaluate.settings import Quality, RegionSettings
from exmesh_graph.geometry.adjacency import angle_weighted_normals
from exmesh_graph.geometry.clean import clean_mesh
from exmesh_graph.geometry.settings import CleanSettings
from exmesh_graph.io.color import srgb_to_linear
from exmesh_graph.raster import rasterize
from exmesh_graph.stage1.init import initial_state
from exmesh_graph.stage1.render import render_carrier
from exmesh_graph.stage2 import render
from exmesh_graph.stage2.init import neutral_asset
from exmesh_graph.types import Asset, Carrier, Region, SceneTruth, Views
from exmesh_graph.uv.unwrap import unwrap

SAMPLE = Path(__file__).parents[1] / "graphs" / "samples" / "spot"
SHARES = (0.05, 0.1, 0.25, 0.5, 0.75, 0.95)
NOISE = {"Chamfer": 0.01}
LEAST = 1e-4  # dB or SSIM that count as a gain: light is sampled on the surface, at points that move when faces go
Figures = dict[str, tuple[float, str]]


@dataclass(frozen=True)
class Setting:
    """Views to score on: with masks, or with the region that stands for them."""

    name: str
    test: Views
    truth: SceneTruth | None
    region: Region | None
    quality: Quality
    views: int
    samples: int = 20_000
    lpips: Path | None = None


@dataclass(frozen=True)
class Attack:
    """An attacked asset; `base` names the attack that it is compared with, "" for none; `counts`: a gain is a fault."""

    name: str
    asset: Asset
    base: str = ""
    counts: bool = True


def figures(asset: Asset, setting: Setting) -> Figures:
    """Every figure of a headline that has a better direction, and SSIM: label -> (value, "higher" or "lower")."""
    texture = score_carrier(asset, setting.test, max_views=setting.views, region=setting.region).values
    scored = score_asset(asset, setting.test, setting.truth, max_views=setting.views, quality=setting.quality,
                         region=setting.region)  # fmt: skip
    light = scored.values
    add_lpips(light, setting.lpips, scored.held_out, scored.relit)
    found: Figures = {"SSIM, Stage I": (texture["held_out"]["ssim"], "higher")}
    found["SSIM"] = (light["held_out"]["ssim"], "higher")
    if "relit" in light:
        found["Relit SSIM"] = (light["relit"]["ssim"], "higher")
    rows = [*texture["headline"], *light["headline"]]
    if setting.truth is not None:
        rows += score_mesh(asset, setting.truth, samples=setting.samples)["headline"]
    return found | {row["label"]: (row["value"], row["better"]) for row in rows if row.get("better")}


def gains(before: Figures, after: Figures) -> dict[str, float]:
    """Figures that got better, beyond their own noise, and by how much."""
    better = {}
    for label, (value, direction) in after.items():
        gain = (value - before[label][0]) * (1 if direction == "higher" else -1)
        if gain > LEAST + NOISE.get(label, 0) * abs(before[label][0]):
            better[label] = gain
    return better


def attacks(asset: Asset, setting: Setting, exact: bool, quick: bool = False) -> Iterator[Attack]:
    """All attacks on an asset."""
    for share in (0.05, 0.5, 0.95) if quick else SHARES:
        for seed in range(1 if quick else 3):
            yield Attack(f"random {share:.0%}, seed {seed}", without(asset, _random(asset, share, seed)))
        for seed in range(1 if quick else 2):
            yield Attack(f"clustered {share:.0%}, seed {seed}", without(asset, _clustered(asset, share, seed)))
    yield Attack(
        "picked by the photographs", without(asset, _picked(asset, setting)), counts=setting.region is not None
    )
    half = "random 50%, seed 0"
    holed = without(asset, _random(asset, 0.5, 0))
    for name, sheet in sheets(asset, setting.test).items():
        # without masks nothing in the photographs refutes a floor right below the object: it may well be its table
        counts = setting.region is None or name != "floor at the feet"
        yield Attack(f"sheet: {name}", with_sheet(asset, sheet, setting), counts=counts)
        if not quick or name in ("floor", "wall"):
            yield Attack(f"half gone, sheet: {name}", with_sheet(holed, sheet, setting), half, counts)
    for share in (0.03,) if quick else (-0.03, -0.01, 0.01, 0.03):
        yield Attack(f"swollen by {share:+.0%}", swollen(asset, share), counts=exact)


def without(asset: Asset, gone: np.ndarray) -> Asset:
    """The asset without the faces of bool `gone` [F]; at least one stays."""
    kept = ~gone
    kept[0] |= not kept.any()
    return replace(asset, faces=asset.faces[kept], uv_faces=asset.uv_faces[kept])


def with_sheet(asset: Asset, sheet: tuple[np.ndarray, int], setting: Setting) -> Asset:
    """The asset and a square (corners [4, 3], pieces to a side) of the one colour of its texture that is nearest to the
    photographs' mean.
    """
    views = setting.test
    inside = views.alpha > 0.5 if setting.region is None else setting.region.inside
    target = views.images[inside].mean(axis=0)
    texels = srgb_to_linear(asset.texture)
    row, column = np.unravel_index(np.square(texels - target).sum(-1).argmin(), texels.shape[:2])
    place = np.array([[(column + 0.5) / texels.shape[1], 1 - (row + 0.5) / texels.shape[0]]], np.float32)
    first, spot = len(asset.vertices), len(asset.uvs)
    corners, pieces = sheet
    share = np.linspace(0, 1, pieces + 1)
    points = corners[0] + share[:, None, None] * (corners[3] - corners[0]) + share[:, None] * (corners[1] - corners[0])
    here = (np.arange(pieces)[:, None] * (pieces + 1) + np.arange(pieces)).ravel()
    below = here + pieces + 1
    faces = np.concatenate([np.stack([here, here + 1, below + 1], 1), np.stack([here, below + 1, below], 1)])
    return replace(
        asset,
        vertices=np.concatenate([asset.vertices, points.reshape(-1, 3).astype(np.float32)]),
        faces=np.concatenate([asset.faces, (faces + first).astype(np.int32)]),
        uvs=np.concatenate([asset.uvs, place]),
        uv_faces=np.concatenate([asset.uv_faces, np.full((len(faces), 3), spot, np.int32)]),
    )


def sheets(asset: Asset, views: Views) -> dict[str, tuple[np.ndarray, int]]:
    """A floor below the unit sphere, a wall behind it as the middle held-out view sees it, a roof above all cameras,
    and a floor at the asset's feet: squares for `with_sheet`.
    """
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 1.5
    pose = views.camera_to_world[len(views) // 2]
    forward = -pose[:3, 3] / np.linalg.norm(pose[:3, 3])
    side = np.cross(forward, pose[:3, 1])
    side /= np.linalg.norm(side)
    wall = 1.01 * forward + square[:, :1] * side + square[:, 1:] * np.cross(forward, side)
    above = 1.05 * views.camera_to_world[:, 1, 3].max()
    feet = asset.vertices[:, 1].min() - 0.01
    return {"floor": (np.insert(square, 1, -1.01, axis=1), 1), "wall": (wall, 1),
            "roof out of sight": (np.insert(2 * square, 1, above, axis=1), 1),
            "floor at the feet": (np.insert(0.5 * square, 1, feet, axis=1), 32)}  # fmt: skip


def swollen(asset: Asset, share: float) -> Asset:
    """Every vertex moved along its normal by a share of the unit sphere's radius."""
    normals = angle_weighted_normals(asset.vertices, asset.faces)
    return replace(asset, vertices=(asset.vertices + share * normals).astype(np.float32))


def stripped(views: Views) -> Views:
    """The photographs as they are, over black, and nothing said of what is the object."""
    return replace(views, alpha=np.ones_like(views.alpha), has_masks=False)


def poor_asset(train: Views, surface: tuple[np.ndarray, np.ndarray], texels: int = 256) -> Asset:
    """A coarse surface with the photographs' colours, one roughness and white light of their mean level."""
    vertices, faces = clean_mesh(*surface, CleanSettings(faces=4000))[:2]
    uvs, uv_faces = unwrap(vertices, faces, texels)
    blank = np.zeros((texels, texels, 3), np.float32)
    return as_asset(initial_state(Carrier(vertices, faces, uvs, uv_faces, blank), train), train)


def as_asset(carrier: Carrier, train: Views) -> Asset:
    """The Stage I texture as base colour, under white light that makes it as bright as the photographs."""
    plain = Carrier(**{field.name: getattr(carrier, field.name) for field in fields(Carrier)})
    asset = neutral_asset(plain)
    level = float(train.images[train.alpha > 0.5].mean()) / max(float(asset.base_color.mean()), 1e-6)
    return replace(asset, environment=np.float32(level) * asset.environment)


def _random(asset: Asset, share: float, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).permutation(len(asset.faces)) < share * len(asset.faces)


def _clustered(asset: Asset, share: float, seed: int) -> np.ndarray:
    """The faces nearest to three places on the mesh."""
    middle = asset.vertices[asset.faces].mean(axis=1)
    places = middle[np.random.default_rng(seed).integers(len(middle), size=3)]
    away = np.linalg.norm(middle[:, None] - places, axis=-1).min(axis=1)
    return away <= np.quantile(away, share)


def _picked(asset: Asset, setting: Setting) -> np.ndarray:
    """The faces that the held-out photographs would rather see black, by the picture with the texture."""
    views = setting.test
    shown, _ = render_carrier(asset, views)
    worth = np.zeros(len(asset.faces))
    for i in range(len(views)):
        where = asset.vertices, asset.faces, views.intrinsics[i], views.world_to_camera[i]
        face = rasterize(*map(torch.from_numpy, where), views.height, views.width).face_id.numpy()
        counted = face >= 0
        if setting.region is not None:
            counted &= setting.region.inside[i]
        truth = views.images[i].clip(0, 1) ** (1 / 2.2)
        pays = np.square(shown[i] - truth).sum(-1) - np.square(truth).sum(-1)
        np.add.at(worth, face[counted], pays[counted])
    return worth > 0


def settings_of(test: Views, train: Views, truth: SceneTruth | None, quick: bool) -> list[Setting]:
    """With masks, where there are any, without, and with masks of the training views alone."""
    quality = Quality(directions=32, bounces=0, supersampling=1, specular_samples=2)
    count = 2 if quick else 4
    downscale = 1 if max(test.width, test.height) < 200 else 2
    region = find_region(stripped(test), stripped(train), RegionSettings(downscale=downscale))
    fine = quality.replaced(supersampling=2)
    cases = [Setting("without masks", stripped(test), truth, region, fine, count)]
    if not test.has_masks:
        return cases
    by_hull = find_region(stripped(test), train)
    return [
        Setting("with masks", test, truth, None, quality, count), *cases,
        Setting("training masks", stripped(test), truth, by_hull, fine, count),
    ]  # fmt: skip


def run_attacks(name: str, asset: Asset, setting: Setting, exact: bool, quick: bool) -> list[dict[str, Any]]:
    """Print the table of one asset in one setting; its rows."""
    base = figures(asset, setting)
    done, rows = {"": base}, []
    print(f"\n{name}, {setting.name}\n{'':34}" + "".join(f"{label[:16]:>18}" for label in base))
    print(f"{'as it is':34}" + "".join(f"{value:18.4g}" for value, _ in base.values()), flush=True)
    for attack in attacks(asset, setting, exact, quick):
        after = done[attack.name] = figures(attack.asset, setting)
        better = gains(done[attack.base], after)
        fault = bool(better) and attack.counts
        marks = "".join(f"{value:17.4g}{'+' if label in better else ' '}" for label, (value, _) in after.items())
        print(f"{attack.name:34}{marks}{'  GAIN' if fault else ''}", flush=True)
        rows.append({"asset": name, "setting": setting.name, "attack": attack.name, "gains": better, "fault": fault,
                     "figures": {label: value for label, (value, _) in after.items()}})  # fmt: skip
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.metric_attacks",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("scene", type=Path, nargs="?", default=SAMPLE)
    parser.add_argument("--run", type=Path, help="a finished run of this scene")
    parser.add_argument("--store", type=Path, help="its store, where it is not the usual one")
    parser.add_argument("--downscale", type=int, default=0, help="of the pictures; 0: 2 for the sample, else 1")
    parser.add_argument("--quick", action="store_true", help="two views, few attacks")
    parser.add_argument("--lpips", type=Path, help="LPIPS's weights (docs/metrics.md), for two more figures")
    parser.add_argument("--json", type=Path, help="write the rows here too")
    options = parser.parse_args()
    torch.set_num_threads(1)
    # light that is coarser than a score's: what is attacked is where surface shows
    render.render_transport = partial(render.render_transport, points=2000)  # type: ignore[assignment]
    sample = options.scene.resolve() == SAMPLE.resolve()
    scene, case = load_scene(options.scene, options.downscale or (2 if sample else 1), 0)
    subjects: list[tuple[str, Asset, bool]] = []
    if options.run is not None:
        subjects += _from_run(options.run, options.store, scene.train)
    else:
        if sample:
            asset = true_asset(scene.truth)
            subjects.append(("true asset", replace(asset, texture=np.clip(asset.base_color, 0, 1) ** (1 / 2.2)), True))
        surface = hull(case, 64) if case.field is not None else fused(case, case.sweep())
        subjects.append(("poor asset", poor_asset(scene.train, surface), False))
    rows: list[dict[str, Any]] = []
    for setting in settings_of(scene.test, scene.train, scene.truth, options.quick):
        for name, asset, exact in subjects:
            rows += run_attacks(name, asset, replace(setting, lpips=options.lpips), exact, options.quick)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    faults = [row for row in rows if row["fault"]]
    for row in faults:
        got = ", ".join(f"{label} by {gain:.3g}" for label, gain in row["gains"].items())
        print(f"gain: {row['asset']}, {row['setting']}, {row['attack']}: {got}")
    print(f"\n{len(rows)} attacks, {len(faults)} gains")
    sys.exit(1 if faults else 0)


def _from_run(folder: Path, store: Path | None, train: Views) -> list[tuple[str, Asset, bool]]:
    from exmesh_graph import open_run

    run = open_run(folder, store=store) if store else open_run(folder)
    found = [("Stage I of the run", as_asset(run["settle"].state, train), False)]
    if "pbr" in run:
        found.append(("asset of the run", run["pbr"].asset, False))
    return found


if __name__ == "__main__":
    main()
