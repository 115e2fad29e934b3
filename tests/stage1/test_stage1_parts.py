"""Schedule, optimiser, regularisers and the first texture."""

import numpy as np
import pytest
import torch
from stage1_scenes import ball, fresh_state, grid_ball, photographs, texture

from exmesh_graph.errors import DataError, GeometryError
from exmesh_graph.optim import adam_step, decayed, view_at
from exmesh_graph.raster import edge_table
from exmesh_graph.stage1.appearance.colours import UVTexture
from exmesh_graph.stage1.init import fill_unseen, initial_state
from exmesh_graph.stage1.refine import vertex_areas
from exmesh_graph.stage1.regularise import deviation, distinct, smoother, smoothness
from exmesh_graph.stage1.render import render_carrier
from exmesh_graph.targets import prepare_targets
from exmesh_graph.testing import FakeContext


def test_decay():
    assert decayed(2.0, 0.1, 0, 100) == 2.0
    assert decayed(2.0, 0.1, 50, 100) == pytest.approx(2 * 0.1**0.5)
    assert decayed(2.0, 0.1, 500, 100) == pytest.approx(0.2)
    assert decayed(2.0, 0.1, 7, 0) == 2.0
    assert decayed(2.0, 0.1, 20, 100, hold=0.2) == 2.0
    assert decayed(2.0, 0.1, 60, 100, hold=0.2) == pytest.approx(2 * 0.1**0.5)
    assert decayed(2.0, 0.1, 100, 100, hold=0.2) == pytest.approx(0.2)


def test_every_view_once_per_epoch_in_changing_order():
    order = [view_at(i, 7, seed=3) for i in range(28)]
    epochs = [order[i : i + 7] for i in range(0, 28, 7)]
    assert all(sorted(epoch) == list(range(7)) for epoch in epochs)
    assert len({tuple(epoch) for epoch in epochs}) > 1
    assert order != [view_at(i, 7, seed=4) for i in range(28)]


def test_a_vertex_step_turns_with_the_object_and_a_texture_step_projects():
    g = torch.Generator().manual_seed(0)
    gradient = torch.randn(5, 3, generator=g)
    rotation = torch.linalg.qr(torch.randn(3, 3, generator=g)).Q
    moved = []
    for turn in (torch.eye(3), rotation):
        v, m, s = torch.zeros(5, 3), torch.zeros(5, 3), torch.zeros(5)
        for step in (1, 2, 3):
            adam_step(v, (gradient * step) @ turn.T, m, s, step, 0.1)
        moved.append(v)
    assert torch.allclose(moved[0] @ rotation.T, moved[1], atol=1e-6)
    v, m, s = torch.zeros(5, 3), torch.zeros(5, 3), torch.zeros(5)
    adam_step(v, gradient, m, s, 1, 0.1)
    assert torch.allclose(v.norm(dim=1), torch.full((5,), 0.1), atol=1e-5)
    # a texel outside [0, 1] comes back: no dead gradient beyond the clamp
    look = UVTexture(torch.full((1, 1, 3), 1.2))
    for step in range(1, 60):
        look.step(look.values - 0.5, step, 0.02, 0.0)
    assert float(look.values.max()) == pytest.approx(0.5, abs=0.1)


def test_moments_per_area_do_not_see_a_split():
    vertices, faces, _, _ = grid_ball()
    v, f = torch.from_numpy(vertices), torch.from_numpy(faces)
    areas = vertex_areas(v, f)
    corners = v[f.long()]
    total = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).norm(dim=1).sum() / 2
    assert float(areas.sum()) == pytest.approx(float(total), rel=1e-3)
    lonely = torch.cat([v, torch.zeros(1, 3)])
    assert bool((vertex_areas(lonely, f) > 0).all())


@pytest.mark.parametrize("kind", ["laplacian", "bilaplacian"])
def test_smoothness_against_a_dense_formula_and_its_gradient(kind):
    vertices, faces, _, _ = grid_ball(rings=4, sectors=5)
    g = torch.Generator().manual_seed(0)
    v = torch.from_numpy(vertices).double() + 0.05 * torch.randn(len(vertices), 3, generator=g, dtype=torch.float64)
    edges = edge_table(torch.from_numpy(faces)).edges
    of = smoother(v, edges)
    n = len(v)
    adjacency = torch.zeros(n, n, dtype=torch.float64)
    for a, b in edges.tolist():
        adjacency[a, b] = adjacency[b, a] = 1
    u = adjacency / adjacency.sum(1, keepdim=True) - torch.eye(n, dtype=torch.float64)
    length = (v[edges[:, 0].long()] - v[edges[:, 1].long()]).norm(dim=1).mean()
    power = u if kind == "laplacian" else u @ u
    want = (power @ v).square().sum() / n / length**2
    assert float(smoothness(v, of, kind)) == pytest.approx(float(want), rel=1e-9)
    assert torch.autograd.gradcheck(lambda x: smoothness(x, of, kind), v.clone().requires_grad_())
    # nothing depends on the scene's scale
    scaled = smoother(1000 * v, edges)
    assert float(smoothness(1000 * v, scaled, kind)) == pytest.approx(float(want), rel=1e-9)


