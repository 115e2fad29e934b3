"""How right the rasteriser's gradients are: analytic areas, finely sampled pictures, Mitsuba 3.

    python -m benchmarks.raster_gradients                       # all three; Mitsuba only where it is installed
    python -m benchmarks.raster_gradients --quick --json gradients.json

Mitsuba 3 comes with `pip install exmesh-graph[bench]` and needs LLVM's shared library (DRJIT_LIBLLVM_PATH).

1. dA/dr of a disc and of a sphere, from 100 to 0.4 pixels a face, against the exact area of their outlines.
2. Directional derivatives on random scenes of parts that hide each other, against central differences of pictures
   sampled --fine squared times a pixel: |g - g'| / |g'| over all scenes and directions.
3. One scene of bodies that shine by themselves in the colours of their vertices: the gradient of weighted pictures in
   all vertex positions, against Mitsuba's `direct_projective` with box-filtered pixels; in smooth directions, and
   vertex by vertex, beside the distance of two Mitsuba runs with different seeds.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.stability.scenes import (
    at_scale,
    camera,
    coverage,
    derivatives,
    disc,
    icosphere,
    random_bodies,
    random_layers,
    smooth_field,
    smooth_image,
)
from exmesh_graph.raster import project

Result = dict[str, Any]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=192, help="pixels along a side of the random scenes")
    parser.add_argument("--scenes", type=int, default=8)
    parser.add_argument("--fine", type=int, default=3)
    parser.add_argument("--mitsuba-size", type=int, default=128)
    parser.add_argument("--spp", type=int, default=128, help="Mitsuba's samples a pixel")
    parser.add_argument("--quick", action="store_true", help="fewer and smaller scenes: under half a minute")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.quick:
        options.size, options.scenes, options.fine, options.mitsuba_size, options.spp = 128, 3, 2, 64, 32
    torch.set_num_threads(1)
    rows = [*areas(), *random_scenes(options.size, options.scenes, options.fine)]
    if importlib.util.find_spec("mitsuba") is None:
        print("Mitsuba 3 is not installed: no comparison with it (pip install exmesh-graph[bench])")
    else:
        rows += against_mitsuba(options.mitsuba_size, options.spp)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def areas() -> list[Result]:
    rows: list[Result] = []
    size, step = 200, 1e-4
    intrinsics, pose = camera(size, size)
    for shape in ("disc", "sphere"):
        for level in range(5):
            vertices, faces = disc(5 * 2**level) if shape == "disc" else icosphere(level + 2)
            radius = torch.tensor(0.9, requires_grad=True)
            area = coverage(vertices.float() * radius, faces, intrinsics, pose, size, size).sum()
            area.backward()
            exact = outline_area(vertices * 0.9, intrinsics, pose)
            ends = [outline_area(vertices * (0.9 + s), intrinsics, pose) for s in (step, -step)]
            slope = (ends[0] - ends[1]) / (2 * step)
            share = 1.0 if shape == "disc" else 0.5  # half of the sphere's faces are seen
            row = {
                "what": f"dA/dr of a {shape}",
                "faces": len(faces),
                "pixels_per_face": exact / (share * len(faces)),
                "area_error": float(area.detach()) / exact - 1,
                "gradient_error": float(radius.grad) / slope - 1,
            }
            rows.append(row)
            print(
                f"{row['what']:18s} {len(faces):7d} faces  {row['pixels_per_face']:7.2f} pixels a face"
                f"  area {row['area_error']:+.1e}  gradient {100 * row['gradient_error']:+.2f} %"
            )
    return rows


def outline_area(vertices: torch.Tensor, intrinsics: torch.Tensor, pose: torch.Tensor) -> float:
    """Exact image area of a convex body."""
    from scipy.spatial import ConvexHull

    projected = project(vertices, intrinsics, pose)
    return ConvexHull((projected[:, :2] / projected[:, 2:]).numpy()).volume


def random_scenes(size: int, count: int, fine: int) -> list[Result]:
    rows: list[Result] = []
    for kind in ("bodies", "triangles"):
        analytic, numeric = [], []
        for seed in range(count):
            scene = random_bodies(seed, (1, 2, 4)[seed % 3]) if kind == "bodies" else random_layers(seed)
            vertices, faces, colours, owner = scene
            intrinsics, pose = camera(size, size, turn=0.2 * seed - 0.3, shift=(5.0, -3.0))

            def draw(v, scale, faces=faces, colours=colours, intrinsics=intrinsics, pose=pose):
                k = at_scale(intrinsics, scale)
                return coverage(v, faces, k, pose, scale * size, scale * size, colours)

            pair = derivatives(draw, vertices, owner, seed, size, fine)
            analytic.append(pair[0])
            numeric.append(pair[1])
        a, n = torch.cat(analytic), torch.cat(numeric)
        error = ((a - n).norm(dim=0) / n.norm(dim=0)).tolist()
        slope = ((a * n).sum(0) / n.square().sum(0)).tolist()
        rows.append({"what": f"random {kind}", "scenes": count, "size": size, "coverage": error[0], "colour": error[1]})
        print(
            f"random {kind:10s} {count} scenes of {size}^2: coverage {100 * error[0]:.1f} %,"
            f" colour {100 * error[1]:.1f} % (slopes {slope[0]:.3f}, {slope[1]:.3f})"
        )
    return rows


def against_mitsuba(size: int, spp: int) -> list[Result]:
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    vertices, faces, colours, owner = random_bodies(3, 2)
    _, pose = camera(size, size, turn=0.2)
    focal = 1.37 * size
    intrinsics = torch.tensor([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]], dtype=torch.float64)
    start = vertices.clone().requires_grad_()
    image = coverage(start, faces, intrinsics, pose, size, size, colours)[..., 1:]
    ours, theirs, repeat, ours_all, theirs_all, repeat_all = [], [], [], [], [], []
    with tempfile.TemporaryDirectory() as folder:
        scene = mitsuba_scene(mi, Path(folder), vertices, faces, colours, focal, pose, size, spp)
        picture = np.array(mi.render(scene, spp=4 * spp))
        for s in range(6):
            weight = smooth_image(size, size, 3, s + 100)
            (gradient,) = torch.autograd.grad((image * weight).sum(), start, retain_graph=True)
            reference, again = (mitsuba_gradient(mi, scene, weight, spp, seed) for seed in (2 * s, 2 * s + 1))
            parts = torch.nn.functional.one_hot(owner, 5)[:, :3].double() * 3
            field = smooth_field(vertices, s) + smooth_field(parts, s + 50)
            for g, one, every in (
                (gradient, ours, ours_all),
                (reference, theirs, theirs_all),
                (again, repeat, repeat_all),
            ):
                one.append(float((g * field).sum()))
                every.append(g)

    def distance(a: list, b: list) -> float:
        a, b = (torch.stack(x) if isinstance(x[0], torch.Tensor) else torch.tensor(x) for x in (a, b))
        return float((a - b).norm() / b.norm())

    row = {
        "what": "Mitsuba 3 direct_projective",
        "version": mi.__version__,
        "size": size,
        "spp": spp,
        "picture": float(np.abs(picture - image.detach().numpy()).mean() / picture.mean()),
        "directions": distance(ours, theirs),
        "directions_repeat": distance(repeat, theirs),
        "vertices": distance(ours_all, theirs_all),
        "vertices_repeat": distance(repeat_all, theirs_all),
    }
    print(
        f"Mitsuba {mi.__version__} direct_projective, {size}^2, {spp} spp:"
        f" picture differs by {100 * row['picture']:.2f} %;"
        f" gradient in smooth directions by {100 * row['directions']:.1f} % (two Mitsuba seeds:"
        f" {100 * row['directions_repeat']:.1f} %), vertex by vertex by {100 * row['vertices']:.1f} %"
        f" ({100 * row['vertices_repeat']:.1f} %)"
    )
    return [row]


def mitsuba_scene(
    mi: Any,
    folder: Path,
    vertices: torch.Tensor,
    faces: torch.Tensor,
    colours: torch.Tensor,
    focal: float,
    pose: torch.Tensor,
    size: int,
    spp: int,
) -> Any:
    """The bodies as emitters with vertex colours before black, seen through box-filtered pixels."""
    mesh = mi.Mesh("bodies", vertex_count=len(vertices), face_count=len(faces))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = vertices.numpy().astype(np.float32).ravel()
    parameters["faces"] = faces.numpy().astype(np.uint32).ravel()
    parameters.update()
    mesh.add_attribute("vertex_color", 3, colours.numpy().astype(np.float32).ravel())
    path = folder / "bodies.ply"
    mesh.write_ply(str(path))
    # Mitsuba's camera has x to the left and y up
    to_world = torch.linalg.inv(pose).numpy() @ np.diag([-1.0, -1, 1, 1])
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct_projective", "sppc": spp, "sppp": spp, "sppi": 0},
            "sensor": {
                "type": "perspective",
                "fov_axis": "x",
                "fov": math.degrees(2 * math.atan(size / 2 / focal)),
                "near_clip": 0.01,
                "far_clip": 100.0,
                "to_world": mi.ScalarTransform4f(to_world),
                "film": {
                    "type": "hdrfilm",
                    "width": size,
                    "height": size,
                    "rfilter": {"type": "box"},
                    "pixel_format": "rgb",
                    "sample_border": True,
                },
            },
            "bodies": {
                "type": "ply",
                "filename": str(path),
                "face_normals": True,
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}},
                "emitter": {"type": "area", "radiance": {"type": "mesh_attribute", "name": "vertex_color"}},
            },
        }
    )


def mitsuba_gradient(mi: Any, scene: Any, weight: torch.Tensor, spp: int, seed: int) -> torch.Tensor:
    """Gradient [V, 3] of sum(weight * picture) in the vertex positions."""
    import drjit as dr

    parameters = mi.traverse(scene)
    key = "bodies.vertex_positions"
    dr.enable_grad(parameters[key])
    parameters.update()
    picture = mi.render(scene, parameters, spp=spp, spp_grad=spp, seed=seed, seed_grad=seed + 1000)
    dr.backward(dr.sum(picture * mi.TensorXf(weight.numpy().astype(np.float32)), axis=None))
    gradient = torch.tensor(np.array(dr.grad(parameters[key])).reshape(-1, 3)).double()
    dr.disable_grad(parameters[key])
    return gradient


if __name__ == "__main__":
    main()
