"""Rows of meshes: normals and curvature of degenerate faces, topology operations, regularisers, fusion."""

from __future__ import annotations

import time

import numpy as np
import torch

from benchmarks.meshes import grid, torus
from benchmarks.stability.scenes import camera
from benchmarks.stability.table import Reached, elsewhere, row
from exmesh_graph.geometry.shapes import icosphere

elsewhere("mesh", "Adam's moments after a change of topology", "loss spike < 10 %", "tests/stage1/test_stage1_rules.py")
elsewhere("mesh", "min-max normalisation of a flat image's gradient (PGSR's weight)", "NaN", "the PGSR initialisation")
elsewhere("mesh", "TSDF from quantised depth; bottom unseen", "holes", "tests/geometry/test_tsdf.py")


@row("mesh", "acos at 1: curvature of coplanar, folded, right-angled and empty faces", "largest error, rad", high=1e-6)
def curvature() -> Reached:
    from exmesh_graph.geometry.split import face_curvature

    base = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    third = {0.0: [1, 1, 0], np.pi / 2: [0.5, 0.5, np.sqrt(0.5)], np.pi: [0.1, 0.1, 0.0]}
    faces = np.array([[0, 1, 2], [2, 1, 3]])
    errors = []
    for angle, corner in third.items():
        vertices = np.concatenate([base, np.array([corner], np.float32)])
        errors.append(np.abs(face_curvature(vertices, faces) - angle).max())
    flat, flat_faces = grid(8, 8)
    errors.append(np.abs(face_curvature(flat, flat_faces)).max())
    empty = np.concatenate([base, base[:1]])
    errors.append(np.abs(face_curvature(empty, np.array([[0, 1, 2], [2, 1, 1], [0, 1, 3]]))).max())
    return Reached(float(max(errors)))


@row("mesh", "vertex normals at slivers, needles and vertices without faces", "normals not finite", high=0)
def normals() -> Reached:
    from exmesh_graph.geometry.adjacency import angle_weighted_normals

    vertices, faces = icosphere(2)
    vertices = np.concatenate([vertices, [[9.0, 9, 9]]]).astype(np.float32)
    vertices[faces[3, 1]] = vertices[faces[3, 0]]
    vertices[faces[40, 1]] = vertices[faces[40, 0]] + np.float32(1e-7)
    return Reached(float((~np.isfinite(angle_weighted_normals(vertices, faces))).sum()))


@row(
    "mesh", "1000 random splits and collapses", "non-manifold edges, vertices, Euler changes, folds", high=0, slow=True
)
def fuzz() -> Reached:
    from benchmarks.meshes import is_vertex_manifold, is_winding_consistent
    from exmesh_graph.geometry.adjacency import euler_characteristic, face_normals
    from exmesh_graph.geometry.merge import merge
    from exmesh_graph.geometry.settings import MergeSettings
    from exmesh_graph.geometry.split import split
    from exmesh_graph.types.edges import is_closed, is_edge_manifold
    from exmesh_graph.uv.unwrap import unwrap

    wrong = operations = 0
    eager = MergeSettings(degenerate=0.9, area_quantile=1.0)
    for shape, genus in ((icosphere(2), 0), (torus(12, 6), 1)):
        mesh = (*shape, *unwrap(*shape, 256))
        rng = np.random.default_rng(7)
        for turn in range(10):
            done = split(*mesh, rng.random(len(mesh[0])), int(1.4 * len(mesh[1])), seed=turn)
            operations += done.count
            mesh = (done.vertices, done.faces, done.uvs, done.uv_faces)
            done = merge(*mesh, (rng.random(len(mesh[1])) > 0.5).astype(int), eager.replaced(min_faces=20))
            operations += done.count
            # no face may turn over: each that stays keeps its normal within 90 degrees
            same = face_normals(done.vertices, done.faces), face_normals(mesh[0], mesh[1])[done.face_source]
            wrong += int((np.einsum("fk,fk->f", *same) <= 0).sum())
            mesh = (done.vertices, done.faces, done.uvs, done.uv_faces)
            faces = mesh[1]
            wrong += int(not is_edge_manifold(faces)) + int(not is_vertex_manifold(faces)) + int(not is_closed(faces))
            wrong += int(not is_winding_consistent(faces)) + int(euler_characteristic(faces) != 2 - 2 * genus)
    return Reached(float(wrong if operations >= 1000 else 1000))


