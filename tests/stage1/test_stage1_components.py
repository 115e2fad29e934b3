"""The ports of Stage I that take components: what is plugged in is what the loop does, and nothing is the default."""

import numpy as np
import pytest
from exmesh_nodes import appearance, regulariser, stage1
from stage1_scenes import ball, fresh_state, photographs

from exmesh_graph.stage1.refine import refine
from exmesh_graph.stage1.regularise import PreparedSmoothness
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.stage1.smoothness import Bilaplacian, Laplacian
from exmesh_graph.testing import FakeContext


@pytest.fixture(scope="module")
def views():
    return photographs(ball(), count=4)


def rough():
    """A ball whose vertices were shaken: smoothness has something to do."""
    state = fresh_state(ball())
    noise = np.random.default_rng(0).normal(0, 0.02, state.vertices.shape)
    return type(state)(**{**vars(state), "vertices": (state.vertices + noise).astype(np.float32)})


def test_nothing_plugged_in_is_the_bilaplacian_and_the_texture(views):
    p = stage1.InitParams(device="cpu")
    plain = stage1.init(FakeContext(), ball(), views, p=p).state
    named = stage1.init(FakeContext(), ball(), views, appearance.UvTexture(), p=p).state
    assert plain.appearance == named.appearance == "uv_texture"
    assert plain.texture.tobytes() == named.texture.tobytes()
    p = stage1.RefineParams(iterations=3, device="cpu")
    a, b, c = (
        stage1.refine(FakeContext(), rough(), views, smoothness=smooth, p=p).state.vertices.tobytes()
        for smooth in (None, regulariser.Bilaplacian(), regulariser.Laplacian())
    )
    assert a == b
    assert a != c


def test_the_plugged_in_smoothness_is_the_one_in_the_loss(views):
    """Its weight counts, and weight 0 leaves the other terms alone."""
    base = {"iterations": 1, "vertex_lr": 0.0, "texture_lr": 0.0}
    losses = {
        (kind, weight): refine(rough(), views, RefineSettings(**base), smoothness=kind(weight=weight))[1]["loss"][0]
        for kind in (Laplacian, Bilaplacian)
        for weight in (0.0, 0.1, 0.2)
    }
    assert losses[Laplacian, 0.0] == losses[Bilaplacian, 0.0]
    for kind in (Laplacian, Bilaplacian):
        terms = [losses[kind, weight] - losses[kind, 0.0] for weight in (0.1, 0.2)]
        assert terms[0] > 1e-3
        assert terms[1] == pytest.approx(2 * terms[0], rel=1e-3)
    assert losses[Laplacian, 0.1] != losses[Bilaplacian, 0.1]


def test_a_weight_made_for_an_edge_falls_where_edges_span_more_pixels(views):
    """The term itself is asked, in pictures of which one has half the other's pixels to a side."""
    assert [Bilaplacian(edge=2).share(pixels) for pixels in (0.5, 2, 3, 4, 40)] == [
        1,
        1,
        pytest.approx(4 / 9),
        0.25,
        0.25,
    ]
    assert Bilaplacian().share(40) == 1
    base = RefineSettings(iterations=1, vertex_lr=0.0, texture_lr=0.0)

    def term(edge, **changes):
        with_, without = (
            refine(rough(), views, base.replaced(**changes), smoothness=Bilaplacian(weight=w, edge=edge))[1]["loss"][0]
            for w in (1.0, 0.0)
        )
        return with_ - without

    whole, pixels = term(0), _edge_in_pixels(views)
    assert term(pixels / 1.5) == pytest.approx(whole / 1.5**2, rel=1e-3)
    assert term(pixels / 1.5, downscale=2) == pytest.approx(whole, rel=1e-3)


def _edge_in_pixels(views):
    state = rough()
    ends = np.sort(np.concatenate([state.faces[:, [0, 1]], state.faces[:, [1, 2]], state.faces[:, [2, 0]]]), axis=1)
    ends = np.unique(ends, axis=0)
    length = np.linalg.norm(state.vertices[ends[:, 0]] - state.vertices[ends[:, 1]], axis=1).mean()
    middle = np.append(state.vertices.mean(axis=0), 1)
    depth = [(camera @ middle)[2] for camera in views.world_to_camera]
    return length * np.median(views.intrinsics[:, 0, 0] / depth)


class Filtered:
    """A smoothness that is a filter alone: `factor` times the identity, or the mean over all vertices."""

    def __init__(self, factor):
        self.factor = factor

    def prepare(self, vertices, table, pixels):
        if self.factor is None:
            return PreparedSmoothness(None, lambda x: x.mean(dim=0, keepdim=True).expand_as(x).contiguous())
        return PreparedSmoothness(None, lambda x: self.factor * x)


def test_a_filter_acts_on_gradients_before_adam_and_on_steps_after_it(views):
    settings = RefineSettings(iterations=4, hold_unseen=False)
    start = fresh_state(ball(radius=0.55))

    def moved(smoothness):
        state, _ = refine(start, views, settings, smoothness=smoothness, seed=2)
        return state.vertices - start.vertices, state.vertex_m

    plain, plain_m = moved(Bilaplacian(weight=0.0))
    one, one_m = moved(Filtered(1.0))
    # without a filter a kernel steps, which rounds in another way
    assert np.linalg.norm(one - plain) < 1e-3 * np.linalg.norm(plain)
    assert np.linalg.norm(one_m - plain_m) < 1e-3 * np.linalg.norm(plain_m)
    # Adam does not see the scale of gradients, so only the filter's second use shows in the first step
    first = settings.replaced(iterations=1)
    steps = [
        refine(start, views, first, smoothness=Filtered(f), seed=2)[0].vertices - start.vertices for f in (1.0, 0.5)
    ]
    assert np.allclose(steps[1], 0.5 * steps[0], atol=1e-6)
    together, _ = moved(Filtered(None))
    assert np.ptp(together, axis=0).max() < 1e-6 < np.abs(together).max()
