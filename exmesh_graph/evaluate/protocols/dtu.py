"""DTU's Chamfer distance in millimetres, by the protocol of jzhangbs/DTUeval-python, which 2DGS, PGSR and others run.

1. The mesh becomes points: its vertices and a grid inside each face about 0.2 mm apart, thinned in random order so that
   no two are closer than 0.2 mm. The published script draws that order without a seed; here it has one.
2. Of these, "inbound" points lie in the observability mask's box, widened by 60 mm below and 120 mm above; "in-obs"
   points are those inbound ones whose nearest voxel of the mask is set.
3. d2s: mean distance from in-obs points to the scan. s2d: mean distance from the scan's points above the table's plane
   to the inbound points (not only the in-obs ones). Distances of 20 mm and more are left out of both means.
4. The figure is their mean.

Quirk: papers differ in whether the mesh is culled first, so both figures are given. The rule here is that of 2DGS: a
vertex goes if it projects outside the mask, dilated by a disk of radius 24 pixels, of any view that has it in its
picture; a face stays if all three of its vertices do. PGSR ships with culling off, NeuS dilates by 50.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from exmesh_graph.errors import DataError, GeometryError
from exmesh_graph.evaluate.scores import benchmark_row, points_to_dataset
from exmesh_graph.io.meshes import read_points
from exmesh_graph.types import Frame, Mesh, Views

SPACING = 0.2  # mm
FARTHEST = 20.0  # mm
CULL_RADIUS = 24  # pixels of the 1600 x 1200 photographs
_BELOW, _ABOVE = 60.0, 120.0  # mm


@dataclass(frozen=True)
class DtuTruth:
    """What the benchmark's evaluation archive holds for a scan, in millimetres.

    points    float64 [N, 3], the scan
    observed  bool [X, Y, Z], the observability mask;  box float64 [2, 3] its corners;  voxel its spacing
    plane     float64 [4], above the table where plane . (x, y, z, 1) > 0
    """

    points: np.ndarray
    observed: np.ndarray
    box: np.ndarray
    voxel: float
    plane: np.ndarray


@dataclass(frozen=True)
class DtuDistance:
    """chamfer = (d2s + s2d) / 2 in mm, the points of mesh and scan, and the share of each that lies within the
    20 mm beyond which the means leave points out: a hole wider than that costs nothing else."""

    chamfer: float
    d2s: float
    s2d: float
    mesh_points: int
    scan_points: int
    mesh_counted: float
    scan_counted: float


def score_dtu(
    mesh: Mesh, frame: Frame, folder: Path, scan: int, views: Sequence[Views] = (), *, seed: int = 0
) -> dict[str, Any]:
    """DTU's Chamfer distance in mm, culled by the views' masks (where they have any) and unculled.

    The row's figure is the culled one where it is known. DTU's photographs are 1600 pixels wide: the 24 pixels by which
    masks are dilated shrink with ours.
    """
    truth = read_truth(folder, scan)
    vertices = points_to_dataset(mesh.vertices, frame)
    values: dict[str, Any] = {"unculled": asdict(dtu_chamfer(vertices, mesh.faces, truth, seed=seed))}
    masked = [view for view in views if view.has_masks]
    if masked:
        masks = np.concatenate([view.alpha[view.masked] for view in masked])
        projections = np.concatenate([(v.intrinsics @ v.world_to_camera[:, :3])[v.masked] for v in masked])
        faces = cull(mesh.vertices, mesh.faces, masks, projections, radius=CULL_RADIUS * masked[0].width / 1600)
        values["culled"] = asdict(dtu_chamfer(vertices, faces, truth, seed=seed))
    best = values.get("culled", values["unculled"])
    row: dict[str, float | None] = {"CD": best["chamfer"], "vertices": float(len(mesh.vertices))}
    return values | benchmark_row("dtu", str(scan), row, {"CD": "lower", "vertices": ""})


def truth_files(folder: Path, scan: int) -> list[Path]:
    """The three files of a scan in `SampleSet/MVS Data` as published; DataError names the first that is missing."""
    folder = Path(folder)
    files = [
        folder / "Points" / "stl" / f"stl{scan:03d}_total.ply",
        folder / "ObsMask" / f"ObsMask{scan}_10.mat",
        folder / "ObsMask" / f"Plane{scan}.mat",
    ]
    for file in files:
        if not file.is_file():
            raise DataError(
                "the file of the DTU evaluation data does not exist", where=str(file),
                expected="Points/stl/stl024_total.ply, ObsMask/ObsMask24_10.mat, ObsMask/Plane24.mat (for scan 24)",
                fix="give the folder that holds Points/ and ObsMask/ (SampleSet.zip and Points.zip, unpacked together)",
            )  # fmt: skip
    return files


def read_truth(folder: Path, scan: int) -> DtuTruth:
    """Read a scan's truth. DataError for missing files or missing variables in them."""
    from scipy.io import loadmat

    scan_file, mask_file, plane_file = truth_files(folder, scan)
    try:
        mask, plane = loadmat(str(mask_file)), loadmat(str(plane_file))
        observed, box, voxel = (
            mask["ObsMask"].astype(bool),
            mask["BB"].astype(np.float64),
            float(mask["Res"].ravel()[0]),
        )
        p = plane["P"].astype(np.float64).ravel()
    except (KeyError, ValueError, TypeError, OSError) as error:
        raise DataError(
            f"the file cannot be read ({type(error).__name__}: {error})", where=f"{mask_file}, {plane_file.name}",
            expected="MATLAB files with ObsMask, BB, Res and P", fix="unpack the evaluation data again",
        ) from error  # fmt: skip
    if observed.ndim != 3 or box.shape != (2, 3) or p.shape != (4,):
        raise DataError(f"ObsMask is {observed.shape}, BB {box.shape}, P {p.shape}", where=str(mask_file),
                        expected="three axes, (2, 3) and four numbers")  # fmt: skip
    return DtuTruth(read_points(scan_file), observed, box, voxel, p)