@row("mesh", "5 % triple edges make charts explode (5120 faces)", "seconds of unwrap", high=10, slow=True)
def unwrap_crowded() -> Reached:
    from exmesh_graph.uv.unwrap import unwrap

    vertices, faces = icosphere(4)
    rng = np.random.default_rng(0)
    extra = faces[rng.choice(len(faces), len(faces) // 20, replace=False)]
    flaps = extra.copy()
    flaps[:, 2] = np.arange(len(extra)) + len(vertices)
    points = vertices[extra].mean(1) * 1.3
    began = time.process_time()
    uvs, _ = unwrap(np.concatenate([vertices, points]), np.concatenate([faces, flaps]), 512)
    seconds = time.process_time() - began
    return Reached(seconds if np.isfinite(uvs).all() else np.inf)


@row("mesh", "weights that depend on the scale: smoothness at scale 10 and 1e-3", "relative change", high=1e-5)
def smoothness_scale() -> Reached:
    from exmesh_graph.raster import edge_table
    from exmesh_graph.stage1.regularise import smoother, smoothness

    vertices, faces = icosphere(3)
    edges = edge_table(torch.from_numpy(faces.astype(np.int64))).edges
    noise = np.random.default_rng(0).normal(size=vertices.shape) * 0.02
    reached = []
    for dtype in (torch.float32, torch.float64):
        values = []
        for scale in (1.0, 10.0, 1e-3):
            v = torch.from_numpy((vertices + noise) * scale).to(dtype)
            values.append(float(smoothness(v, smoother(v, edges), "bilaplacian")))
        reached.append(max(abs(value / values[0] - 1) for value in values))
    return Reached(*reached)


@row("mesh", "Adam's first step from a gradient of 1e-12 and of 1e10", "step over the rate", low=0.99, high=1.01)
def first_step() -> Reached:
    from exmesh_graph.optim import adam_step

    reached = []
    for dtype in (torch.float32, torch.float64):
        lengths = []
        for size in (1e-12, 1e10):
            v = torch.zeros(1, 3, dtype=dtype)
            adam_step(v, torch.tensor([[size, 0, 0]], dtype=dtype), torch.zeros_like(v), v.new_zeros(1), 1, 0.01)
            lengths.append(float(v.norm()) / 0.01)
        reached.append(min(lengths) if abs(min(lengths) - 1) > abs(max(lengths) - 1) else max(lengths))
    return Reached(*reached)


@row("mesh", "fusion of exact depth from 20 views of a ball", "open edges, handles and pieces too many", high=0)
def fused_ball() -> Reached:
    from exmesh_graph.geometry.adjacency import boundary_edges, components, euler_characteristic
    from exmesh_graph.geometry.settings import TsdfSettings
    from exmesh_graph.geometry.tsdf import fuse
    from exmesh_graph.raster import rasterize
    from exmesh_graph.testing import look_at
    from exmesh_graph.types import DepthMaps, Views

    vertices, faces = icosphere(5)
    i = np.arange(20) + 0.5
    y, turn = 1 - i / 10, np.pi * (1 + 5**0.5) * i
    eyes = 3.5 * np.stack([np.cos(turn) * np.sqrt(1 - y * y), y, np.sin(turn) * np.sqrt(1 - y * y)], axis=1)
    intrinsics, _ = camera(96, 96, focal=150.0)
    depth, poses = [], []
    for eye in eyes:
        pose = look_at(eye)
        to_camera = torch.from_numpy(np.linalg.inv(pose))
        seen = rasterize(torch.from_numpy(0.7 * vertices), torch.from_numpy(faces), intrinsics, to_camera, 96, 96)
        depth.append(seen.depth.numpy())
        poses.append(pose)
    depth = np.stack(depth)
    names = tuple(f"view {k}" for k in range(20))
    views = Views(
        names=names,
        images=np.zeros((*depth.shape, 3), np.float32),
        alpha=(depth > 0).astype(np.float32),
        intrinsics=np.repeat(intrinsics.numpy()[None], 20, axis=0),
        camera_to_world=np.stack(poses),
        split="train",
    )
    _, f = fuse(views, DepthMaps(names, depth), TsdfSettings(resolution=64))
    pieces = int(components(f).max()) + 1
    return Reached(float(len(boundary_edges(f)) + abs(euler_characteristic(f) - 2 * pieces) + pieces - 1))
