"""Appearance models: drawn as a slow reference draws them, carried through topology, fitted, baked and scored."""

import functools
from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from exmesh_nodes import appearance, evaluate, topology, uv
from stage1_scenes import ball, fresh_state, grid_ball, photographs

from exmesh_graph.errors import DataError
from exmesh_graph.evaluate.coverage import surface_depths
from exmesh_graph.evaluate.metrics.image import psnr
from exmesh_graph.raster import edge_table, project, rasterize_projected
from exmesh_graph.stage1.appearance.colours import PerFace, PerVertex, UVTexture
from exmesh_graph.stage1.appearance.mlp import Mlp, weight_count
from exmesh_graph.stage1.appearance.model import Surface
from exmesh_graph.stage1.appearance.state import model_of
from exmesh_graph.stage1.refine import refine
from exmesh_graph.stage1.render import render_carrier
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import Region, Stage1State

KINDS = {
    "uv_texture": appearance.UvTexture(),
    "per_vertex": appearance.PerVertex(),
    "per_face": appearance.PerFace(),
    "mlp": appearance.Mlp(frequencies=3, width=24),
}
OTHERS = [kind for kind in KINDS if kind != "uv_texture"]
SETTINGS = RefineSettings(iterations=8)


@pytest.fixture(scope="module")
def views():
    return photographs(ball(), count=6)


@functools.cache
def begun(kind: str, seed: int = 0, scale: float = 1.0) -> Stage1State:
    carrier = replace(ball(), vertices=(scale * ball().vertices).astype(np.float32))
    return KINDS[kind].begin(fresh_state(carrier), seed, "cpu")


def same(a: Stage1State, b: Stage1State) -> bool:
    for f in fields(a):
        x, y = getattr(a, f.name), getattr(b, f.name)
        pairs = [(x[k], y[k]) for k in x] if f.name == "model" else [(x, y)]
        if not all(np.array_equal(p, q) for p, q in pairs):
            return False
    return True


# --- drawing


def small_surface(kind: str):
    """A ball in float64 with random values of the model, its projection and the face at each of 14 x 14 pixels."""
    rng = torch.Generator().manual_seed(3)
    vertices, faces, uvs, uv_faces = (torch.from_numpy(a) for a in grid_ball(rings=4, sectors=5))
    vertices = vertices.double() + 0.05 * torch.randn(vertices.shape, generator=rng, dtype=torch.float64)
    intrinsics = torch.tensor([[21.0, 0, 7.3], [0, 20.0, 6.6], [0, 0, 1]], dtype=torch.float64)
    pose = torch.eye(4, dtype=torch.float64)
    pose[2, 3] = 1.7
    projected = project(vertices, intrinsics, pose)
    face_id = rasterize_projected(projected, faces, 14, 14).face_id

    def random(*shape):
        return torch.rand(shape, generator=rng, dtype=torch.float64)

    box = torch.tensor([0.1, -0.05, 0.0, 0.8], dtype=torch.float64)
    look = {
        "uv_texture": lambda: UVTexture(random(5, 5, 3)),
        "per_vertex": lambda: PerVertex(random(len(vertices), 3)),
        "per_face": lambda: PerFace(random(len(faces), 3)),
        "mlp": lambda: Mlp(random(weight_count(2, 6)) - 0.5, None, frequencies=2, width=6, box=box),
    }[kind]()
    return Surface(vertices, faces, uvs.double(), uv_faces, look, edge_table(faces), 1.0), projected, face_id


