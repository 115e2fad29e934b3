"""Learning rates over time, and the order of the views."""

from __future__ import annotations

from functools import lru_cache

import numpy as np


def decayed(start: float, ratio: float, iteration: int, total: int, hold: float = 0.0) -> float:
    """start * ratio^(iteration / total), held at start * ratio afterwards; `total` <= 0 means no decay.

    It begins after a share `hold` (below 1) of `total`, and ends at the same time.
    """
    if total <= 0:
        return start
    return start * ratio ** min(max(iteration / total - hold, 0.0) / (1 - hold), 1.0)


def view_at(iteration: int, views: int, seed: int) -> int:
    """The view of an iteration: each epoch of `views` iterations is a permutation of its own, seeded by (seed, epoch).

    A function of its arguments alone, so that a run cut into several calls visits the views as one call does.
    """
    epoch, place = divmod(iteration, views)
    return int(_order(epoch, views, seed)[place])


@lru_cache(maxsize=16)
def _order(epoch: int, views: int, seed: int) -> np.ndarray:
    return np.random.default_rng([seed, epoch]).permutation(views)
