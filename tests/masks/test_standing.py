"""init.auto without masks: the table goes, and what stands on it stays."""

import numpy as np
import pytest
from exmesh_nodes import auto
from mask_scenes import scene

from exmesh_graph.errors import GeometryError
from exmesh_graph.testing import FakeContext


@pytest.mark.thorough
def test_without_masks_the_table_goes_and_parts_of_the_object_stay():
    """The table is larger than the ball: the largest part alone would be the table."""
    ball = scene(count=12, at=0.25)
    p = auto.AutoParams(faces=2000, resolution=64)
    made = auto.auto(FakeContext(), ball.views, None, ball.depths, p=p)
    assert [row["value"] for row in made.decisions.values["decisions"]] == ["tsdf", "removed"]
    beside = np.linalg.norm(made.mesh.vertices[:, ::2] - [0.25, 0], axis=1)
    assert beside.max() < 0.45
    kept = auto.auto(FakeContext(), ball.views, None, ball.depths, p=p.model_copy(update={"table": "keep"})).mesh
    assert np.ptp(kept.vertices[:, 0]) > 1.4
    free = scene(count=12, table=0)
    with pytest.raises(GeometryError, match="no plane was found"):
        auto.auto(FakeContext(), free.views, None, free.depths, p=p.model_copy(update={"table": "remove"}))
