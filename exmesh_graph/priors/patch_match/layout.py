"""Pictures and planes as the kernel takes them, and back: pixels of one parity or colour lie together (`native`)."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from exmesh_graph.gpu.simd import padded
from exmesh_graph.priors.patch_match.native import MARGIN, PAD

OUTSIDE = -1e4
NO_PIXEL = 1e9


@dataclass(frozen=True)
class Level:
    """N pictures of one size.

    reference  float32 [N, H + 2 MARGIN, 2, S], packed int32 [N, H, W], inside int32 [N, H, W]: layouts of `native`
    """

    height: int
    width: int
    reference: torch.Tensor
    packed: torch.Tensor
    inside: torch.Tensor

    @property
    def stride(self) -> int:
        return int(self.reference.shape[3])


def stride_of(width: int) -> int:
    """Floats of a row of pixels of one parity, with PAD of nothing on either side."""
    return padded((width + 1) // 2) + 2 * PAD


def level_of(grey: torch.Tensor, inside: torch.Tensor) -> Level:
    """Pictures `grey` float32 [N, H, W] in [0, 1] and masks bool [N, H, W]."""
    count, height, width = grey.shape
    levels = grey * 255
    reference = grey.new_full((count, height + 2 * MARGIN, 2, stride_of(width)), OUTSIDE)
    shown = torch.where(inside, levels, OUTSIDE)
    for parity in (0, 1):
        half = shown[:, :, parity::2]
        reference[:, MARGIN : MARGIN + height, parity, PAD : PAD + half.shape[2]] = half
    bytes_ = levels.round().clamp(0, 255).to(torch.int32)
    right = torch.cat([bytes_[:, :, 1:], bytes_[:, :, -1:]], dim=2)
    packed = bytes_ | right << 8
    below = torch.cat([packed[:, 1:], packed[:, -1:]], dim=1)
    return Level(height, width, reference, (packed | below << 16).contiguous(), inside.to(torch.int32).contiguous())


def state_of(planes: torch.Tensor, inside: torch.Tensor) -> torch.Tensor:
    """Planes [N, 4, H, W] (w, du, dv, cost) as `state` [N, 2, H, 4, S]; no pixel where `inside` is 0."""
    count, _, height, width = planes.shape
    state = planes.new_zeros((count, 2, height, 4, stride_of(width)))
    state[:, :, :, 3] = NO_PIXEL
    known = planes.clone()
    known[:, 3][inside == 0] = NO_PIXEL
    for colour in (0, 1):
        for odd in (0, 1):  # rows
            half = known[:, :, odd::2, (odd + colour) & 1 :: 2].permute(0, 2, 1, 3)
            state[:, colour, odd::2, :, PAD : PAD + half.shape[3]] = half
    return state


def planes_of(state: torch.Tensor, width: int) -> torch.Tensor:
    """[N, 4, H, W] of `state`: the inverse of `state_of`, with costs as they are."""
    count, _, height, _, _ = state.shape
    planes = state.new_zeros((count, 4, height, width))
    for colour in (0, 1):
        for odd in (0, 1):
            parity = (odd + colour) & 1
            many = (width - parity + 1) // 2
            planes[:, :, odd::2, parity::2] = state[:, colour, odd::2, :, PAD : PAD + many].permute(0, 2, 1, 3)
    return planes
