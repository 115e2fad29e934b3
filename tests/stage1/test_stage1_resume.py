"""A refinement that is cut off at any step and goes on from files ends with the bytes of an uninterrupted one."""

from dataclasses import fields

import numpy as np
import pytest
from stage1_scenes import ball, fresh_state, photographs

from exmesh_graph.stage1.refine import refine
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.stage1.smoothness import Laplacian
from exmesh_graph.types import DepthMaps
from exmesh_graph.types.state import load_state, save_state


class CutOff(Exception):
    pass


def cut_at(step, folder):
    """A checkpoint that writes its state at `step` and ends the call there."""

    def checkpoint(now, state):
        if now == step:
            folder.mkdir()
            save_state(folder, state)
            raise CutOff

    return checkpoint


@pytest.mark.thorough
@pytest.mark.parametrize(
    "change",
    [
        {},
        {"smoothness": Laplacian(), "deviation_weight": 1.0, "silhouette": "bce", "silhouette_weight": 0.005},
        {"gains": True, "downscale": 2, "depth_weight": 0.1, "total_iterations": 30},
    ],
)
def test_a_cut_off_refinement_goes_on_to_the_same_bytes(change, tmp_path):
    views = photographs(ball())
    depths = DepthMaps(tuple(views.names), np.where(views.alpha > 0.5, 2.0 + 0.1 * views.alpha, 0).astype(np.float32))
    start = fresh_state(ball(radius=0.55), fill=0.5)
    change = dict(change)
    options = {"smoothness": change.pop("smoothness", None), "seed": 5, "depths": depths}
    settings = RefineSettings(iterations=9, **change)
    whole, history = refine(start, views, settings, **options)
    step = int(np.random.default_rng().integers(1, 10))
    with pytest.raises(CutOff):
        refine(start, views, settings, **options, checkpoint=cut_at(step, tmp_path / "kept"))
    again, same = refine(start, views, settings, **options, resumed=(step, load_state(tmp_path / "kept")))
    assert same == history
    for field in fields(whole):
        expected, found = getattr(whole, field.name), getattr(again, field.name)
        if isinstance(expected, np.ndarray):
            assert expected.tobytes() == found.tobytes(), (step, field.name)
        else:
            assert expected == found
