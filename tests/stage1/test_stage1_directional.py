"""The directional appearance: drawn as pixel by pixel, carried through topology, fitted, and dropped again."""

import functools
from dataclasses import replace

import numpy as np
import pytest
import torch
from exmesh_nodes import appearance, stage1, topology, uv
from stage1_scenes import ball, fresh_state, grid_ball, photographs

from exmesh_graph.errors import DataError
from exmesh_graph.evaluate.carrier import score_carrier
from exmesh_graph.evaluate.metrics.image import psnr
from exmesh_graph.io.color import srgb_to_linear
from exmesh_graph.raster import edge_table
from exmesh_graph.stage1.appearance.directional import COUNTS, Directional, harmonics
from exmesh_graph.stage1.appearance.model import Moments, Surface
from exmesh_graph.stage1.appearance.state import model_of
from exmesh_graph.stage1.refine import refine
from exmesh_graph.stage1.render import draw, render_carrier, surface_of
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.targets import prepare_targets
from exmesh_graph.testing import FakeContext, views
from exmesh_graph.types import Stage1State, Views

SETTINGS = RefineSettings(iterations=8)


def begun(state: Stage1State, **settings) -> Stage1State:
    return appearance.Directional(**{"order": 1, **settings}).begin(state, 0, "cpu")


def noisy(state: Stage1State, order: int = 1) -> Stage1State:
    """With a residual, moments and mean directions that are not zero."""
    state = begun(state, order=order)
    rng = np.random.default_rng(2)
    model = {name: rng.normal(0, 0.2, array.shape).astype(np.float32) for name, array in state.model.items()}
    return replace(state, model={**model, "v": np.abs(model["v"]), "settings": state.model["settings"]})


@functools.cache
def shiny(split: str) -> Views:
    """A ball that is brighter towards +x of the direction of view, by 0.3 of the range."""
    seen = views(ball(), 16 if split == "train" else 7, 40, split=split)
    tinted = replace(noisy(fresh_state(ball())), texture=(0.3 + 0.4 * ball().texture).astype(np.float32))
    residual = np.zeros((len(tinted.vertices), 3, 3), np.float32)
    residual[:, 0] = 0.3
    model = {**tinted.model, "values": residual.reshape(-1, 9), "mean": np.zeros_like(tinted.model["mean"])}
    shown, alpha = render_carrier(replace(tinted, model=model), seen)
    linear = srgb_to_linear(shown / np.maximum(alpha, 1e-6)[..., None]) * alpha[..., None]
    return replace(seen, images=linear.astype(np.float32), alpha=alpha)


# --- harmonics


def test_harmonics_are_orthogonal_and_of_one_size():
    """Their products' means over the sphere, on a product grid that integrates degree four exactly."""
    z, weight = np.polynomial.legendre.leggauss(6)
    angle = 2 * np.pi * np.arange(12) / 12
    ring = np.sqrt(1 - z**2)[:, None]
    points = np.stack([ring * np.cos(angle), ring * np.sin(angle), np.broadcast_to(z[:, None], (6, 12))], axis=-1)
    basis = harmonics(torch.from_numpy(points.reshape(-1, 3)), COUNTS[2])
    weights = torch.from_numpy(np.repeat(weight / 2 / 12, 12))
    gram = basis.T @ (weights[:, None] * basis)
    assert torch.allclose(gram, torch.eye(8, dtype=torch.float64) / 3, atol=1e-12)
    assert float((weights @ basis).abs().max()) < 1e-12
    assert torch.equal(harmonics(basis[:, :3], COUNTS[1]), basis[:, :3])


# --- drawing


