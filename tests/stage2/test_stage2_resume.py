"""A fit that is cut off at any step and goes on from files ends with the bytes of an uninterrupted one."""

from dataclasses import fields, replace

import numpy as np
import pytest

from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.settings import DecompositionSettings
from exmesh_graph.types.state import load_state, save_state

SETTINGS = DecompositionSettings(
    environment_height=8, iterations=20, material_rate=0.05, environment_rate=0.2, indirect_ramp=5, corrections=3,
    correction_samples=2, metallic=True, light_first=0.35, glossy_first=0.4, metal_share=0.1, palette_width=0.1,
)  # fmt: skip


class CutOff(Exception):
    pass


@pytest.mark.thorough
def test_a_cut_off_fit_goes_on_to_the_same_bytes(carrier, train_views, transport, tmp_path):
    transport = replace(transport, deeper=True)  # what one step leaves the next
    whole, curves = fit(carrier, train_views, transport, SETTINGS, seed=3)
    # a correction comes at step 5, maps move from 7, colours gather at 8, maps wait at 9, metal is agreed on at 10
    steps = [5, 9, 10, int(np.random.default_rng().integers(1, 20))]
    for number, step in enumerate(steps):
        folder = tmp_path / str(number)

        def checkpoint(now, state, step=step, folder=folder):
            if now == step:
                folder.mkdir()
                save_state(folder, state)
                raise CutOff

        with pytest.raises(CutOff):
            fit(carrier, train_views, transport, SETTINGS, seed=3, checkpoint=checkpoint)
        again, same = fit(carrier, train_views, transport, SETTINGS, seed=3, resumed=(step, load_state(folder)))
        assert same == curves, step
        for field in fields(whole):
            expected, found = getattr(whole, field.name), getattr(again, field.name)
            assert np.asarray(expected).tobytes() == np.asarray(found).tobytes(), (step, field.name)
