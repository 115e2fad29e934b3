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
from scipy.optimize import least_squares
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import exmesh_graph as ex
from benchmarks.photos import similarity
from exmesh_graph.evaluate.metrics.distance import distance_to_mesh
from exmesh_graph.evaluate.metrics.mesh import bounding_radius
from exmesh_graph.native import import_open3d
from exmesh_graph.types import Mesh, Views

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
    """Name and surface of the run's coarse start, of each round of Stage I, of its end, and of the asset, up to where
    it was run."""
    with contextlib.suppress(KeyError):
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
    pixels by which each photograph shows the object beside where the true camera does, the surface in thousandths of
    its radius; of a run without one (`--until views`) there are figures of the cameras alone.
    """
    o3d = import_open3d()
    true = o3d.io.read_triangle_mesh(str(sample / "truth" / "object.ply"))
    true_points, true_faces = np.asarray(true.vertices), np.asarray(true.triangles)
    figures, (scale, rotation, offset) = _of_cameras(run["views"]["train"], sample, true_points)
    mesh = next((last for _, last in reversed(list(steps(run)))), None) if mesh is None else mesh
    if mesh is None:
        return figures
    radius = bounding_radius(true_points)
    floor = true_points[:, 2].min() + ABOVE * radius
    points = scale * np.asarray(mesh.vertices, np.float64) @ rotation.T + offset
    points = _nearer(points, np.asarray(mesh.faces), true_points, true_faces, floor)
    ours = _seen(points, mesh.faces, floor, 0)
    theirs = _seen(true_points, true_faces, floor, 1)
    accuracy = distance_to_mesh(ours, true_points, true_faces)
    completeness = distance_to_mesh(theirs, points, mesh.faces)
    return figures | {
        "accuracy": 1000 / radius * float(accuracy.mean()),
        "completeness": 1000 / radius * float(completeness.mean()),
        "chamfer": 1000 / radius * float(accuracy.mean() + completeness.mean()) / 2,
        "inside": 1000 / radius * float(_inside(ours, true).mean()),
        "pits": 1000 / radius * float(np.quantile(accuracy, 0.95)),
    }


def _of_cameras(
    views: Views, sample: Path, points: np.ndarray
) -> tuple[dict[str, float], tuple[float, np.ndarray, np.ndarray]]:
    """(figures, the similarity from the views' world to the true one)."""
    truth = json.loads((sample / "truth" / "cameras.json").read_text(encoding="utf-8"))["camera_to_world"]
    cameras = np.array([truth[f"{Path(name).stem}.jpg"] for name in views.names]) @ np.diag([1.0, -1, -1, 1])
    scale, rotation, offset = similarity(views.camera_to_world[:, :3, 3], cameras[:, :3, 3])
    found = scale * views.camera_to_world[:, :3, 3] @ rotation.T + offset
    apart = np.linalg.norm(cameras[:, :3, 3] - cameras[:, :3, 3].mean(0), axis=1).mean()
    off = 100 * np.linalg.norm(found - cameras[:, :3, 3], axis=1) / apart
    along = np.einsum("ij,nj,ni->n", rotation, views.camera_to_world[:, :3, 2], cameras[:, :3, 2])
    angles = np.degrees(np.arccos(np.clip(along, -1, 1)))  # of the optical axes: a picture may be stored turned
    pixels = _pixels(views, cameras, points, scale, rotation, offset)
    figures = {
        "photographs": len(views),
        "direction, median": float(np.median(angles)),
        "direction, most": float(angles.max()),
        "centre %, median": float(np.median(off)),
        "centre %, most": float(off.max()),
        "pixels, median": float(np.median(pixels)),
        "pixels, most": float(pixels.max()),
    }
    return figures, (scale, rotation, offset)


def _pixels(
    views: Views, cameras: np.ndarray, points: np.ndarray, scale: float, rotation: np.ndarray, offset: np.ndarray
) -> np.ndarray:
    """[N], the mean over the object's points, after the similarity of the world under which the squares are least."""
    points = points[np.random.default_rng(0).choice(len(points), min(400, len(points)), replace=False)]
    focal = views.intrinsics[:, 0, 0]

    def shown(poses: np.ndarray, at: np.ndarray) -> np.ndarray:
        local = np.einsum("nji,npj->npi", poses[:, :3, :3], at - poses[:, None, :3, 3])
        return focal[:, None, None] * local[..., :2] / local[..., 2:]

    def off(change: np.ndarray) -> np.ndarray:
        turn = Rotation.from_rotvec(change[:3]).as_matrix()
        return shown(views.camera_to_world, np.exp(change[3]) * ours @ turn.T + change[4:]) - true

    ours, straight = (points - offset) @ rotation / scale, shown(cameras, points)
    turns = [np.linalg.matrix_power(np.array([[0, -1], [1, 0]]), k) for k in range(4)]
    begun = shown(views.camera_to_world, ours)
    stored = [min(turns, key=lambda turn, k=k: np.abs(begun[k] - straight[k] @ turn).mean()) for k in range(len(views))]
    true = np.einsum("npi,nij->npj", straight, np.array(stored))  # a picture may be stored turned
    best = least_squares(lambda change: off(change).ravel(), np.zeros(7), loss="soft_l1")
    return np.linalg.norm(off(best.x), axis=2).mean(axis=1)


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
