"""What is lost where in Stage II: the fit with one thing after the other made true or finer, where truth is known.

    python -m benchmarks.error_budget graphs/samples/chair graphs/samples/spot --downscale 2
    python -m benchmarks.error_budget FOLDER/idol --downscale 4 --only shipped,sky,light
    python -m benchmarks.error_budget FOLDER/idol --carrier RUN       # and what our own mesh costs
    python -m benchmarks.error_budget FOLDER/idol --only shipped --set pbr.light_first=0.25 --set neutral.roughness=0.2
    python -m benchmarks.error_budget FOLDER/phone --scoring --downscale 2        # a scene for scoring

With --scoring nothing can be chosen: settings are those of the graph, and --set is refused.

A scene without masks (`desk`, `still`) is fitted and scored by those beside it, on the object without its table.

The base is the quickstart's Stage II on the *true* mesh: parameters of graphs/quickstart.yaml, with what its probe
decides for the scene. One line per row and scene, figures as by evaluate.asset; the second line is the difference to
the base. Rows:

    shipped    the base
    mesh       our own mesh in place of the true one (--carrier: a run of the quickstart, or a stored Stage1State)
    light      the true sky is given and kept
    sky        a sky of twice the rows
    transport  four times the directions and points
    lobes      the specular term measured three times as often, with four times the rays
    priors     without the prior on roughness
    views      without noise and clipping: the pictures in HDR where the scene has them
    all        light, transport and lobes together: what is left is resolution, pictures and the fit itself
    truth      nothing fitted: the true maps and light, so what the renderer and the scored pictures' noise leave

One sample a pixel (--supersampling 1) scores the truth itself at 33 to 34 dB on small pictures, and hides the rest.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from exmesh_nodes import data, transport

import exmesh_graph as ex
from benchmarks import register
from benchmarks.blender import true_asset
from benchmarks.stage2 import Quiet, assignment, stored_carrier, true_carrier
from exmesh_graph.evaluate.asset import score_asset
from exmesh_graph.evaluate.region import find_region
from exmesh_graph.evaluate.settings import Quality, RegionSettings
from exmesh_graph.io.images import read_mask
from exmesh_graph.masks.apply import with_masks
from exmesh_graph.masks.files import masks_for
from exmesh_graph.shading.transport import with_bounces
from exmesh_graph.stage2.alike import Alike
from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.init import neutral_asset
from exmesh_graph.stage2.key_light import counts, find_key_light
from exmesh_graph.stage2.probe.scene import probe_scene
from exmesh_graph.stage2.render import render_views
from exmesh_graph.types import Asset, Carrier, Region, SceneNeeds, SceneTruth, Transport, Views, with_decisions

#: Whose parameters are the base's: the transport, where a fit starts, the fit.
GRAPH, NODES = Path(__file__).parents[1] / "graphs" / "quickstart.yaml", ("light", "neutral", "pbr")
#: Row: what it changes of the fit's settings, of the transport's, and of what it is given.
ROWS: dict[str, tuple[dict[str, Any], dict[str, int], set[str]]] = {
    "shipped": ({}, {}, set()),
    "mesh": ({}, {}, {"mesh"}),
    "light": ({}, {}, {"light"}),
    "sky": ({"environment_height": 128}, {}, set()),
    "transport": ({}, {"directions": 512, "points": 48_000}, set()),
    "lobes": ({"corrections": 9, "correction_samples": 64}, {}, set()),
    "priors": ({}, {}, {"no prior"}),
    "views": ({}, {}, {"hdr"}),
    "all": (
        {"corrections": 9, "correction_samples": 64},
        {"directions": 512, "points": 48_000},
        {"light"},
    ),
    "truth": ({}, {}, {"truth"}),
}
#: Figures in dB; the mean squared error of roughness; the share of pixels whose metallic is on the wrong side of 0.5.
FIGURES = ("held-out", "relit", "unscaled", "albedo", "roughness", "wrong side")


def main() -> None:
    options = arguments()
    torch.set_num_threads(1)
    found: dict[str, dict[str, list[float]]] = {}
    print(f"{'':28s}" + "".join(f"{name:>11s}" for name in FIGURES))
    for folder in options.scene:
        if not options.scoring:
            register.choosing(folder)
        found[folder.name] = budget(folder, options)
        if options.json:
            options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def budget(folder: Path, options: argparse.Namespace) -> dict[str, list[float]]:
    """The figures of every row of one scene, printed as they come."""
    scene = _scene(folder, options.downscale, "false")
    carriers = {"true": true_carrier(Quiet(0), scene)}
    if options.carrier:
        run = (options.carrier / "run.json").is_file()
        carriers["own"] = ex.open_run(options.carrier)["settle"]["state"] if run else stored_carrier(options.carrier)
    needs = probe_scene(carriers["true"], scene.train, seed=options.seed).needs
    figures: dict[str, list[float]] = {}
    for name in options.only or ROWS:
        settings, traced, given = ROWS[name]
        if "mesh" in given and "own" not in carriers:
            continue
        views = scene.train
        if "hdr" in given:
            views = _scene(folder, options.downscale, "auto").train
            if views.clipped:  # the scene has 8-bit pictures only
                continue
        figures[name] = _row(
            folder,
            carriers["own" if "mesh" in given else "true"],
            scene,
            views,
            needs,
            settings,
            traced,
            given,
            options,
        )
        _show(folder.name, name, figures)
    return figures


def _row(
    folder: Path,
    carrier: Carrier,
    scene: data.BlenderOut,
    views: Views,
    needs: SceneNeeds,
    changes: dict[str, Any],
    traced: dict[str, int],
    given: set[str],
    options: argparse.Namespace,
) -> list[float]:
    graph = ex.check(GRAPH, set=dict(options.set))
    light_settings, begun, fitted = (graph.node(name).params for name in NODES)
    light = transport.direct(Quiet(0), carrier, p=light_settings.replaced(**traced)).transport
    if bounces := needs.chosen("bounces"):
        light = with_bounces(light, bounces)
    settings = with_decisions(fitted, needs).replaced(**changes, keep_light="light" in given)
    start_settings = with_decisions(begun, needs)
    key = find_key_light(carrier, light) if start_settings.key_light else None
    start = neutral_asset(carrier, start_settings, key=key if key and counts(key) else None)
    if "light" in given:
        start = replace(start, environment=_true_sky(scene.truth))
    prior = None if "no prior" in given else Alike()
    if "truth" in given:
        asset = true_asset(scene.truth, folder)
    else:
        asset, _ = fit(carrier, views, light, settings, seed=options.seed, start=start, prior=prior, warn=print)
    quality = Quality(supersampling=options.supersampling)
    values = score_asset(
        asset, scene.test, scene.truth, scene.train, max_views=options.views, quality=quality,
        region=_region(folder, scene.test),
    ).values  # fmt: skip
    relit, material = values["relit"], values["material"]
    return [values["held_out"]["psnr"], relit["psnr"], relit["psnr_unscaled"],
            material["albedo_psnr_linear"], material["roughness_mse"],
            wrong_side(asset, folder, scene.test, light, options)]  # fmt: skip


def wrong_side(asset: Asset, folder: Path, test: Views, light: Transport, options: argparse.Namespace) -> float:
    """Share of the covered pixels of the first test views whose metallic is on the other side of 0.5 than the truth's
    picture beside the photograph (`..._metallic.png`); NaN for a scene without these."""
    names = [name.removeprefix("test_") for name in test.names[: options.views]]
    pictures = [folder / "test" / f"{name}_metallic.png" for name in names]
    if not all(file.is_file() for file in pictures):
        return math.nan
    metallic = asset.metallic if asset.metallic is not None else np.zeros_like(asset.roughness)
    cameras = (test.intrinsics[: options.views], test.camera_to_world[: options.views], test.height, test.width)
    # a map that is shown in roughness's place is averaged over a pixel as the truth's pictures were
    shown = render_views(
        replace(asset, roughness=metallic), *cameras, supersampling=2, specular_samples=1, transport=light
    )
    true = np.stack([_reduced(read_mask(file), options.downscale) for file in pictures])
    counts = (shown.alpha > 0.99) & (test.alpha[: options.views] > 0.99)
    return float(((shown.roughness > 0.5) != (true > 0.5))[counts].mean())


def _reduced(picture: np.ndarray, factor: int) -> np.ndarray:
    height, width = (size // factor for size in picture.shape)
    return picture[: height * factor, : width * factor].reshape(height, factor, width, factor).mean(axis=(1, 3))


def _scene(folder: Path, downscale: int, hdr: str) -> data.BlenderOut:
    masks = folder / "masks"
    mesh = {"true_mesh": "mesh/object.obj"} if masks.is_dir() else {}
    scene = data.blender(Quiet(0), p=data.BlenderParams(path=folder, downscale=downscale, hdr=hdr, **mesh))
    if scene.train.has_masks:
        return scene
    return scene._replace(train=with_masks(scene.train, masks_for(scene.train, masks), "error_budget"))


def _region(folder: Path, test: Views) -> Region | None:
    if test.has_masks:
        return None
    return find_region(test, settings=RegionSettings(masks=folder / "masks"))


def _true_sky(truth: SceneTruth) -> Any:
    assert truth.environment is not None, "the scene names no light of its photographs"
    return truth.environment


def _show(scene: str, name: str, figures: dict[str, list[float]]) -> None:
    def line(title: str, values: list[float], sign: str) -> str:
        return (
            f"{title:28s}"
            + "".join(f"{v:{sign}11.2f}" for v in values[:4])
            + f"{values[4]:{sign}11.5f}{values[5]:{sign}11.3f}"
        )

    print(line(f"{scene}: {name}", figures[name], ""), flush=True)
    if name != "shipped" and "shipped" in figures:
        gain = [a - b for a, b in zip(figures[name], figures["shipped"], strict=True)]
        print(line("", gain, "+"), flush=True)


def arguments(command: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, nargs="+")
    parser.add_argument("--carrier", type=Path, help="a run, or the folder of a stored Stage1State, for `mesh`")
    parser.add_argument("--only", type=lambda text: text.split(","), help="rows, joined by commas")
    parser.add_argument("--downscale", type=int, default=1)
    parser.add_argument("--views", type=int, default=4, help="test views that are scored")
    parser.add_argument("--supersampling", type=int, default=2, help="samples per pixel side of scored pictures")
    parser.add_argument(
        "--set", type=assignment, action="append", default=[], metavar="NODE.PARAMETER=VALUE",
        help=f"a parameter of the graph's nodes {', '.join(NODES)}",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--scoring", action="store_true", help="scenes for scoring too; no setting can be changed then")
    options = parser.parse_args(command)
    if lost := [name for name, _ in options.set if name.split(".")[0] not in NODES]:
        parser.error(f"--set reaches the nodes {', '.join(NODES)} alone, not {', '.join(lost)}")
    if options.scoring and options.set:
        parser.error(
            "--scoring measures the shipped settings, so that nothing is chosen on these scenes: leave out --set"
        )
    return options


if __name__ == "__main__":
    main()
