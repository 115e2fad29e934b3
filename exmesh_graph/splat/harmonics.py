"""Real spherical harmonics to degree 3, in plain torch."""

from __future__ import annotations

import torch


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