def dtu_chamfer(
    vertices: np.ndarray, faces: np.ndarray, truth: DtuTruth, *, spacing: float = SPACING, seed: int = 0
) -> DtuDistance:
    """The protocol above for a mesh (V [V, 3] in mm in DTU's world, F [F, 3]).

    Raises GeometryError where no point of mesh or scan is left to measure (a mesh in other units, for one).
    """
    points = thin(points_of_mesh(vertices, faces, spacing), spacing, seed)
    inbound = points[((points >= truth.box[0] - _BELOW) & (points < truth.box[1] + _ABOVE)).all(1)]
    observed = inbound[_observed(inbound, truth)]
    above = truth.points[truth.points @ truth.plane[:3] + truth.plane[3] > 0]
    if len(observed) == 0 or len(above) == 0:
        low, high = np.asarray(vertices).min(0), np.asarray(vertices).max(0)
        raise GeometryError(
            f"{len(observed)} points of the mesh lie in the observability mask, {len(above)} of the scan's above the "
            f"table; the mesh spans {np.round(low, 2).tolist()} to {np.round(high, 2).tolist()}",
            expected=f"millimetres in DTU's world, inside {truth.box.round(1).tolist()}",
            fix="apply scale_mat_0 to the mesh (data.idr's frame does)",
        )
    there, back = cKDTree(truth.points).query(observed)[0], cKDTree(inbound).query(above)[0]
    d2s, s2d = _mean_below(there), _mean_below(back)
    counted = (float((distance < FARTHEST).mean()) for distance in (there, back))
    return DtuDistance((d2s + s2d) / 2, d2s, s2d, len(observed), len(above), *counted)


