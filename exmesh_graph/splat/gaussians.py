"""The parameters of planar Gaussians, as they are optimised, and the harmonics of their colour."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import torch

from exmesh_graph.types import PlanarGaussians

SH_DEGREE = 3


@dataclass
class Gaussians:
    """G planar Gaussians; tensors of one float type on one device.

    means       [G, 3] world positions
    scales      [G, 3] logarithms of the standard deviations; the smallest one is the plane's thickness
    rotations   [G, 4] quaternions (w, x, y, z), of any length but 0
    opacities   [G] logits
    sh          [G, K, 3] spherical harmonics of display colour less 1/2, K = 1, 4, 9 or 16 for degree 0 to 3
    """

    means: torch.Tensor
    scales: torch.Tensor
    rotations: torch.Tensor
    opacities: torch.Tensor
    sh: torch.Tensor

    @classmethod
    def of(cls, artifact: PlanarGaussians, device: torch.device | str = "cpu") -> Gaussians:
        """The wire's arrays as tensors of their own, which may be changed."""
        return cls(**{field.name: torch.tensor(getattr(artifact, field.name), device=device) for field in fields(cls)})

    def __len__(self) -> int:
        return len(self.means)

    @property
    def degree(self) -> int:
        """Degree of the stored harmonics."""
        return {1: 0, 4: 1, 9: 2, 16: 3}[self.sh.shape[1]]

    def tensors(self) -> dict[str, torch.Tensor]:
        """The parameters by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def map(self, change: Callable[[torch.Tensor], torch.Tensor]) -> Gaussians:
        """New Gaussians of `change` applied to each parameter."""
        return Gaussians(**{name: change(tensor) for name, tensor in self.tensors().items()})

    def normals(self) -> torch.Tensor:
        """[G, 3], the axis of the smallest scale in world axes; its sign means nothing."""
        shortest = self.scales.argmin(dim=1)
        return rotation_matrices(self.rotations)[torch.arange(len(self), device=shortest.device), :, shortest]


def rotation_matrices(quaternions: torch.Tensor) -> torch.Tensor:
    """[G, 3, 3] of quaternions [G, 4] (w, x, y, z) of any length but 0."""
    w, x, y, z = torch.nn.functional.normalize(quaternions, dim=1).unbind(1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, dim=1).view(-1, 3, 3)


def harmonics(direction: torch.Tensor) -> torch.Tensor:
    """[G, 16] real harmonics to degree 3 at unit directions [G, 3]; (l, m) in order, Condon-Shortley signs."""
    x, y, z = direction.unbind(1)
    pi = torch.pi
    return torch.stack(
        [
            torch.full_like(x, (1 / (4 * pi)) ** 0.5),
            *((3 / (4 * pi)) ** 0.5 * t for t in (-y, z, -x)),
            (15 / (4 * pi)) ** 0.5 * x * y,
            -((15 / (4 * pi)) ** 0.5) * y * z,
            (5 / (16 * pi)) ** 0.5 * (2 * z * z - x * x - y * y),
            -((15 / (4 * pi)) ** 0.5) * x * z,
            (15 / (16 * pi)) ** 0.5 * (x * x - y * y),
            -((35 / (32 * pi)) ** 0.5) * y * (3 * x * x - y * y),
            (105 / (4 * pi)) ** 0.5 * x * y * z,
            -((21 / (32 * pi)) ** 0.5) * y * (4 * z * z - x * x - y * y),
            (7 / (16 * pi)) ** 0.5 * z * (2 * z * z - 3 * x * x - 3 * y * y),
            -((21 / (32 * pi)) ** 0.5) * x * (4 * z * z - x * x - y * y),
            (105 / (16 * pi)) ** 0.5 * z * (x * x - y * y),
            -((35 / (32 * pi)) ** 0.5) * x * (x * x - 3 * y * y),
        ],
        dim=1,
    )