@pytest.mark.thorough
@pytest.mark.parametrize("order", [1, 2])
def test_it_is_drawn_as_pixel_by_pixel_in_value_and_gradient(order):
    rng = torch.Generator().manual_seed(3)

    def random(*shape):
        return torch.rand(shape, generator=rng, dtype=torch.float64)

    vertices, faces, uvs, uv_faces = (torch.from_numpy(a) for a in grid_ball(rings=4, sectors=5))
    start = vertices.double() + 0.05 * random(*vertices.shape)
    count, size = COUNTS[order], 14
    mean = random(len(start), count)
    inputs = [start, random(5, 5, 3), random(len(start), 3 * count) - 0.5]
    inputs = [t.requires_grad_() for t in inputs]
    intrinsics = torch.tensor([[21.0, 0, 7.3], [0, 20.0, 6.6], [0, 0, 1]], dtype=torch.float64)
    pose = torch.eye(4, dtype=torch.float64)
    pose[2, 3] = 1.7
    weights = random(size, size, 3) - 0.5

    def surface(position, texture, residual):
        nothing = Moments(torch.zeros(0), torch.zeros(0))
        look = Directional(texture, nothing, residual, nothing, mean, shrinkage=0.0, rate=1.0)
        return Surface(position, faces, uvs.double(), uv_faces, look, edge_table(faces), 1.0)

    whole = draw(surface(*inputs), intrinsics, pose, size, size)
    face_id = whole.fragments.face_id
    plain = surface(*inputs)
    plain.appearance.tints = lambda *_: None
    added = whole.colour - draw(plain, intrinsics, pose, size, size).colour
    # away from the outline nothing is blended: what is added there is the residual
    inner = (whole.alpha - 1).abs() < 1e-12
    inner &= torch.nn.functional.max_pool2d((face_id < 0).double()[None], 3, 1, 1)[0] == 0
    assert int(inner.sum()) > 20

    def slowly(position, residual):
        camera = torch.tensor([0.0, 0.0, -1.7], dtype=torch.float64)
        pixels = []
        for row, column in torch.nonzero(inner).tolist():
            corners = faces[int(face_id[row, column])].long()
            centre = torch.tensor([column + 0.5, row + 0.5, 1.0], dtype=torch.float64)
            share = torch.linalg.solve(
                ((position[corners] + torch.tensor([0, 0, 1.7], dtype=torch.float64)) @ intrinsics.T).T, centre
            )
            share = share / share.sum()
            total = torch.zeros(3, dtype=torch.float64)
            for k in range(3):
                x, y, z = (camera - position[corners[k]]) / (camera - position[corners[k]]).norm()
                values = [x, y, z]
                if order == 2:
                    root = 5**0.5
                    values += [root * x * y, root * y * z, root * (3 * z * z - 1) / (2 * 3**0.5), root * x * z]
                    values += [root * (x * x - y * y) / 2]
                table = residual[corners[k]].view(count, 3)
                for j, value in enumerate(values):
                    total = total + share[k] * (value - mean[corners[k], j]) * table[j]
            pixels.append(total)
        return torch.stack(pixels)

    slow = slowly(inputs[0], inputs[2])
    assert torch.allclose(added[inner], slow, rtol=1e-9, atol=1e-10)
    ours, theirs = (
        torch.autograd.grad((shown * weights[inner]).sum(), (inputs[0], inputs[2]), retain_graph=True)
        for shown in (added[inner], slow)
    )
    for a, b in zip(ours, theirs, strict=True):
        assert float(b.abs().max()) > 0
        assert torch.allclose(a, b, rtol=1e-8, atol=1e-9)


def test_a_steady_texture_moves_no_vertex_through_the_direction_without_uv_gradient():
    surface = surface_of(noisy(fresh_state(ball())))
    vertices = surface.vertices.requires_grad_()
    targets = prepare_targets(photographs(ball(), count=2))
    inside = torch.zeros(48, 48, 1)
    inside[20:28, 20:28] = 1
    size = []
    for uv_gradient in (True, False):
        camera = targets.intrinsics[0], targets.world_to_camera[0]
        picture = draw(surface._replace(vertices=vertices), *camera, 48, 48, uv_gradient=uv_gradient)
        (gradient,) = torch.autograd.grad((picture.colour * inside).sum(), vertices, allow_unused=True)
        size.append(0.0 if gradient is None else float(gradient.abs().sum()))
    assert size[0] > 0
    assert size[1] == 0


# --- the mean direction


def test_over_the_views_that_show_a_vertex_the_residual_adds_nothing_on_average():
    seen = photographs(ball(), count=9)
    surface, targets = surface_of(noisy(fresh_state(ball()), order=2)), prepare_targets(photographs(ball(), count=9))
    look = surface.appearance
    look.prepare(surface, targets)
    total, count = torch.zeros(len(surface.vertices), 3), torch.zeros(len(surface.vertices), 1)
    for k, pose in zip(targets.intrinsics, targets.world_to_camera, strict=True):
        face_id = draw(surface, k, pose, seen.height, seen.width).fragments.face_id
        visible = torch.zeros(len(total), 1)
        visible[surface.faces[face_id[face_id >= 0].long()].long()] = 1
        total += visible * look.tints(surface.vertices, pose)
        count += visible
    assert float((count > 0).float().mean()) > 0.9
    assert float(total.abs().max()) < 1e-5 * len(targets)
    assert float(look.tints(surface.vertices, targets.world_to_camera[0]).abs().mean()) > 0.05


# --- topology and atlas


@pytest.mark.parametrize("method", ["uniform", "score"])
def test_a_split_changes_no_colour(method):
    state = replace(noisy(fresh_state(ball())), gradient_ema=np.linspace(0, 1, len(ball().vertices), dtype=np.float32))
    state = replace(state, model={**state.model, "mean": np.full_like(state.model["mean"], 0.2)})
    split = topology.split(FakeContext(), state, p=topology.SplitParams(method=method, growth=1.5)).state
    assert len(split.faces) > 1.3 * len(state.faces)
    bare = replace(state, appearance="uv_texture", model={})
    before, after, texture = (render_carrier(s, photographs(ball()))[0] for s in (state, split, bare))
    # a new vertex has a direction of its own
    assert np.square(after - before).mean() < 0.01 * np.square(texture - before).mean()
    assert np.array_equal(split.model["settings"], state.model["settings"])


