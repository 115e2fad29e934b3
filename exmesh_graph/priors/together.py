"""Training and test views as one set of small pictures."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from exmesh_graph.io.train_size import factor_for, reduced
from exmesh_graph.types import Views

#: Longer side of the pictures, at most.
SIDE = 720


def together(train: Views, test: Views) -> Views:
    """All views at one size, training views first, in memory whether their pictures lie in files or not."""
    factor = factor_for(train, SIDE, 0)
    larger = max(1, round(test.width / train.width)) if len(test) else 1  # training pictures may have been reduced
    parts = [reduced(train, factor), *([reduced(test, factor * larger)] if len(test) else [])]
    joined: dict[str, Any] = {
        name: np.concatenate([np.asarray(getattr(part, name)) for part in parts])
        for name in ("images", "alpha", "intrinsics", "camera_to_world")
    }
    return replace(parts[0], names=tuple(name for part in parts for name in part.names), **joined)
