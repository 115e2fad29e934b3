"""The sample of photographs (graphs/samples/photos) against its truth: cameras and surface.

    exmesh run graphs/photos.yaml && python -m benchmarks.photo_sample [--run runs/latest] [--sample FOLDER] [--steps]

--steps follows the surface: the coarse start, after each round, the end of Stage I, the asset. `inside` is how far it
lies inside the true one on average, `pits` what 95 % of it are nearer than.

Cameras and surface are found up to a similarity (Umeyama, PAMI 1991, eq. 40 to 42). It is fitted from the cameras'
places, and for the surface refined by nearest points (ICP), so that its figures tell of its shape. The surface counts
where photographs can show it: higher than a fiftieth of the object's radius above the table.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

import exmesh_graph as ex
from benchmarks.photos import similarity
from exmesh_graph.evaluate.metrics.distance import distance_to_mesh
from exmesh_graph.evaluate.metrics.mesh import bounding_radius
from exmesh_graph.native import import_open3d
from exmesh_graph.types import Mesh

SAMPLE = Path(__file__).parent.parent / "graphs" / "samples" / "photos"
ABOVE = 0.02  # of the radius
_ENDS = (("end", "settle", "state"), ("asset", "retouch", "asset"))
_SURFACE = ("chamfer", "accuracy", "completeness", "inside", "pits")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path, default=Path("runs/latest"))
    parser.add_argument("--sample", type=Path, default=SAMPLE, help="of benchmarks.scenes.photographs")
    parser.add_argument("--steps", action="store_true", help="figures of the start, each round, the end and the asset")
    options = parser.parse_args()
    run = ex.open_run(options.run)
    if not options.steps:
        for name, value in against_truth(run, options.sample).items():
            print(f"{name:22} {value:.3g}")
        return
    print(f"{'':10} {'faces':>7} " + " ".join(f"{name:>12}" for name in _SURFACE))
    for name, mesh in steps(run):
        figures = against_truth(run, options.sample, mesh)
        print(f"{name:10} {len(mesh.faces):7d} " + " ".join(f"{figures[one]:12.2f}" for one in _SURFACE), flush=True)


def steps(run: ex.Run) -> Iterator[tuple[str, Mesh]]:
    """Name and surface of the run's coarse start, of each round of Stage I, of its end, and of the asset."""
    yield "start", run["coarse"]["mesh"]
    for number in itertools.count(1):
        try:
            state = run[f"rounds[{number}].refine"]["state"]
        except KeyError:  # no further round
            break
        yield f"round {number}", state
    for name, node, port in _ENDS:
        with contextlib.suppress(KeyError):  # a run up to there
            yield name, run[node][port]


def against_truth(run: ex.Run, sample: Path = SAMPLE, mesh: Mesh | None = None) -> dict[str, float]:
    """Figures of a run of graphs/photos.yaml on the sample: of the surface it ended with, or of another `mesh` of it.

    Optical axes in degrees, centres in per cent of their mean distance from their middle (as `benchmarks.photos` does),
    the surface in thousandths of its radius.
    """
    views, mesh = run["views"]["train"], list(steps(run))[-1][1] if mesh is None else mesh
    truth = json.loads((sample / "truth" / "cameras.json").read_text(encoding="utf-8"))["camera_to_world"]
    cameras = np.array([truth[f"{Path(name).stem}.jpg"] for name in views.names]) @ np.diag([1.0, -1, -1, 1])
    scale, rotation, offset = similarity(views.camera_to_world[:, :3, 3], cameras[:, :3, 3])
    found = scale * views.camera_to_world[:, :3, 3] @ rotation.T + offset
    apart = np.linalg.norm(cameras[:, :3, 3] - cameras[:, :3, 3].mean(0), axis=1).mean()
    off = 100 * np.linalg.norm(found - cameras[:, :3, 3], axis=1) / apart
    along = np.einsum("ij,nj,ni->n", rotation, views.camera_to_world[:, :3, 2], cameras[:, :3, 2])
    angles = np.degrees(np.arccos(np.clip(along, -1, 1)))  # of the optical axes: a picture may be stored turned
    o3d = import_open3d()
    true = o3d.io.read_triangle_mesh(str(sample / "truth" / "object.ply"))
    true_points, true_faces = np.asarray(true.vertices), np.asarray(true.triangles)
    radius = bounding_radius(true_points)
    floor = true_points[:, 2].min() + ABOVE * radius
    points = scale * np.asarray(mesh.vertices, np.float64) @ rotation.T + offset
    points = _nearer(points, np.asarray(mesh.faces), true_points, true_faces, floor)
    ours = _seen(points, mesh.faces, floor, 0)
    theirs = _seen(true_points, true_faces, floor, 1)
    accuracy = distance_to_mesh(ours, true_points, true_faces)
    completeness = distance_to_mesh(theirs, points, mesh.faces)
    return {
        "photographs": len(views),
        "direction, median": float(np.median(angles)),
        "direction, most": float(angles.max()),
        "centre %, median": float(np.median(off)),
        "centre %, most": float(off.max()),
        "accuracy": 1000 / radius * float(accuracy.mean()),
        "completeness": 1000 / radius * float(completeness.mean()),
        "chamfer": 1000 / radius * float(accuracy.mean() + completeness.mean()) / 2,
        "inside": 1000 / radius * float(_inside(ours, true).mean()),
        "pits": 1000 / radius * float(np.quantile(accuracy, 0.95)),
    }


def _nearer(
    points: np.ndarray, faces: np.ndarray, true_points: np.ndarray, true_faces: np.ndarray, floor: float
) -> np.ndarray:
    """`points` moved, turned and scaled until their surface lies nearest to the true one (where that can be seen)."""
    aims = _seen(true_points, true_faces, floor, 2)
    tree = cKDTree(aims)
    for _ in range(40):
        ours = _seen(points, faces, floor, 0)
        far, nearest = tree.query(ours)
        kept = far <= np.quantile(far, 0.9)
        scale, rotation, offset = similarity(ours[kept], aims[nearest[kept]])
        points = scale * points @ rotation.T + offset
    return points


def _inside(points: np.ndarray, true: object) -> np.ndarray:
    """Signed distance of points [P, 3] to Open3D's mesh, positive inside it."""
    o3d = import_open3d()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(true))
    return -scene.compute_signed_distance(o3d.core.Tensor(points.astype(np.float32))).numpy()


def _seen(points: np.ndarray, faces: Sequence | np.ndarray, floor: float, seed: int) -> np.ndarray:
    from exmesh_graph.geometry.surface import sample_surface

    on, _, _ = sample_surface(points, np.asarray(faces), 20_000, seed)
    return on[on[:, 2] > floor]


if __name__ == "__main__":
    main()
