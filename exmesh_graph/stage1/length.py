"""How many iterations of Stage I a time pays for, by a fixed rule: equal settings give equal results everywhere."""

from __future__ import annotations

_STEP = 0.013  # processor seconds of an iteration whatever the size of its picture, and
_PIXEL = 4e-8  # for each pixel: 512 x 512 and 1600 x 1200 of docs/speed.md, and a tenth for what stands between steps


def iterations_in(seconds: float, pixels: int) -> int:
    """Iterations on one picture of `pixels` each that `seconds` of processor time pay for, at least 1."""
    return max(1, round(seconds / (_STEP + _PIXEL * pixels)))
