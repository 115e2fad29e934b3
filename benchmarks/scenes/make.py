"""Make a scene: shape, maps, lights, photographs, truth, and what was measured of them. What lies there is kept."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import processor
from benchmarks.scenes import files, lights
from benchmarks.scenes.cameras import rays, spiral
from benchmarks.scenes.catalogue import RECIPES
from benchmarks.scenes.kinds import Recipe
from benchmarks.scenes.model import assemble, encode
from benchmarks.scenes.render import Stage
from benchmarks.scenes.truth import Truth
from benchmarks.scenes.verify import verify
from exmesh_graph.io.images import read_image, write_image
from exmesh_graph.shading.moving import light_turns


@dataclass(frozen=True)
class Size:
    """Pixels on a side, views, samples a pixel of training, test and relit pictures; largest side of the maps."""

    pixels: int = 512
    train: int = 48
    test: int = 8
    samples: tuple[int, int, int] = (25, 98, 50)
    texels: int = 4096
    light: int = lights.HEIGHT
    hdr: bool = True


QUICK = Size(128, 12, 3, (9, 32, 18), 512)
#: The sample of the repository: 8-bit pictures only.
SAMPLE = Size(256, 36, 6, (100, 242, 128), 256, 64, hdr=False)
#: Heights over distance of cameras in one ring: some 30 degrees up.
RING = (0.48, 0.52)


def make(
    name: str,
    out: Path,
    size: Size,
    *,
    worlds: Path | None = None,
    envmaps: Path | None = None,
    threads: int = 0,
    moves: str = "",
    near: bool = False,
    ring: bool = False,
) -> Path:
    """Make what is missing of the scene in out / name; returns that folder.

    worlds   the wheel of bpy 5.0.1 or a folder of its world pictures, for scenes lit by one
    envmaps  a folder of EXR maps to relight the test views by besides the recipe's own
    moves    "turntable" or "camera": what the light of the photographs moves with; the folder is out / name_moves
    near     every other training picture is a close-up; the folder is out / name_near
    ring     all cameras look down from one height, as one walk around makes them; the folder is out / name_ring
    """
    recipe = replace(RECIPES[name], heights=RING) if ring else RECIPES[name]
    folder = out / "_".join([name, *[moves] * bool(moves), *["near"] * near, *["ring"] * ring])
    for place in ("train", "test", "test_rli", "envmaps", "mesh"):
        (folder / place).mkdir(parents=True, exist_ok=True)
    began, busy = time.perf_counter(), time.process_time()
    model = files.read_model(folder / "mesh")
    if model is None:
        model = assemble(list(recipe.solids()), recipe.paint, min(recipe.texels, size.texels), recipe.ground)
        files.write_model(folder / "mesh", model)
    truth = Truth(model)
    train = spiral(size.train, *recipe.heights, 0.0, recipe.seed)
    if near:
        train = [closer(pose, truth, k) if k % 2 else pose for k, pose in enumerate(train)]
    test = spiral(size.test, recipe.heights[0] + 0.05, recipe.heights[1] - 0.02, 1.3, recipe.seed + 1)
    files.write_cameras(folder / "transforms_train.json", "train", train, size.pixels)
    files.write_cameras(folder / "transforms_test.json", "test", test, size.pixels)
    light, relit = _lights(folder, recipe, size, worlds, envmaps)
    stage = Stage(model, background=bool(recipe.ground), threads=threads)
    noise = _test_pictures(folder, recipe, stage, size, test, turning(light, test, moves), relit)
    _train_pictures(folder, recipe, stage, size, train, turning(light, train, moves), threads)
    _maps(folder, recipe, truth, size, train, test)
    if noise:
        files.write_json(folder / "noise.json", noise)
    if not (folder / "verify.json").is_file():
        tried = relit if moves else {"train": light, **relit}
        found = verify(stage, truth, test, tried, size.pixels, masked=not recipe.ground)
        files.write_json(folder / "verify.json", found)
    _note(
        folder,
        f"{name}_sample" if size == SAMPLE else name,
        size,
        time.perf_counter() - began,
        time.process_time() - busy,
    )
    return folder


def _lights(
    folder: Path, recipe: Recipe, size: Size, worlds: Path | None, envmaps: Path | None
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """(light of the photographs, {name: relit light}), as the files hold them: written where missing."""

    def kept(path: Path, kind: str, seed: int) -> np.ndarray:
        if not path.is_file():
            if kind in lights.PROCEDURAL:
                found = lights.reduced(lights.PROCEDURAL[kind](seed), size.light)
            else:  # a photographed world that stands in the pictures keeps its whole resolution
                found = lights.world(kind, worlds, seed, 2 * size.light if recipe.ground else size.light)
            write_image(path, levelled(found, recipe.level), "half")
        return lights.read_exr(path)

    light = kept(folder / "env_train.exr", *recipe.light)
    relit = {name: kept(folder / f"envmaps/{name}.exr", *what) for name, what in recipe.lights().items()}
    for source in sorted(envmaps.glob("*.exr")) if envmaps else ():
        path = folder / "envmaps" / source.name
        if not path.is_file():
            write_image(path, lights.read_exr(source).clip(0), "half")
        relit[source.stem] = lights.read_exr(path)
    return light, relit


#: Of the way to what a close-up is aimed at, the share that its camera stands away.
NEAR = 0.42


def closer(pose: np.ndarray, truth: Truth, seed: int) -> np.ndarray:
    """A level camera on the way from `pose` to some part of the surface that it sees, aimed at that part."""
    seen = rays(pose, 64).reshape(-1, 6)
    met = truth.cast(seen)
    chosen = np.random.default_rng(seed).choice(np.flatnonzero(met.hit))
    towards = seen[chosen, 3:].astype(np.float64)
    right = np.cross(towards, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    found = np.eye(4)
    eye = seen[chosen, :3] + (1 - NEAR) * met.distance[chosen] * towards
    found[:3] = np.column_stack([right, np.cross(right, towards), -towards, eye])
    return found


#: The light of the photographs: one for all views, or one for each.
Light = np.ndarray | Sequence[np.ndarray]


def turning(light: np.ndarray, poses: list, moves: str) -> Light:
    """The light of each view where it moves with the camera, as the file holds it for a camera at -y ("turntable"), or
    for one that is held level there ("camera")."""
    if not moves:
        return light
    opencv = np.stack(poses) @ np.diag([1.0, -1, -1, 1])
    turns = light_turns(np.array([0, 0, float(moves == "turntable")]), opencv)
    assert turns is not None
    towards = lights.directions(len(light)).reshape(-1, 3)
    to_file = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # from y up to z up
    return [lights.lookup(light, towards @ (to_file @ turn).T).reshape(light.shape) for turn in turns]


def lit(stage: Stage, light: Light, view: int) -> Any:
    """The stage under the light of the photographs as it is for a view."""
    if isinstance(light, np.ndarray):
        return stage.lit("train", light)
    stage.scenes.clear()
    return stage.lit("train", light[view].astype(np.float32))


def levelled(light: np.ndarray, level: float) -> np.ndarray:
    """Scaled so that its radiance over all directions adds up to `level`."""
    height = len(light)
    weight = np.sin((np.arange(height) + 0.5) / height * np.pi)[:, None, None] * (np.pi / height) ** 2
    return light * (level / float((light * weight).sum((0, 1)).mean()))


def _test_pictures(
    folder: Path, recipe: Recipe, stage: Stage, size: Size, poses: list, light: Light, relit: dict
) -> dict[str, float]:
    """Test views under the training light and relit; {picture: PSNR [dB] of two renderings of half the samples}."""
    noise: dict[str, float] = {}
    masked = not recipe.ground
    plan: list[tuple[str, str, Any, int, int]]
    plan = [(f"test/{k:03d}", "train", None, k, size.samples[1]) for k in range(len(poses))]
    plan += [
        (f"test_rli/{name}_{k:03d}", name, value, k, size.samples[2])
        for name, value in relit.items()
        for k in range(len(poses))
    ]
    for number, (stem, name, value, view, samples) in enumerate(plan):
        suffix = "_rgba" if stem.startswith("test/") and masked else ""
        if (folder / f"{stem}{suffix}.png").is_file():
            continue
        scene = lit(stage, light, view) if name == "train" else stage.lit(name, value)
        halves = [
            stage.picture(
                scene, poses[view], size.pixels, samples // 2, recipe.seed * 10_000 + 2000 + 2 * number + part
            )
            for part in (0, 1)
        ]
        noise[stem] = _psnr(*halves)
        files.write_photograph(folder / stem, np.mean(halves, axis=0), masked=masked, hdr=size.hdr, suffix=suffix)
    return noise


def _psnr(a: np.ndarray, b: np.ndarray) -> float:
    """Of display values over black, on the covered pixels [dB]."""
    inside = (a[..., 3] + b[..., 3]) > 1
    return float(-10 * np.log10(np.mean((encode(a[inside][:, :3]) - encode(b[inside][:, :3])) ** 2) + 1e-12))


def _train_pictures(
    folder: Path, recipe: Recipe, stage: Stage, size: Size, poses: list, light: Light, threads: int
) -> None:
    masked = not recipe.ground
    missing = [k for k in range(len(poses)) if not (folder / f"train/{k:03d}{'_rgba' if masked else ''}.png").is_file()]
    gains = wandering(len(poses), recipe.seed) if recipe.wander else np.ones((len(poses), 3))
    boards = passers(poses, light, recipe.seed) if recipe.wander and isinstance(light, np.ndarray) else {}
    if recipe.wander:
        files.write_json(folder / "wander.json", {
            "what": "train pictures: linear colour times gain (R, G, B), and a dark board that shades the object",
            "gain": {f"train/{k:03d}": gains[k].round(5).tolist() for k in range(len(poses))},
            "shaded": [f"train/{k:03d}" for k in sorted(boards)],
        })  # fmt: skip
    shaded = Stage(stage.model, background=stage.background, guest=True, threads=threads) if boards else stage
    for k in missing:
        here = shaded if k in boards else stage
        if k in boards:
            shaded.place_guest(boards[k])
        seed = recipe.seed * 10_000 + k
        rgba = here.picture(lit(here, light, k), poses[k], size.pixels, size.samples[0], seed)
        rgba[..., :3] *= gains[k].astype(np.float32)
        files.write_photograph(folder / f"train/{k:03d}", rgba, masked=masked, hdr=False)


def wandering(count: int, seed: int) -> np.ndarray:
    """Gains [N, 3] on linear colour: exposure by up to half a stop, white balance by a few per cent."""
    rng = np.random.default_rng(seed)
    stops = np.clip(rng.normal(0, 0.28, count), -0.5, 0.5)
    tint = np.clip(rng.normal(0, 0.06, (count, 3)), -0.12, 0.12) * [1, 0, 1]
    return 2 ** stops[:, None] * np.exp(tint)


def passers(poses: list, light: np.ndarray, seed: int) -> dict[int, np.ndarray]:
    """{view: corners [8, 3]} of a board before the brightest part of the light, where the camera does not see it.

    A camera that stands close to it sees none of its corners, though the board stands before the object.
    """
    rng = np.random.default_rng(seed + 5)
    at = np.unravel_index(light.sum(-1).argmax(), light.shape[:2])
    sun = lights.directions(len(light))[at]
    found = {}
    for k, pose in enumerate(poses):
        towards = sun + rng.normal(0, 0.10, 3)
        towards /= np.linalg.norm(towards)
        right = np.cross([0, 0, 1.0], towards)
        right /= np.linalg.norm(right)
        up = np.cross(towards, right)
        bits = np.array([[(c >> axis) & 1 for axis in range(3)] for c in range(8)]) * 2.0 - 1
        corners = 3.0 * towards + bits * [0.42, 0.5, 0.02] @ np.stack([right, up, towards])
        seen = (np.concatenate([corners, [3.0 * towards]]) - pose[:3, 3]) @ pose[:3, :3]
        inside = (seen[:, 2] < 0) & (np.abs(seen[:, :2]).max(1) < 0.45 * -seen[:, 2])
        sights = np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)]) - pose[:3, 3]  # towards the object
        along = (3.0 - pose[:3, 3] @ towards) / (sights @ towards)
        met = pose[:3, 3] + along[:, None] * sights
        before = (along > 0) & (along < 1) & (np.abs(met @ right) < 0.42) & (np.abs(met @ up) < 0.5)
        if not inside.any() and not before.any():
            found[k] = corners
    return found


def _maps(folder: Path, recipe: Recipe, truth: Truth, size: Size, train: list, test: list) -> None:
    """Truth of the test views; masks beside the pictures, or in a folder of their own where the pictures have none."""
    for split, poses in (("test", test), ("train", train)):
        for k, pose in enumerate(poses):
            mask = folder / split / f"{k:03d}_mask.png"
            if recipe.ground:  # kept apart, for scoring only, by the names that loaders give to views
                mask = folder / "masks" / f"{split}_{k:03d}.png"
            mask.parent.mkdir(exist_ok=True)
            if mask.is_file():
                continue
            if split == "train" and not recipe.ground:
                picture = read_image(folder / f"train/{k:03d}_rgba.png")
                files.whole(mask, picture[..., 3])
                continue
            seen = truth.view(pose, size.pixels)
            if split == "test":
                stem = folder / "test" / f"{k:03d}"
                alpha = seen["alpha"][..., None]
                albedo = np.concatenate([encode(seen["albedo"]), alpha], axis=-1)
                write_image(stem.with_name(stem.name + "_albedo.png"), albedo * (alpha > 0))
                write_image(stem.with_name(stem.name + "_rough.png"), seen["rough"], "uint16")
                write_image(stem.with_name(stem.name + "_metallic.png"), seen["metallic"], "uint16")
                if size.hdr:
                    write_image(stem.with_name(stem.name + "_normal.exr"), seen["normal"], "half")
                    write_image(stem.with_name(stem.name + "_depth.exr"), seen["depth"], "float")
            files.whole(mask, seen["own"])


def _note(folder: Path, name: str, size: Size, seconds: float, busy: float) -> None:
    import json

    import mitsuba

    file = folder / "made.json"
    before = json.loads(file.read_text()) if file.is_file() else {"seconds": 0.0, "processor_seconds": 0.0}
    files.write_json(file, {
        "scene": name, "pixels": size.pixels, "views": [size.train, size.test], "samples": list(size.samples),
        "mitsuba": mitsuba.__version__, "processor": processor(),
        "seconds": round(before["seconds"] + seconds, 1),
        "processor_seconds": round(before["processor_seconds"] + busy, 1),
    })  # fmt: skip
