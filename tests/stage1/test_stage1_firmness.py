"""A round run twice: which is kept, what follows, and going on after a cut in either run."""

import numpy as np
import pytest

from exmesh_graph.stage1.firmness import MARGIN, firmer_if_as_good
from exmesh_graph.stage1.refine import refine
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.stage1.smoothness import Bilaplacian
from exmesh_graph.testing import carrier, state, views
from exmesh_graph.types.state import load_state, save_state

SETTINGS = RefineSettings(iterations=12, total_iterations=60)
FIELDS = ("vertices", "vertex_m", "vertex_v", "texture", "texture_m", "gradient_ema")


class Told:
    """A round that ends with given PSNR: one for each firmness."""

    def __init__(self, psnr, firmness):
        self.psnr, self.firmness = psnr, firmness

    def run(self, progress, checkpoint, resumed):
        return self.firmness, {"psnr": [10.0] * 40 + [self.psnr] * 10}

    def kept(self):
        return {}


@pytest.mark.parametrize(("cost", "kept"), [(-1.0, 10.0), (0.0, 10.0), (MARGIN - 1e-3, 10.0), (MARGIN + 1e-3, 1.0)])
def test_the_firmer_round_is_kept_where_photographs_are_met_as_well(cost, kept):
    ends = {1.0: 30.0, 10.0: 30.0 - cost}
    found, history = firmer_if_as_good(lambda f: Told(ends[f], f), 10.0, 5, None, None, None)
    assert found == kept == history["firmness"]
    assert history["cost"] == pytest.approx(cost, abs=1e-3)


def dented(depth):
    """A ball of noise `depth` radii deep, and photographs of the smooth one; or the other way round (negative)."""
    smooth = carrier(rings=24, sectors=36)
    noise = 1 + abs(depth) * np.random.default_rng(0).standard_normal((len(smooth.vertices), 1)).astype(np.float32)
    rough = carrier(rings=24, sectors=36)
    rough.vertices[:] = smooth.vertices * noise
    start, shown = (rough, smooth) if depth > 0 else (smooth, rough)
    return state(start), views(shown, size=64)


@pytest.mark.thorough
def test_noise_on_a_smooth_object_goes_and_the_next_round_stays_firm():
    start, seen = dented(0.01)
    settings = SETTINGS.replaced(iterations=60, total_iterations=200)
    new, history = refine(start, seen, settings.replaced(firmer=10.0), seed=1)
    assert new.firmness == history["firmness"] == 10
    plain, _ = refine(start, seen, settings, seed=1, smoothness=Bilaplacian(weight=3.0))
    assert np.array_equal(new.vertices, plain.vertices)  # ten times the default weight
    after, _ = refine(new, seen, settings, seed=1)
    same, _ = refine(plain, seen, settings, seed=1, smoothness=Bilaplacian(weight=3.0))
    assert after.firmness == 10
    assert np.array_equal(after.vertices, same.vertices)


@pytest.mark.thorough
def test_a_rough_object_keeps_the_soft_round():
    start, seen = dented(-0.03)
    settings = SETTINGS.replaced(iterations=120, total_iterations=200)
    new, history = refine(start, seen, settings.replaced(firmer=100.0), seed=1)
    plain, _ = refine(start, seen, settings, seed=1)
    assert history["cost"] > MARGIN
    assert new.firmness == history["firmness"] == 1
    assert np.array_equal(new.vertices, plain.vertices)


@pytest.mark.thorough
@pytest.mark.parametrize("step", [5, 12, 17, 24])
def test_a_cut_off_trial_goes_on_to_the_same_bytes(step, tmp_path):
    start, seen = dented(0.01)
    settings = SETTINGS.replaced(firmer=10.0)
    whole, history = refine(start, seen, settings, seed=3)

    class Cut(Exception):
        pass

    def checkpoint(now, kept):
        if now == step:
            (tmp_path / "kept").mkdir()
            save_state(tmp_path / "kept", kept)
            raise Cut

    with pytest.raises(Cut):
        refine(start, seen, settings, seed=3, checkpoint=checkpoint)
    again, same = refine(start, seen, settings, seed=3, resumed=(step, load_state(tmp_path / "kept")))
    assert same == history
    assert again.firmness == whole.firmness
    for name in FIELDS:
        assert np.array_equal(getattr(again, name), getattr(whole, name)), name


def test_progress_counts_both_runs():
    start, seen = dented(0.01)
    steps = []
    refine(start, seen, SETTINGS.replaced(firmer=2.0), progress=lambda done, total, **_: steps.append((done, total)))
    assert steps[-1] == (24, 24)
    assert [done for done, _ in steps] == sorted({done for done, _ in steps})
