"""Is interreflected light as bright as a path tracer's? `concave` with its true maps, bounce by bounce.

    python -m benchmarks.bounce_bias FOLDER/concave [--downscale 2] [--views 3] [--json FILE]

The scene's `test_light` holds light that met the surface once (direct), and with one more bounce of any kind; its test
pictures have four more. Ours: the true mesh, base colour and roughness in an atlas, the true sky, 1 and 4 bounces.
One line each: ours over the path tracer's by channel, the median over the pixels that owe the mesh much of their light
(what our lobes mirror of the mesh belongs to a bounce of the path tracer's, so that sums are compared, not
differences), and the PSNR of these pixels in display values.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import torch
from exmesh_nodes import data, uv

from benchmarks.stage2 import Quiet
from exmesh_graph.io.images import read_raw
from exmesh_graph.io.meshes import read_vertex_table
from exmesh_graph.stage2.render import render_transport, render_views
from exmesh_graph.types import Asset, Carrier, Mesh
from exmesh_graph.uv.raster import rasterize_atlas

SIZE = 1024
#: Views of `concave` that look into the box (shared/data: figures of interreflection).
INSIDE = (6, 7, 8, 9, 10, 11)
#: Pixels count whose direct light is less than this share of all.
LIT = 0.7


def main() -> None:
    options = arguments()
    torch.set_num_threads(1)
    scene = data.blender(Quiet(0), p=data.BlenderParams(path=options.scene, downscale=options.downscale, hdr="true"))
    asset = true_asset(options.scene, scene)
    chosen = list(INSIDE[: options.views])
    views = scene.test
    inside = views.alpha[chosen] > 0.99
    ours = {}
    for bounces in (1, 4):
        light = render_transport(asset, bounces)
        ours[bounces] = render_views(
            asset, views.intrinsics[chosen], views.camera_to_world[chosen], views.height, views.width,
            transport=light, supersampling=1, specular_samples=64,
        ).images  # fmt: skip
    theirs = {
        k: _light(options.scene, name, chosen, options.downscale) for k, name in ((0, "direct"), (1, "one_bounce"))
    }
    theirs[4] = np.stack([views.images[k] for k in chosen])
    found = {}
    walls = inside & (theirs[0].sum(-1) < LIT * theirs[4].sum(-1))
    print(f"{int(walls.sum())} pixels owe more than {100 * (1 - LIT):.0f} % of their light to the mesh")
    for name, bounces in (("one bounce", 1), ("all", 4)):
        ratio = np.median(ours[bounces][walls] / theirs[bounces][walls].clip(1e-6), axis=0)
        error = _display(ours[bounces][walls]) - _display(theirs[bounces][walls])
        psnr = -10 * np.log10(np.mean(error**2))
        found[name] = {"ratio": ratio.tolist(), "psnr": float(psnr)}
        shown = " ".join(f"{v:.3f}" for v in ratio)
        print(f"{name:12s} ours / path traced, median: {shown}   {psnr:.2f} dB", flush=True)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def true_asset(folder: Path, scene: data.BlenderOut) -> Asset:
    """The true mesh with its true maps, in an atlas of `SIZE` texels."""
    truth = scene.truth
    table = read_vertex_table(folder / "mesh" / "mesh.ply")
    mesh = Mesh(truth.mesh_vertices.astype(np.float32), truth.mesh_faces.astype(np.int32))
    carrier: Carrier = uv.unwrap(Quiet(0), mesh, p=uv.UnwrapParams(texture_size=SIZE)).carrier
    face, bary = rasterize_atlas(carrier.uvs, carrier.uv_faces, SIZE, 1.5)
    values = np.stack([table[name] for name in ("albedo_r", "albedo_g", "albedo_b", "roughness")], axis=1)
    maps = np.einsum("hwk,hwkc->hwc", bary, values[carrier.faces[face.clip(0)]]).astype(np.float32)
    assert truth.environment is not None
    return Asset(
        **{field.name: getattr(carrier, field.name) for field in fields(Carrier)},
        base_color=maps[..., :3].copy(), roughness=maps[..., 3].copy(), seen=face >= 0,
        environment=truth.environment, metallic=None,
    )  # fmt: skip


def _light(folder: Path, name: str, chosen: list[int], factor: int) -> np.ndarray:
    pictures = [read_raw(folder / "test_light" / f"{name}_{k:03d}.exr")[..., :3] for k in chosen]
    high, wide = (side // factor for side in pictures[0].shape[:2])
    return np.stack([p.reshape(high, factor, wide, factor, 3).mean((1, 3)) for p in pictures])


def _display(linear: np.ndarray) -> np.ndarray:
    x = linear.clip(0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--downscale", type=int, default=2)
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument("--json", type=Path)
    return parser.parse_args()


if __name__ == "__main__":
    main()
