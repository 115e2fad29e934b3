"""A scene to choose settings on, so that no scored scene is used for it: a closed object with a bowl and an arch that
no outline shows, a thin ring and a fin, and fine relief on a small part of its surface.

    python -m benchmarks.make_scene FOLDER            # 48 + 12 views of 256 x 256 pixels, about two minutes

Writes the layout that `data.blender` reads, with the true mesh. The surface is a signed distance by marching cubes, its
colours are smooth noise and stripes at the vertices; Mitsuba 3 renders it (path tracing, a glossy principled BRDF, the
light of graphs/samples/spot). The same bytes on every run of one machine.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import numpy as np
from skimage.measure import marching_cubes

from benchmarks import light_mitsuba
from exmesh_graph.io.images import encode_rgba, write_image
from exmesh_graph.io.meshes import write_ply

SKY = Path(__file__).parent.parent / "graphs" / "samples" / "spot" / "env_train.exr"
RADIUS, DISTANCE, FIELD = 1.2, 4.0, math.radians(38)
RELIEF = np.array([0.0, 0.62, 0.0])


def main() -> None:
    options = arguments()
    vertices, faces = surface(options.grid)
    colours = paint(vertices)
    folder: Path = options.folder
    (folder / "mesh").mkdir(parents=True, exist_ok=True)
    write_ply(folder / "mesh" / "mesh.ply", vertices, faces)
    mi = light_mitsuba.load(options.threads)
    mesh = mitsuba_mesh(mi, vertices, faces, colours)
    for split, count, first in (("train", options.views, 0.0), ("test", options.test_views, 0.37)):
        (folder / split).mkdir(exist_ok=True)
        frames = []
        for number, pose in enumerate(poses(count, first)):
            rgba = photograph(mi, mesh, pose, options.size, options.spp, seed=number + 1000 * (split == "test"))
            write_image(folder / split / f"{number:03d}_rgba.png", rgba)
            frames.append({"file_path": f"{split}/{number:03d}", "transform_matrix": pose.tolist()})
        record = {"camera_angle_x": FIELD, "w": options.size, "h": options.size, "frames": frames}
        (folder / f"transforms_{split}.json").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    print(f"{len(vertices)} vertices, {len(faces)} faces, {options.views} + {options.test_views} views in {folder}")


def surface(grid: int) -> tuple[np.ndarray, np.ndarray]:
    """(vertices float32 [V, 3], faces int32 [F, 3]) of the object, z up, all within 1.2 of the origin."""
    axis = np.linspace(-1.25, 1.25, grid)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).astype(np.float32)
    values = np.concatenate([distance(slab) for slab in np.array_split(points, 16)])
    vertices, faces, _, _ = marching_cubes(values, 0.0, gradient_direction="descent", allow_degenerate=False)
    vertices = -1.25 + vertices * (axis[1] - axis[0])
    middle = (vertices.min(0) + vertices.max(0)) / 2
    vertices = (vertices - middle) * (RADIUS / np.linalg.norm(vertices - middle, axis=1).max())
    return vertices.astype(np.float32), faces.astype(np.int32)


def distance(p: np.ndarray) -> np.ndarray:
    """About the signed distance of points [..., 3], negative inside."""

    def ball(centre: tuple[float, ...], radii: tuple[float, ...]) -> np.ndarray:
        scaled = np.linalg.norm((p - np.float32(centre)) / np.float32(radii), axis=-1)
        return (scaled - 1) * min(radii)

    x, y, z = np.moveaxis(p, -1, 0)
    body = ball((0, 0, 0), (0.85, 0.62, 0.5))
    for centre in ((0.5, 0.36, -0.5), (0.5, -0.36, -0.5), (-0.55, 0.0, -0.5)):  # the feet; an arch between them
        body = blend(body, ball(centre, (0.2, 0.2, 0.36)), 0.12)
    body = blend(body, ball((0.78, 0, 0.45), (0.33, 0.28, 0.28)), 0.15)
    body = -blend(-body, ball((-0.2, 0, 0.5), (0.38, 0.3, 0.36)), 0.05)  # the bowl
    body = -blend(-body, ball((0.1, 0, -0.62), (0.5, 0.3, 0.3)), 0.08)
    around = np.hypot(np.hypot(x + 0.85, z - 0.12) - 0.25, y) - 0.05  # the ring
    fin = np.maximum(np.abs(y) - 0.03, ball((0.85, 0, 0.72), (0.3, 0.6, 0.3)))
    body = blend(blend(body, around, 0.03), fin, 0.04)
    near = np.exp(-np.square((p - RELIEF) / np.float32((0.3, 0.4, 0.24))).sum(-1) ** 2)
    return body - 0.016 * near * np.sin(30 * x) * np.sin(30 * z)


def blend(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    """Union of two distances, rounded over `width`."""
    near = np.maximum(width - np.abs(a - b), 0) / width
    return np.minimum(a, b) - near**2 * width / 4


def paint(vertices: np.ndarray) -> np.ndarray:
    """Base colour float32 [V, 3], linear."""
    rng = np.random.default_rng(7)
    colour = np.zeros((len(vertices), 3))
    for frequency in (3, 6, 12, 24):
        for _ in range(6):
            wave = rng.normal(size=3)
            phase = vertices @ (frequency * wave / np.linalg.norm(wave)) + rng.uniform(0, 6)
            colour += np.sin(phase)[:, None] * rng.normal(size=3) / math.sqrt(frequency)
    colour = 0.42 + 0.09 * colour
    stripes = (np.sin(9 * vertices[:, 0] + 2 * np.sin(3 * vertices[:, 2])) > 0.75)[:, None]
    return np.clip(np.where(stripes, colour * [0.35, 0.5, 0.9], colour), 0.03, 0.85).astype(np.float32)


def poses(count: int, first: float) -> list[np.ndarray]:
    """Camera-to-world [4, 4] of the Blender convention on a spiral from 25 degrees below the horizon to 75 above."""
    found = []
    for k in range(count):
        height = math.sin(math.radians(-25)) + (k + 0.5) / count * (
            math.sin(math.radians(75)) - math.sin(math.radians(-25))
        )
        turn = (k + first) * math.pi * (3 - math.sqrt(5)) + first
        level = math.sqrt(1 - height**2)
        back = np.array([level * math.cos(turn), level * math.sin(turn), height])
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3] = np.column_stack([right, np.cross(back, right), back, DISTANCE * back])
        found.append(pose)
    return found


def mitsuba_mesh(mi, vertices: np.ndarray, faces: np.ndarray, colours: np.ndarray):
    """The object as a Mitsuba mesh with smooth normals, colours at its vertices and some gloss."""
    bsdf = {
        "type": "principled",
        "base_color": {"type": "mesh_attribute", "name": "vertex_color"},
        "roughness": 0.4,
        "specular": 0.5,
    }
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    mesh = mi.Mesh("object", len(vertices), len(faces), has_vertex_normals=True, props=properties)
    mesh.add_attribute("vertex_color", 3, colours.reshape(-1))
    values = mi.traverse(mesh)
    values["vertex_positions"] = vertices.reshape(-1)
    values["faces"] = faces.astype(np.uint32).reshape(-1)
    values["vertex_color"] = colours.reshape(-1)
    values.update()
    mesh.recompute_vertex_normals()
    return mesh


def photograph(mi, mesh, pose: np.ndarray, size: int, spp: int, seed: int) -> np.ndarray:
    """float32 [size, size, 4], sRGB-encoded colour with straight alpha."""
    # Mitsuba's cameras look along +z with x to the left; its environment's up is +y
    to_world = mi.ScalarTransform4f((pose @ np.diag([-1.0, 1, -1, 1])).tolist())
    upright = mi.ScalarTransform4f().rotate([1, 0, 0], 90)
    film = {"type": "hdrfilm", "width": size, "height": size, "pixel_format": "rgba", "rfilter": {"type": "box"}}
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 5, "hide_emitters": True},
            "sensor": {
                "type": "perspective",
                "fov": math.degrees(FIELD),
                "to_world": to_world,
                "film": film,
                "sampler": {"type": "independent", "sample_count": spp},
            },
            "light": {"type": "envmap", "filename": str(SKY), "to_world": upright},
            "object": mesh,
        }
    )
    rgba = np.array(mi.render(scene, seed=seed, spp=spp))
    return encode_rgba(np.clip(rgba[..., :3], 0, None), np.clip(rgba[..., 3], 0, 1))


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.make_scene",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--size", type=int, default=256, help="pixels on a side")
    parser.add_argument("--views", type=int, default=48)
    parser.add_argument("--test-views", type=int, default=12)
    parser.add_argument("--spp", type=int, default=96, help="paths a pixel")
    parser.add_argument("--grid", type=int, default=224, help="samples along each axis of the distance field")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--quick", action="store_true", help="small and noisy")
    options = parser.parse_args()
    if options.quick:
        options.size, options.views, options.test_views, options.spp, options.grid = 64, 8, 2, 16, 96
    return options


if __name__ == "__main__":
    main()
