"""The small ball of exmesh_graph.testing under the names that these tests use, photographed with wandering exposure."""

from dataclasses import replace

import numpy as np

from exmesh_graph.io.color import linear_to_srgb, srgb_to_linear
from exmesh_graph.testing import carrier as ball
from exmesh_graph.testing import latlong_ball as grid_ball
from exmesh_graph.testing import pattern as texture
from exmesh_graph.testing import state as fresh_state
from exmesh_graph.testing import views
from exmesh_graph.types import Carrier, Views

__all__ = ["ball", "fresh_state", "grid_ball", "photographs", "texture"]


def photographs(carrier: Carrier, count: int = 8, size: int = 48, exposure=None) -> Views:
    """What `carrier` looks like; `exposure`: one factor of the display colours for each view."""
    seen = views(carrier, count, size)
    if exposure is None:
        return seen
    alpha = seen.alpha[..., None]
    shown = (
        linear_to_srgb(seen.images / np.maximum(alpha, 1e-6)) * np.asarray(exposure, np.float32)[:, None, None, None]
    )
    return replace(seen, images=(srgb_to_linear(np.clip(shown, 0, 1)) * alpha).astype(np.float32))
