"""Gaussians as PLY files in the layout that 3DGS viewers and tools share, and moved from one world to another.

Vertex properties, all float: x y z, nx ny nz (unused), f_dc_0..2, f_rest_0.. (harmonics above degree 0, all of red
first), opacity (logit), scale_0..2 (logarithms), rot_0..3 (w, x, y, z).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from exmesh_graph.errors import DataError
from exmesh_graph.io.meshes import read_vertex_table
from exmesh_graph.splat.gaussians import Gaussians, harmonics

_REST = {0: 1, 9: 4, 24: 9, 45: 16}


def write_gaussians(path: Path, gaussians: Gaussians) -> None:
    """Write a binary little-endian PLY of float32."""
    g = gaussians.map(lambda t: t.detach().cpu().float())
    rest = g.sh[:, 1:].transpose(1, 2).reshape(len(g), -1)
    columns = [g.means, torch.zeros_like(g.means), g.sh[:, 0], rest, g.opacities[:, None], g.scales, g.rotations]
    names = ["x", "y", "z", "nx", "ny", "nz", *(f"f_dc_{i}" for i in range(3)),
             *(f"f_rest_{i}" for i in range(rest.shape[1])), "opacity", *(f"scale_{i}" for i in range(3)),
             *(f"rot_{i}" for i in range(4))]  # fmt: skip
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(g)}"]
    header += [f"property float {name}" for name in names] + ["end_header", ""]
    table = torch.cat(columns, dim=1).numpy().astype("<f4")
    Path(path).write_bytes("\n".join(header).encode() + table.tobytes())


def read_gaussians(path: Path) -> Gaussians:
    """Gaussians of a binary PLY, properties in any order, others ignored.

    Raises DataError for a file that is missing, cut short, not binary, without the properties, or not finite.
    """
    table = read_vertex_table(path)
    names = table.dtype.names or ()
    rest = sum(name.startswith("f_rest_") for name in names)
    needed = ["x", "y", "z", *(f"f_dc_{i}" for i in range(3)), "opacity", *(f"scale_{i}" for i in range(3)),
              *(f"rot_{i}" for i in range(4))]  # fmt: skip
    missing = [name for name in needed if name not in names]
    if missing or rest not in _REST:
        raise DataError(
            f"not Gaussians: {'no ' + ', '.join(missing) if missing else f'{rest} f_rest properties'}",
            where=str(path), expected="the vertex properties of 3DGS: x y z f_dc_* f_rest_* opacity scale_* rot_*",
            fix="export it as a 3DGS PLY, not as a mesh or a compressed file",
        )  # fmt: skip

    def columns(*names: str) -> torch.Tensor:
        return torch.from_numpy(np.stack([table[name].astype(np.float32) for name in names], axis=1))

    sh = columns(*(f"f_dc_{i}" for i in range(3)))[:, None]
    if rest:
        higher = columns(*(f"f_rest_{i}" for i in range(rest))).view(len(table), 3, -1).transpose(1, 2)
        sh = torch.cat([sh, higher], dim=1)
    made = Gaussians(
        columns("x", "y", "z"), columns("scale_0", "scale_1", "scale_2"), columns("rot_0", "rot_1", "rot_2", "rot_3"),
        columns("opacity")[:, 0], sh.contiguous(),
    )  # fmt: skip
    bad = [name for name, t in made.tensors().items() if not bool(torch.isfinite(t).all())]
    if bad:
        raise DataError(f"{', '.join(bad)} hold NaN or Inf", where=str(path), fix="export it again without them")
    return made


def transformed(gaussians: Gaussians, similarity: np.ndarray) -> Gaussians:
    """The Gaussians in another world: points x become (s R) x + t of the 4 x 4 `similarity`, harmonics turn along."""
    matrix = torch.from_numpy(np.asarray(similarity, np.float64))
    scale = float(torch.linalg.det(matrix[:3, :3]) ** (1 / 3))
    turn = matrix[:3, :3] / scale
    double = gaussians.map(lambda t: t.detach().cpu().double())
    # a function f(d) becomes f(R^T d), which harmonics of the same degree hold exactly: solved at fixed directions
    at = torch.nn.functional.normalize(torch.randn(64, 3, generator=torch.Generator().manual_seed(0)).double(), dim=1)
    count = gaussians.sh.shape[1]
    mixing = torch.linalg.lstsq(harmonics(at)[:, :count], harmonics(at @ turn)[:, :count]).solution
    quaternion = torch.from_numpy(np.roll(Rotation.from_matrix(turn.numpy()).as_quat(), 1))  # scipy has w last
    new = Gaussians(
        double.means @ matrix[:3, :3].T + matrix[:3, 3], double.scales + np.log(scale),
        _product(quaternion, double.rotations), double.opacities,
        torch.einsum("kj,gjc->gkc", mixing, double.sh),
    )  # fmt: skip
    return new.map(lambda t: t.to(gaussians.means).contiguous())


def _product(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Quaternion a [4] times each of b [G, 4]."""
    w, x, y, z = b.unbind(1)
    return torch.stack(
        [
            a[0] * w - a[1] * x - a[2] * y - a[3] * z,
            a[0] * x + a[1] * w + a[2] * z - a[3] * y,
            a[0] * y - a[1] * z + a[2] * w + a[3] * x,
            a[0] * z + a[1] * y - a[2] * x + a[3] * w,
        ],
        dim=1,
    )