def test_a_merge_keeps_what_survives():
    state = noisy(fresh_state(ball()))
    state = replace(state, model={**state.model, "m": 2 * state.model["values"], "v": state.model["values"][:, 4]})
    p = topology.MergeParams(method="random", min_faces=20, area_quantile=1.0)
    merged = topology.merge(FakeContext(), state, p=p).state
    assert len(merged.faces) < len(state.faces)
    index = {tuple(p): i for i, p in enumerate(state.vertices.tolist())}
    kept = [index[tuple(p)] for p in merged.vertices.tolist()]
    for name in ("values", "m", "v", "mean"):
        assert np.array_equal(merged.model[name], state.model[name][kept]), name
    model_of(merged)


def test_a_new_atlas_leaves_the_residual_alone():
    state = noisy(fresh_state(ball()))
    new = uv.regenerate(FakeContext(), state, p=uv.RegenerateParams(texture_size=48)).state
    assert all(np.array_equal(state.model[name], new.model[name]) for name in state.model)
    assert new.appearance == "directional"


def test_residuals_that_were_not_carried_are_told():
    state = noisy(fresh_state(ball()))
    cut = {**state.model, "values": state.model["values"][1:]}
    with pytest.raises(DataError, match=f"{len(state.vertices) - 1} residuals"):
        model_of(replace(state, model=cut))


# --- the fit


@pytest.mark.thorough
def test_it_learns_what_changes_with_the_direction_and_the_texture_keeps_the_mean():
    train, test = shiny("train"), shiny("test")
    settings = RefineSettings(iterations=160, vertex_lr=0.0)
    plain, _ = refine(fresh_state(ball(), fill=0.5), train, settings, seed=1)
    ours, _ = refine(begun(fresh_state(ball(), fill=0.5), shrinkage=0.01, rate=2.0), train, settings, seed=1)
    one, two = (score_carrier(state, test).values["held_out"] for state in (plain, ours))
    assert two["psnr"] > one["psnr"] + 3
    # what Stage II gets is as near to the photographs as a texture fitted alone
    assert abs(two["psnr_baked"] - one["psnr"]) < 0.5
    residual = ours.model["values"].reshape(-1, 3, 3)
    assert 0.15 < residual[:, 0].mean() < 0.35
    assert abs(residual[:, 1:].mean()) < 0.05


@pytest.mark.thorough
def test_shrinkage_pulls_the_residual_to_zero():
    sizes = []
    for shrinkage in (0.0, 0.3, 30.0):
        start = begun(fresh_state(ball()), shrinkage=shrinkage)
        state, _ = refine(start, shiny("train"), RefineSettings(iterations=80, vertex_lr=0.0), seed=1)
        sizes.append(float(np.square(state.model["values"]).mean()))
    assert sizes[0] > sizes[1] > 4 * sizes[2]


def test_repeated_and_resumed_fits_end_with_the_same_bytes():
    start, kept = noisy(fresh_state(ball())), {}

    def keep(step, state):
        tensors = {name: tensor.detach().clone() for name, tensor in state["tensors"].items()}
        kept[step] = {**state, "tensors": tensors, "curve": [list(c) for c in state["curve"]]}

    whole, _ = refine(start, shiny("train"), SETTINGS, seed=4, checkpoint=keep)
    resumed, _ = refine(start, shiny("train"), SETTINGS, seed=4, resumed=(5, kept[5]))
    for name in ("vertices", "texture", "texture_v", "gradient_ema"):
        assert np.array_equal(getattr(whole, name), getattr(resumed, name)), name
    assert all(np.array_equal(whole.model[name], resumed.model[name]) for name in whole.model)


def test_without_its_residual_a_state_is_its_texture():
    state = noisy(fresh_state(ball()))
    plain = replace(state, appearance="uv_texture", model={})
    seen = photographs(ball())
    shown, _ = render_carrier(plain, seen)
    assert psnr(render_carrier(state, seen)[0], shown) < 30
    assert np.array_equal(shown, render_carrier(ball(), seen)[0])


def test_a_round_begins_the_appearance_that_is_plugged_in_and_keeps_one_of_its_kind():
    train, p = shiny("train"), stage1.RefineParams(iterations=3, total_iterations=100)
    first = stage1.refine(FakeContext(), fresh_state(ball()), train, appearance=appearance.Directional(order=2), p=p)
    assert first.state.appearance == "directional"
    assert np.abs(first.state.model["values"]).max() > 0
    still = p.replaced(iterations=0)
    same = stage1.refine(FakeContext(), first.state, train, appearance=appearance.Directional(order=1), p=still).state
    assert np.array_equal(same.model["values"], first.state.model["values"])
    plain = stage1.refine(FakeContext(), first.state, train, appearance=appearance.UvTexture(), p=still).state
    assert (plain.appearance, dict(plain.model)) == ("uv_texture", {})
    assert np.array_equal(plain.texture, first.state.texture)