def cull(
    vertices: np.ndarray, faces: np.ndarray, masks: np.ndarray, projections: np.ndarray, *, radius: float = CULL_RADIUS
) -> np.ndarray:
    """Faces [K, 3] that stay by 2DGS's rule; masks [N, H, W] (> 0.5 is the object), projections [N, 3, 4] to pixels.

    `radius` is in pixels of `masks`: scale it with them. Raises GeometryError if no face is left.
    """
    stays = np.ones(len(vertices), bool)
    points = np.c_[np.asarray(vertices, np.float64), np.ones(len(vertices))]
    for mask, projection in zip(masks, projections, strict=True):
        height, width = mask.shape
        x, y, w = points @ projection.T[:, 0], points @ projection.T[:, 1], points @ projection.T[:, 2]
        column, row = np.floor(x / w), np.floor(y / w)
        inside = (w > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        dilated = distance_transform_edt(mask <= 0.5) <= radius if (mask > 0.5).any() else mask > 0.5
        stays[inside] &= dilated[row[inside].astype(int), column[inside].astype(int)]
    kept = faces[stays[faces].all(1)]
    if len(kept) == 0:
        raise GeometryError("culling by the masks leaves no face", fix="check that masks and cameras belong together")
    return kept


def points_of_mesh(vertices: np.ndarray, faces: np.ndarray, spacing: float) -> np.ndarray:
    """Vertices that a face uses and a grid inside each face, float64 [P, 3].

    With edges e1, e2 of lengths l1, l2 at a corner, the step is spacing sqrt(l1 l2 / |e1 x e2|), which makes the
    grid as dense on slanted faces; n_i = floor(l_i / step) cells along e_i, points at the middles of the cells,
    those with coordinates summing to less than 1. Faces smaller than a step give their vertices only.
    """
    vertices = np.asarray(vertices, np.float64)
    origin, first, second = (vertices[faces[:, k]] for k in range(3))
    first, second = first - origin, second - origin
    l1, l2 = np.linalg.norm(first, axis=1), np.linalg.norm(second, axis=1)
    area = np.linalg.norm(np.cross(first, second), axis=1)
    solid = area > 0
    step = spacing * np.sqrt(l1 * l2 / np.where(solid, area, 1))
    n1, n2 = (np.where(solid, np.floor(length / np.where(step > 0, step, 1)), 0).astype(int) for length in (l1, l2))
    parts = [vertices[np.unique(faces)]]
    cells, group = np.unique(np.stack([n1, n2], 1), axis=0, return_inverse=True)
    order = np.argsort(group.ravel(), kind="stable")
    ends = np.cumsum(np.bincount(group.ravel(), minlength=len(cells)))
    for (a, b), begin, end in zip(cells, np.r_[0, ends[:-1]], ends, strict=True):
        if a == 0 or b == 0:
            continue
        u, v = np.meshgrid((np.arange(a) + 0.5) / a, (np.arange(b) + 0.5) / b, indexing="ij")
        inside = u + v < 1
        members, u, v = order[begin:end], u[inside], v[inside]
        grid = origin[members, None] + u[:, None] * first[members, None] + v[:, None] * second[members, None]
        parts.append(grid.reshape(-1, 3))
    return np.concatenate(parts)


def thin(points: np.ndarray, distance: float, seed: int, chunk: int = 250_000) -> np.ndarray:
    """The points that stay when they are visited in seeded random order and each removes all later ones within
    `distance`: float64 [K, 3], in that order.

    The same points as one visit after another gives (tested), a chunk at a time: those near a point kept from earlier
    chunks go; of the others, in rounds, each stays that comes first among its neighbours still undecided.
    """
    points = np.asarray(points, np.float64)[np.random.default_rng(seed).permutation(len(points))]
    kept: list[cKDTree] = []
    for start in range(0, len(points), chunk):
        part = points[start : start + chunk]
        for earlier in kept:
            near = earlier.query(part, distance_upper_bound=np.nextafter(distance, np.inf))[0] <= distance
            part = part[~near]
        if len(part):
            kept.append(cKDTree(part[_first_come(part, distance)]))
    return np.concatenate([tree.data for tree in kept]) if kept else points


def _first_come(points: np.ndarray, distance: float) -> np.ndarray:
    """bool [P]: stays when each point in order removes the later ones within `distance`."""
    stays, undecided = np.zeros(len(points), bool), np.ones(len(points), bool)
    pairs = cKDTree(points).query_pairs(distance, output_type="ndarray")  # each (lower, higher) index
    while undecided.any():
        late = np.zeros(len(points), bool)
        late[pairs[:, 1]] = True
        chosen = undecided & ~late
        stays |= chosen
        undecided &= ~chosen
        undecided[pairs[chosen[pairs[:, 0]], 1]] = False
        pairs = pairs[undecided[pairs].all(1)]
    return stays


def _observed(points: np.ndarray, truth: DtuTruth) -> np.ndarray:
    """bool [P]: whether the nearest voxel of the observability mask is set."""
    index = np.around((points - truth.box[0]) / truth.voxel).astype(int)
    inside = ((index >= 0) & (index < truth.observed.shape)).all(1)
    observed = np.zeros(len(points), bool)
    observed[inside] = truth.observed[tuple(index[inside].T)]
    return observed


def _mean_below(distances: np.ndarray) -> float:
    close = distances[distances < FARTHEST]
    if len(close) == 0:
        raise GeometryError(f"no distance is below {FARTHEST:g} mm", fix="check the mesh's units and position")
    return float(close.mean())
