"""Draw the README's picture from a finished run: photographs, mesh, maps, the asset under three lights.

python benchmarks/overview.py runs/latest docs/images/overview.png
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from exmesh_graph.evaluate.metrics.image import display
from exmesh_graph.gallery.pictures import resize
from exmesh_graph.gallery.shaded import shaded_geometry
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.io.images import write_image
from exmesh_graph.stage2.render import render_transport, render_views
from exmesh_graph.types import Asset, SceneTruth, Views

SIZE = 300


def main() -> None:
    """Read the run's artifacts from the store and write the strip."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--store", type=Path, default=Path(".exmesh"))
    parser.add_argument("--view", type=int, default=4, help="the test view the asset is shown from")
    arguments = parser.parse_args()

    outputs = {node["name"]: node["outputs"] for node in json.loads((arguments.run / "run.json").read_text())["nodes"]}
    store = Store(arguments.store)

    def load(kind: type, node: str, port: str):  # type: ignore[no-untyped-def]
        value = store.load(kind, outputs[node][port]["digest"])
        if value is None:
            raise SystemExit(f"{arguments.store} no longer holds {node}.{port}: run the graph again")
        return value

    train, test = load(Views, "views", "train"), load(Views, "views", "test")
    asset, truth = load(Asset, "pbr", "asset"), load(SceneTruth, "views", "truth")
    picture = np.concatenate(
        [
            _photographs(train),
            _mesh(asset, test, arguments.view),
            _maps(asset),
            *_lit(asset, test, arguments.view, [None, *(light for light, _ in truth.relit.values())]),
        ],
        axis=1,
    )
    write_image(arguments.picture, picture)


def _photographs(views: Views) -> np.ndarray:
    chosen = np.linspace(0, len(views) - 1, 9).astype(int)
    shown = _on_white(views.images[chosen], views.alpha[chosen])
    third = SIZE // 3
    tiles = [resize(image, third)[:, :third] for image in shown]
    return np.concatenate([np.concatenate(tiles[row : row + 3], axis=1) for row in (0, 3, 6)])


def _mesh(asset: Asset, views: Views, view: int) -> np.ndarray:
    finer = 4  # wires of a quarter of a pixel
    clay, _, edges = shaded_geometry(
        asset,
        views.intrinsics[view],
        views.camera_to_world[view],
        views.height,
        views.width,
        scale=finer * SIZE / views.height,
    )
    both = np.concatenate([clay[: len(clay) // 2], edges[len(edges) // 2 :]])
    return both.reshape(SIZE, finer, -1, finer, 3).mean(axis=(1, 3))


def _maps(asset: Asset) -> np.ndarray:
    base = resize(linear_to_srgb(asset.base_color), SIZE)
    rough = resize(np.repeat(asset.roughness[..., None], 3, axis=2), SIZE)
    below_diagonal = np.add.outer(np.arange(SIZE), np.arange(SIZE)) > SIZE
    return np.where(below_diagonal[..., None], rough, base)


def _lit(asset: Asset, views: Views, view: int, lights: list[np.ndarray | None]) -> list[np.ndarray]:
    scale = SIZE / views.height
    intrinsics = views.intrinsics[view : view + 1] * np.array([[scale], [scale], [1.0]])
    transport = render_transport(asset)
    pictures = []
    for light in lights:
        rendered = render_views(
            asset,
            intrinsics,
            views.camera_to_world[view : view + 1],
            SIZE,
            round(views.width * scale),
            environment=light,
            transport=transport,
        )
        pictures.append(_on_white(rendered.images, rendered.alpha)[0])
    return pictures


def _on_white(images: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    return display(images, alpha) + 1.0 - alpha[..., None]


if __name__ == "__main__":
    main()