def slowly(surface: Surface, projected: torch.Tensor, face_id: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
    """Pixel by pixel: weights of the corners from a 3 x 3 system, then each model's own formula."""
    height, width = face_id.shape
    rows = []
    for row in range(height):
        for column in range(width):
            face = int(face_id[row, column])
            if face < 0:
                rows.append(torch.zeros(3, dtype=torch.float64))
                continue
            corners = surface.faces[face].long()
            centre = torch.tensor([column + 0.5, row + 0.5, 1.0], dtype=torch.float64)
            weights = torch.linalg.solve(projected[corners].T, centre)
            weights = weights / weights.sum()
            rows.append(colour_at(surface, face, corners, weights, values))
    return torch.stack(rows).view(height, width, 3)


def colour_at(surface: Surface, face: int, corners: torch.Tensor, weights: torch.Tensor, values: torch.Tensor):
    look = surface.appearance
    if isinstance(look, PerVertex):
        return sum(weights[k] * values[corners[k]] for k in range(3))
    if isinstance(look, PerFace):
        return values[face]
    if isinstance(look, Mlp):
        point = (weights @ surface.vertices[corners] - look.box[:3]) / look.box[3]
        waves = [f(torch.pi * 2**k * point) for f in (torch.sin, torch.cos) for k in range(look.frequencies)]
        x, used = torch.cat([point, *waves]), 0
        for out, into in ((6, 15), (6, 6), (3, 6)):
            matrix, bias = values[used : used + out * into].view(out, into), values[used + out * into :][:out]
            used += out * (into + 1)
            x = matrix @ x + bias
            x = torch.where(x > 0, x, 0.0) if out == 6 else 1 / (1 + torch.exp(-x))
        return x
    uv_here = weights @ surface.uvs[surface.uv_faces[face].long()]
    x, y = (uv_here[0] * 5 - 0.5).clamp(0, 4), ((1 - uv_here[1]) * 5 - 0.5).clamp(0, 4)
    j, i = min(int(x), 3), min(int(y), 3)
    fx, fy = x - j, y - i
    top = (1 - fx) * values[i, j] + fx * values[i, j + 1]
    return (1 - fy) * top + fy * ((1 - fx) * values[i + 1, j] + fx * values[i + 1, j + 1])


@pytest.mark.parametrize("kind", KINDS)
def test_every_model_is_drawn_as_pixel_by_pixel_in_value_and_gradient(kind):
    surface, projected, face_id = small_surface(kind)
    assert 40 < int((face_id >= 0).sum()) < 14 * 14
    inputs = [t.clone().requires_grad_() for t in (surface.appearance.values, projected, surface.vertices)]
    weights = torch.randn(14, 14, 3, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    results = []
    for draw in ("fast", "slow"):
        values, points, vertices = inputs
        surface.appearance.values = values
        moved = surface._replace(vertices=vertices)
        fast = draw == "fast"
        image = surface.appearance.shade(moved, points, face_id) if fast else slowly(moved, points, face_id, values)
        gradients = torch.autograd.grad((image * weights).sum(), inputs, allow_unused=True, materialize_grads=True)
        results.append((image, *gradients))
    for name, a, b in zip(("image", "values", "projected", "vertices"), *results, strict=True):
        assert torch.allclose(a, b, rtol=1e-9, atol=1e-10), name
    assert float(results[0][1].abs().sum()) > 0
    inside = [float(g.abs().sum()) > 0 for g in results[0][2:]]
    assert inside == {"uv_texture": [True, False], "per_vertex": [True, False], "per_face": [False, False],
                      "mlp": [True, True]}[kind]  # fmt: skip


# --- the start


@pytest.mark.thorough
@pytest.mark.parametrize("kind", OTHERS)
def test_the_first_values_look_like_the_first_texture(kind, views):
    start = begun(kind)
    assert start.appearance == kind
    shown, _ = render_carrier(start, views)
    true, _ = render_carrier(ball(), views)
    assert psnr(shown, true) > {"per_vertex": 26, "per_face": 24, "mlp": 28}[kind]


@pytest.mark.thorough
def test_the_network_depends_on_its_seed_and_not_on_the_scenes_scale(views):
    a, b = begun("mlp"), begun("mlp", seed=2)
    assert np.array_equal(a.model["values"], begun.__wrapped__("mlp").model["values"])
    assert not np.array_equal(a.model["values"], b.model["values"])
    points = torch.from_numpy(ball().vertices)
    for scale in (2.0**-10, 2.0**10):  # powers of two round alike
        larger = begun("mlp", scale=scale)
        assert np.array_equal(larger.model["values"], a.model["values"])
        assert torch.equal(model_of(larger).colour(scale * points), model_of(a).colour(points))


# --- topology and atlas


@pytest.mark.parametrize("kind", OTHERS)
@pytest.mark.parametrize("method", ["uniform", "score"])
def test_a_split_changes_no_colour(kind, method, views):
    state = replace(begun(kind), gradient_ema=np.random.default_rng(0).random(len(ball().vertices)).astype(np.float32))
    split = topology.split(FakeContext(), state, p=topology.SplitParams(method=method, growth=1.5)).state
    assert len(split.faces) > 1.3 * len(state.faces)
    before, after = (render_carrier(s, views)[0] for s in (state, split))
    # silhouettes of the parts fall on other pixel pairs; inside, nothing changes
    assert np.quantile(np.abs(after - before), 0.99) < 2e-3
    model_of(split)


@pytest.mark.parametrize("kind", OTHERS)
def test_a_merge_keeps_what_survives(kind):
    state = begun(kind)
    state = replace(state, model={**state.model, "m": np.asarray(state.model["values"] * 2)})
    merged = topology.merge(
        FakeContext(), state, p=topology.MergeParams(method="random", min_faces=20, area_quantile=1.0)
    ).state
    assert len(merged.faces) < len(state.faces)
    if kind == "mlp":
        assert merged.model is state.model
        return
    old = {tuple(p) for p in state.model["values"].tolist()}
    assert {tuple(p) for p in merged.model["values"].tolist()} <= old
    assert np.array_equal(merged.model["m"], 2 * merged.model["values"])
    where = {"per_vertex": (state.vertices, merged.vertices)}.get(kind)
    if where is not None:  # surviving vertices do not move, so each keeps its own colour
        index = {tuple(p): i for i, p in enumerate(where[0].tolist())}
        kept = [index[tuple(p)] for p in where[1].tolist()]
        assert np.array_equal(merged.model["values"], state.model["values"][kept])
    model_of(merged)


@pytest.mark.thorough
@pytest.mark.parametrize("kind", OTHERS)
def test_a_new_atlas_leaves_the_model_alone(kind, views):
    state = begun(kind)
    new = uv.regenerate(FakeContext(), state, p=uv.RegenerateParams(texture_size=48)).state
    assert all(np.array_equal(state.model[name], new.model[name]) for name in state.model)
    assert np.array_equal(render_carrier(new, views)[0], render_carrier(state, views)[0])


def test_colours_that_were_not_carried_are_told():
    state = begun("per_face")
    with pytest.raises(DataError, match="per_face colours"):
        model_of(replace(state, model={name: array[1:] for name, array in state.model.items()}))
    with pytest.raises(DataError, match="'paint' is unknown"):
        model_of(replace(state, appearance="paint"))


# --- the fit


@pytest.mark.thorough
@pytest.mark.parametrize("kind", OTHERS)
def test_a_fit_improves_the_model_and_bakes_it(kind, views):
    grey = replace(fresh_state(ball(rings=20, sectors=32), fill=0.5))
    start = KINDS[kind].begin(grey, 0, "cpu")
    state, history = refine(start, views, RefineSettings(iterations=150, vertex_lr=0.0), seed=1)
    assert history["psnr"][-1] > history["psnr"][0] + 6
    assert not np.array_equal(state.model["values"], start.model["values"])
    ours, _ = render_carrier(state, views)
    baked = replace(state, appearance="uv_texture", model={})
    shown, _ = render_carrier(baked, views)
    assert psnr(ours, shown) > (24 if kind == "per_face" else 29)  # 32^2 texels for 1 200 faces
    if kind != "mlp":
        assert float(state.model["values"].min()) >= 0
        assert float(state.model["values"].max()) <= 1


@pytest.mark.thorough
@pytest.mark.parametrize("kind", OTHERS)
def test_repeated_and_resumed_fits_end_with_the_same_bytes(kind, views):
    start = begun(kind)
    kept = {}
    whole, history = refine(
        start, views, SETTINGS, seed=4,
        checkpoint=lambda step, state: kept.update(
            {step: {**state, "tensors": {n: t.detach().clone() for n, t in state["tensors"].items()},
                    "curve": [list(c) for c in state["curve"]]}}
        ),
    )  # fmt: skip
    again, _ = refine(start, views, SETTINGS, seed=4)
    resumed, same_history = refine(start, views, SETTINGS, seed=4, resumed=(5, kept[5]))
    assert same(whole, again)
    assert same(whole, resumed)
    assert history == same_history


def test_stage_one_is_scored_by_its_model_and_the_baked_texture_beside_it(views, tmp_path):
    state = begun("per_vertex")
    state = replace(state, texture=np.zeros_like(state.texture))
    test = replace(views, split="test")
    values = evaluate.stage1(FakeContext(tmp_path), state, test, p=evaluate.Stage1Params(pictures=0)).metrics.values
    assert values["held_out"]["psnr"] > 25
    assert values["held_out"]["psnr_baked"] < 20
    plain = evaluate.stage1(FakeContext(tmp_path), ball(), test, p=evaluate.Stage1Params(pictures=0)).metrics.values
    assert "psnr_baked" not in plain["held_out"]


def test_views_without_masks_may_be_scored_where_another_surface_shows(views, tmp_path):
    """What a carrier leaves bare inside the region counts against it."""
    walled = views.images + (1 - views.alpha[..., None]) * np.float32(0.4)
    test = replace(views, images=walled, alpha=np.ones_like(views.alpha), has_masks=False, split="test")
    p = evaluate.Stage1Params(pictures=0)

    def score(carrier, region):
        return evaluate.stage1(FakeContext(tmp_path), carrier, test, region, p=p).metrics.values["held_out"]

    def where_shown(radius):
        depth = surface_depths(ball(radius=radius), test)
        inside = depth > 0
        return Region(test.names, inside, np.where(inside, depth - 0.5, 0), np.where(inside, depth + 0.5, 0), "masks")

    assert score(ball(), where_shown(0.5))["psnr"] > 30
    small = ball(radius=0.5)
    assert score(small, where_shown(0.5))["psnr"] > score(small, where_shown(0.58))["psnr"] + 2
