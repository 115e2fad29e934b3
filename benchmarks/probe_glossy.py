"""Does the probe take glossy rubber for metal? A torus under other BRDFs than ours, path-traced by Mitsuba.

    pip install mitsuba
    python -m benchmarks.probe_glossy                       # rubber of three glosses by two BRDFs, and metal
    python -m benchmarks.probe_glossy --only rubber_0.3 --size 128

Disney's principled BSDF and rough plastic (a coat of index 1.5 over a diffuse base, with light that stays inside) on a
torus in two reds, 24 views of 8 bits under the sample's sky; the mesh is the true one. One line each: what the probe
decides about metal, and why.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch
from exmesh_nodes import uv

from benchmarks.stage2 import Quiet
from exmesh_graph.geometry.adjacency import angle_weighted_normals
from exmesh_graph.io.images import display
from exmesh_graph.stage2.probe.scene import probe_scene
from exmesh_graph.types import Mesh, Views

SKY = Path(__file__).parent.parent / "graphs" / "samples" / "chair" / "env_train.exr"
VIEWS, FOCAL, DISTANCE = 24, 1.4, 2.8
RED = {"type": "rgb", "value": [0.35, 0.06, 0.05]}
CASES = {
    "rubber_0.2": {"type": "principled", "base_color": RED, "roughness": 0.2, "specular": 0.5},
    "rubber_0.3": {"type": "principled", "base_color": RED, "roughness": 0.3, "specular": 0.8},
    "rubber_0.5": {"type": "principled", "base_color": RED, "roughness": 0.5, "specular": 0.5},
    "plastic": {"type": "roughplastic", "diffuse_reflectance": RED, "alpha": 0.06, "nonlinear": True},
    "dark_plastic": {
        "type": "roughplastic", "diffuse_reflectance": {"type": "rgb", "value": 0.02}, "alpha": 0.1,
    },
    "metal": {"type": "principled", "base_color": {"type": "rgb", "value": [0.8, 0.5, 0.3]}, "roughness": 0.3,
              "metallic": 1.0},
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=list(CASES), action="append")
    parser.add_argument("--size", type=int, default=96, help="side of the pictures")
    parser.add_argument("--samples", type=int, default=128, help="paths a pixel")
    options = parser.parse_args()
    torch.set_num_threads(1)
    vertices, faces = torus()
    carrier = uv.unwrap(Quiet(0), Mesh(vertices, faces), p=uv.UnwrapParams(texture_size=256)).carrier
    for name in options.only or CASES:
        views = photographed(vertices, faces, CASES[name], options.size, options.samples)
        found = probe_scene(carrier, views).needs.decisions["metallic"]
        print(f"{name:14s} {'metal' if found.value else 'no metal':9s} {found.reason}", flush=True)


def torus(around: int = 96, across: int = 40, radius: float = 0.6, tube: float = 0.26) -> tuple[np.ndarray, np.ndarray]:
    """Vertices float32 [around * across, 3] and faces int32 of a torus about the y axis."""
    u, v = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    a, b = 2 * np.pi * u.ravel() / around, 2 * np.pi * v.ravel() / across
    ring = radius + tube * np.cos(b)
    vertices = np.stack([ring * np.cos(a), tube * np.sin(b), ring * np.sin(a)], axis=1).astype(np.float32)
    at = u * across + v
    right, up, both = (np.roll(at, shift, axis).ravel() for shift, axis in ((-1, 0), (-1, 1), ((-1, -1), (0, 1))))
    at = at.ravel()
    faces = np.concatenate([np.stack([at, up, right], 1), np.stack([right, up, both], 1)]).astype(np.int32)
    return vertices, faces


def photographed(vertices: np.ndarray, faces: np.ndarray, bsdf: dict, size: int, samples: int) -> Views:
    """`VIEWS` pictures of 8 bits of the mesh from a spiral around it."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    mesh = mi.Mesh("torus", len(vertices), len(faces), has_vertex_normals=True, props=_bsdf_props(mi, bsdf))
    given = mi.traverse(mesh)
    given["vertex_positions"] = vertices.ravel()
    given["vertex_normals"] = angle_weighted_normals(vertices, faces).astype(np.float32).ravel()
    given["faces"] = faces.astype(np.uint32).ravel()
    given.update()
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 5, "hide_emitters": True},
            "sky": {"type": "envmap", "filename": str(SKY)},
            "torus": mesh,
        }
    )
    fov = 2 * np.degrees(np.arctan(0.5 / FOCAL))
    images, alphas, poses = [], [], []
    for k in range(VIEWS):
        pose = _pose(np.arcsin(1 - 1.9 * (k + 0.5) / VIEWS), 2.4 * k)
        film = {"type": "hdrfilm", "width": size, "height": size, "pixel_format": "rgba", "rfilter": {"type": "box"}}
        sensor = mi.load_dict(
            {
                "type": "perspective",
                "fov": float(fov),
                "to_world": mi.ScalarTransform4f((pose @ np.diag([-1.0, -1, 1, 1])).tolist()),
                "film": film,
            }
        )
        picture = np.array(mi.render(scene, sensor=sensor, spp=samples, seed=k), np.float32)
        alpha = picture[..., 3].clip(0, 1)
        straight = picture[..., :3] / np.maximum(alpha, 1e-6)[..., None]
        shown = np.round(display(straight, np.ones_like(alpha)).clip(0, 1) * 255) / 255
        linear = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
        images.append((linear * alpha[..., None]).astype(np.float32))
        alphas.append(alpha)
        poses.append(pose)
    matrix = np.array([[FOCAL * size, 0, size / 2], [0, FOCAL * size, size / 2], [0, 0, 1]])
    return Views(
        names=tuple(f"{k:03d}" for k in range(VIEWS)),
        images=np.stack(images),
        alpha=np.stack(alphas),
        intrinsics=np.repeat(matrix[None], VIEWS, axis=0),
        camera_to_world=np.stack(poses),
        split="train",
        clipped=True,
    )


def _bsdf_props(mi, bsdf: dict):  # type: ignore[no-untyped-def]
    props = mi.Properties()
    props["bsdf"] = mi.load_dict(bsdf)
    return props


def _pose(elevation: float, azimuth: float) -> np.ndarray:
    """Camera to world [4, 4], x right, y down, z ahead, `DISTANCE` from the origin and looking at it."""
    back = np.array([np.cos(elevation) * np.cos(azimuth), np.sin(elevation), np.cos(elevation) * np.sin(azimuth)])
    ahead = -back
    right = np.cross(ahead, [0, 1, 0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    pose[:3, 3] = DISTANCE * back
    return pose


if __name__ == "__main__":
    main()