def test_deviation_sees_uneven_motion_only():
    vertices, faces, _, _ = grid_ball(rings=4, sectors=5)
    v = torch.from_numpy(vertices).double()
    of = smoother(v, edge_table(torch.from_numpy(faces)).edges)
    assert float(deviation(v + torch.tensor([1.0, 2.0, 3.0]), v, of)) == pytest.approx(0, abs=1e-20)
    one = v.clone()
    one[7, 0] += of.mean_edge
    degree = int((of.edges == 7).sum())
    assert float(deviation(one, v, of)) == pytest.approx(degree / len(of.edges), rel=1e-9)


def test_an_isolated_vertex_is_left_alone():
    v = torch.rand(5, 3)
    of = smoother(v, torch.tensor([[0, 1], [1, 2]]))
    moved = v.clone().requires_grad_()
    smoothness(moved, of, "bilaplacian").backward()
    assert float(moved.grad[3:].abs().sum()) == 0
    assert bool(torch.isfinite(moved.grad).all())


def test_the_first_texture_is_the_true_one_where_it_is_seen():
    views = photographs(ball(), count=10, size=96)
    state = initial_state(ball(), views)
    colours, alpha = render_carrier(state, views)
    truth, _ = render_carrier(ball(), views)
    inside = alpha > 0.99
    assert np.abs(colours - truth)[inside].mean() < 0.02
    assert np.abs(state.texture - texture()).mean() < 0.05
    assert float(np.abs(state.vertex_m).sum() + np.abs(state.texture_v).sum()) == 0


def test_the_first_texture_outvotes_an_occluder():
    """One view shows a red blot on everything: the median keeps the majority's colour."""
    views = photographs(ball(), count=10, size=64)
    views.images[4] = views.alpha[4][..., None] * np.array([1.0, 0, 0], np.float32)
    clean = initial_state(ball(), photographs(ball(), count=10, size=64)).texture
    assert np.abs(initial_state(ball(), views).texture - clean).mean() < 0.02


@pytest.mark.parametrize("kind", ["carrier", "grey"])
def test_other_first_textures(kind):
    views = photographs(ball(), count=2)
    state = initial_state(ball(), views, texture=kind)
    assert np.array_equal(state.texture, texture() if kind == "carrier" else np.full_like(texture(), 0.5))


def test_a_texture_that_is_not_square_is_refused():
    from dataclasses import replace

    with pytest.raises(DataError, match=r"Carrier\.texture: .*\n.*\[R, R, 3\]"):
        replace(ball(), texture=np.zeros((4, 8, 3), np.float32))
    with pytest.raises(GeometryError, match="R > 0"):
        initial_state(replace(ball(), texture=np.zeros((0, 0, 3), np.float32)), photographs(ball(), count=2))


@pytest.mark.parametrize("shape", [(1, 1), (7, 5), (16, 16), (33, 2)])
def test_filling_keeps_seen_texels_and_invents_no_extremes(shape):
    g = torch.Generator().manual_seed(1)
    image = torch.rand(*shape, 3, generator=g)
    seen = torch.rand(*shape, generator=g) > 0.6
    filled = fill_unseen(torch.where(seen[..., None], image, 7.0), seen)
    assert torch.equal(filled[seen], image[seen])
    if bool(seen.any()):
        assert float(filled.max()) <= float(image[seen].max()) + 1e-6
        assert float(filled.min()) >= float(image[seen].min()) - 1e-6
    assert torch.equal(fill_unseen(image, torch.zeros(shape, dtype=torch.bool)), image)


def test_downscaled_targets_see_the_same_scene():
    """A smaller image of the same view is the same picture: rendering with its intrinsics must match it."""
    views = photographs(ball(), count=3, size=96)
    half = prepare_targets(views, downscale=2)
    assert half.images.shape == (3, 48, 48, 3)
    assert torch.allclose(half.intrinsics[:, :2] * 2, torch.from_numpy(views.intrinsics[:, :2]))
    from exmesh_graph.stage1.render import draw, surface_of

    surface = surface_of(ball())
    for i in range(3):
        picture = draw(surface, half.intrinsics[i], half.world_to_camera[i], 48, 48)
        assert float((picture.colour - half.images[i]).abs().mean()) < 0.006
        assert float((picture.alpha - half.alpha[i]).abs().mean()) < 0.003


def test_nodes_pass_their_parameters_on():
    from exmesh_nodes import stage1

    views = photographs(ball(), count=3)
    state = stage1.init(FakeContext(), ball(), views, p=stage1.InitParams(device="cpu")).state
    out = stage1.refine(FakeContext(seed=3), state, views, p=stage1.RefineParams(iterations=4, device="cpu"))
    assert out.state.iteration == 4
    assert out.history.values["iteration"][-1] == 4
    assert np.isfinite(out.history.values["psnr"]).all()
    assert fresh_state(ball()).iteration == 0


@pytest.mark.parametrize("count", [0, 1, 7, 100])
def test_distinct_edges_are_the_unique_rows_in_order(count):
    rng = torch.Generator().manual_seed(count)
    edges = torch.randint(0, max(count, 1), (3 * count, 2), generator=rng, dtype=torch.int32)
    assert torch.equal(distinct(edges, count), torch.unique(edges.long(), dim=0).reshape(-1, 2))
