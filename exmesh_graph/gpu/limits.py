"""What the kernels can count: their indices have 32 bits, and a visibility key packs depth and face into 64."""

from __future__ import annotations

import torch

EMPTY_KEY = torch.iinfo(torch.int64).max
"""The key of a pixel, or of a pixel pair, that nothing was found for."""

_INDEX_LIMIT = 2**31 - 1


def check_size(**counts: int) -> None:
    """Raises ValueError if any count does not fit a kernel's 32-bit index; sizes are per view, not per batch."""
    for what, count in counts.items():
        if count > _INDEX_LIMIT:
            raise ValueError(
                f"{count} {what} in one view are more than the rasteriser's 32-bit indices can count "
                f"(at most {_INDEX_LIMIT}); draw the picture in parts, or the mesh in pieces"
            )


def check_near(near: float) -> None:
    """Raises ValueError unless the near plane lies in front of the camera."""
    if not 0 < near < float("inf"):
        raise ValueError(f"the near plane must be a positive depth in world units, got {near}")


def check_indices(what: str, indices: torch.Tensor, count: int) -> None:
    """Raises IndexError if an index lies outside [0, count): a kernel would read other memory.

    On a CPU only, where it costs some microseconds; on CUDA it would make the host wait for the device.
    """
    if indices.device.type != "cpu" or indices.numel() == 0:
        return
    low, high = (int(x) for x in indices.aminmax())
    if low < 0 or high >= count:
        raise IndexError(f"{what} hold indices from {low} to {high}; expected 0 to {count - 1}")
