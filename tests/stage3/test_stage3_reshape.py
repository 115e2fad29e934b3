"""The third stage: normals, light at the vertices against rays and finite differences, shape found again, resumed."""

import functools
from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from exmesh_nodes import stage3, transport

from exmesh_graph.colour import srgb_to_linear
from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import angle_weighted_normals
from exmesh_graph.gpu.torch_setup import sharing
from exmesh_graph.shading.moving import light_turns, turned
from exmesh_graph.shading.settings import BounceSettings, TransportSettings
from exmesh_graph.shading.transport import direct_transport, with_bounces
from exmesh_graph.stage1.init import initial_state
from exmesh_graph.stage1.refine import refine
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.stage1.smoothness import Bilaplacian
from exmesh_graph.stage2.scene import Body, Lighting, shade
from exmesh_graph.stage3.lit import Shown, VertexLight, corner_angles, weighted_normals
from exmesh_graph.stage3.reshape import reshape
from exmesh_graph.stage3.settings import ReshapeSettings
from exmesh_graph.testing import FakeContext, asset, carrier, sky, views
from exmesh_graph.types import Asset, Transport
from exmesh_graph.types.state import load_state, save_state

FIRM = Bilaplacian(weight=0.3)


def light_of(body: Asset, bounces: int = 1) -> Transport:
    light = direct_transport(body.vertices, body.faces, TransportSettings(directions=128, points=1500))
    return with_bounces(light, bounces) if bounces else light


@functools.cache
def truth() -> Asset:
    """A ball that shines, under a sky of one bright, broad side."""
    d = sky(16)
    return asset(carrier(rings=16, sectors=24), roughness=0.3, environment=d)


@functools.cache
def seen():
    return views(truth(), 12, 64)


def dented(of: Asset, depth: float = 0.02) -> Asset:
    """With waves along the normal, which outlines hardly tell."""
    v = of.vertices.astype(np.float64)
    wave = np.sin(9 * v[:, 0] + 1) * np.sin(8 * v[:, 1]) * np.sin(7 * v[:, 2] + 2)
    moved = replace(of, vertices=(v * (1 + depth * wave[:, None])).astype(np.float32))
    return replace(moved, texture=initial_state(moved, seen()).texture)  # what Stage I leaves in an asset


def off(found, of: Asset) -> float:
    """Mean distance from the true surface, along its radius."""
    radius = np.linalg.norm(found.vertices.astype(np.float64), axis=1) - np.linalg.norm(of.vertices, axis=1)
    return float(np.abs(radius).mean())


# --- normals


def test_normals_are_those_of_shading():
    rng = np.random.default_rng(0)
    ball = carrier(rings=8, sectors=12)
    vertices = ball.vertices.astype(np.float64) + rng.normal(0, 0.03, ball.vertices.shape)
    vertices[5] = vertices[6]  # faces without area
    faces = torch.from_numpy(ball.faces.astype(np.int64))
    points = torch.from_numpy(vertices)
    found = weighted_normals(points, faces, corner_angles(points, faces))
    np.testing.assert_allclose(found.numpy(), angle_weighted_normals(vertices, ball.faces), atol=1e-9)


def test_their_gradient_with_the_angles_held():
    rng = np.random.default_rng(1)
    ball = carrier(rings=3, sectors=4)
    points = torch.from_numpy(ball.vertices + rng.normal(0, 0.03, ball.vertices.shape)).requires_grad_()
    faces = torch.from_numpy(ball.faces.astype(np.int64))
    angles = corner_angles(points.detach(), faces)
    assert torch.autograd.gradcheck(lambda x: weighted_normals(x, faces, angles), (points,))


def test_a_vertex_without_area_has_a_zero_normal_and_gradient():
    points = torch.zeros(3, 3, dtype=torch.float64, requires_grad=True)
    faces = torch.tensor([[0, 1, 2]])
    normal = weighted_normals(points, faces, corner_angles(points.detach(), faces))
    normal.sum().backward()
    assert not normal.any()
    assert bool(torch.isfinite(points.grad).all())


# --- light at the vertices


@pytest.mark.parametrize("metallic", [False, True])
def test_a_vertex_is_lit_as_rays_say(metallic):
    """At the start, S is the radiance that the full renderer finds there with the same rays."""
    maps = {"metallic": np.full((32, 32), 0.7, np.float32)} if metallic else {}
    one = replace(dented(truth(), 0.08), **maps)
    light = light_of(one)
    lit = VertexLight(one, light)
    photographs = seen()
    pose = torch.from_numpy(np.linalg.inv(photographs.camera_to_world[3]))
    camera = torch.from_numpy(photographs.camera_to_world[3, :3, 3].astype(np.float32))
    towards = torch.nn.functional.normalize(camera - lit.body.geometry.vertices, dim=1)
    shown = torch.nonzero((lit.start * towards).sum(1) > 0.1)[:, 0]
    scale = lit.specular_scale(pose, shown, 32, 9)
    assert float(scale.std()) > 0.01
    body = Body(one, light)
    surface = body.geometry.samples(lit.face, lit.bary, camera)[shown]
    shift = torch.rand(len(lit.start), 2, generator=torch.Generator().manual_seed(9))[shown]
    moved = torch.cat([shift, torch.zeros(len(shift), 3)], dim=1)
    (expected,) = shade(body, body.under([Lighting()]), surface, 32, moved)
    found = srgb_to_linear(lit.display(lit.body.geometry.vertices, pose, Shown(shown, scale)))
    error = (found - expected).abs() / expected.clamp_min(0.02)
    # what a ray meets sends its points' products here, the product of their means there
    assert float(error.median()) < 1e-5
    assert float(error.max()) < 0.03


@pytest.mark.parametrize("axis", [(0, 1, 0), (0, 0, 0)])
def test_light_that_moves_lights_a_vertex_as_it_stands_for_the_view(axis):
    one = replace(dented(truth(), 0.08), light_axis=np.array(axis, np.float32))
    light, poses = light_of(one), seen().camera_to_world
    turn = light_turns(one.light_axis, poses)[3]
    here = turned(torch.from_numpy(one.environment), turn).numpy()
    moving, still = VertexLight(one, light).turned(turn), VertexLight(replace(one, environment=here), light)
    pose, vertices = torch.from_numpy(np.linalg.inv(poses[3])), still.body.geometry.vertices
    chosen = torch.arange(0, len(vertices), 3)
    shown = [
        lit.display(vertices, pose, Shown(chosen, lit.specular_scale(pose, chosen, 16, 1))) for lit in (moving, still)
    ]
    torch.testing.assert_close(*shown, rtol=1e-4, atol=1e-5)


def test_pictures_under_light_that_moves_are_fitted_under_it():
    """The texture starts as a median of views; once it is fitted, what moves about it is the light's."""
    whole = replace(truth(), light_axis=np.array([0, 1, 0], np.float32))
    pictures = views(whole, 12, 64)
    begun = replace(whole, texture=initial_state(whole, pictures).texture)
    short, left = ReshapeSettings(iterations=60, lobe_samples=8, texture_lr=0.02), []
    for one in (begun, replace(begun, light_axis=None)):
        left.append(np.mean(reshape(one, pictures, light_of(one), short)[1]["psnr"][-3:]))
    assert left[0] > left[1] + 3


def test_its_gradient_says_what_moved_vertices_change():
    """Against differences along random moves."""
    one = truth()
    lit = VertexLight(one, light_of(one))
    pose = torch.from_numpy(np.linalg.inv(seen().camera_to_world[0]))
    vertices = lit.body.geometry.vertices.clone()
    shown = Shown(torch.arange(len(vertices)), torch.ones_like(vertices))
    weight = torch.randn(len(vertices), 3, generator=torch.Generator().manual_seed(3))

    def total(points: torch.Tensor) -> torch.Tensor:
        return (weight * lit.display(points, pose, shown)).double().sum()

    for number in range(3):
        move = torch.randn(len(vertices), 3, generator=torch.Generator().manual_seed(10 + number))
        moving = vertices.clone().requires_grad_()
        (gradient,) = torch.autograd.grad(total(moving), moving)
        step = 2e-4
        change = (total(vertices + step * move) - total(vertices - step * move)) / (2 * step)
        assert float((gradient.double() * move).sum()) == pytest.approx(float(change), rel=0.05), (
            number
        )  # the sky's lookups are linear in pieces


def lit_hard(metallic: bool) -> tuple[VertexLight, torch.Tensor]:
    """A ball with a vertex at a pole of the sky, faces without area and one that is turned inside out, and moved
    vertices."""
    maps = {"metallic": np.full((32, 32), 0.7, np.float32)} if metallic else {}
    one = replace(dented(truth(), 0.08), **maps)
    lit = VertexLight(one, light_of(one))
    vertices = lit.body.geometry.vertices + 2e-3 * torch.randn(
        len(one.vertices), 3, generator=torch.Generator().manual_seed(1)
    )
    vertices[40] = vertices[41]
    vertices[90] *= 0.5
    return lit, vertices


@pytest.mark.parametrize("metallic", [False, True])
def test_the_kernels_are_the_plain_form_in_value_and_gradient(metallic):
    lit, vertices = lit_hard(metallic)
    assert lit.kernels is not None
    generator = torch.Generator().manual_seed(2)
    for number in (0, 5, 9):
        pose = torch.from_numpy(np.linalg.inv(seen().camera_to_world[number]))
        chosen = torch.randperm(len(vertices), generator=generator)[:300]  # seen from behind, some of them
        shown = Shown(chosen, 4 * torch.rand(300, 3, generator=generator))
        weight = torch.randn(300, 3, generator=generator)
        found = []
        for form in (lit.display, lit.plain_display):
            moving = vertices.clone().requires_grad_()
            value = form(moving, pose, shown)
            found.append((value.detach(), torch.autograd.grad((value * weight).sum(), moving)[0]))
        (value, gradient), (expected, exact) = found
        torch.testing.assert_close(value, expected, rtol=1e-4, atol=1e-5)
        off = (gradient - exact).norm(dim=1)
        assert float(off.median()) < 1e-5 * float(exact.norm(dim=1).median())
        # at the seams of the sky's texels and of its horizon either side is a gradient
        assert float((off > 1e-3 * exact.norm(dim=1) + 1e-3).float().mean()) < 0.02


def test_of_no_vertices_there_is_no_light():
    lit, vertices = lit_hard(False)
    moving = vertices.clone().requires_grad_()
    pose = torch.from_numpy(np.linalg.inv(seen().camera_to_world[0]))
    value = lit.display(moving, pose, Shown(torch.zeros(0, dtype=torch.int64), torch.zeros(0, 3)))
    assert value.shape == (0, 3)
    assert not torch.autograd.grad(value.sum(), moving)[0].any()


# --- the stage


@pytest.mark.thorough
def test_it_brings_back_a_shape_that_the_outlines_do_not_tell():
    start = dented(truth())
    settings = ReshapeSettings(iterations=300, vertex_lr=0.005, lobe_samples=8)
    found, history = reshape(start, seen(), light_of(start), settings, smoothness=FIRM, seed=1)
    assert off(found, truth()) < 0.55 * off(start, truth())
    assert history["psnr"][-1] > history["psnr"][0]
    for name in ("faces", "uvs", "uv_faces", "base_color", "roughness", "environment"):
        assert getattr(found, name) is getattr(start, name)
    # without the light, a texture alone
    plain = RefineSettings(iterations=300, total_iterations=300, vertex_lr=0.005, vertex_decay=0.18, texture_lr=0.0027)
    state, _ = refine(initial_state(start, seen(), texture="carrier"), seen(), plain, smoothness=FIRM, seed=1)
    assert off(found, truth()) < 0.95 * off(state, truth())


@pytest.mark.thorough
def test_a_cut_off_stage_goes_on_to_the_same_bytes(tmp_path):
    start = dented(truth())
    light, settings = light_of(start), ReshapeSettings(iterations=7, lobe_samples=2)
    whole, history = reshape(start, seen(), light, settings, seed=4)

    class CutOff(Exception):
        pass

    def checkpoint(now, state):
        if now == 3:
            (tmp_path / "kept").mkdir()
            save_state(tmp_path / "kept", state)
            raise CutOff

    with pytest.raises(CutOff):
        reshape(start, seen(), light, settings, seed=4, checkpoint=checkpoint)
    again, same = reshape(start, seen(), light, settings, seed=4, resumed=(3, load_state(tmp_path / "kept")))
    assert same == history
    for field in fields(whole):
        expected, found = getattr(whole, field.name), getattr(again, field.name)
        if isinstance(expected, np.ndarray):
            assert expected.tobytes() == found.tobytes(), field.name


def test_the_same_bytes_on_any_number_of_cores():
    start = dented(truth())
    light, settings = light_of(start), ReshapeSettings(iterations=4, lobe_samples=2)
    ends = []
    for threads in (1, 3):
        with sharing(threads):
            ends.append(reshape(start, seen(), light, settings, seed=7)[0])
    assert ends[0].vertices.tobytes() == ends[1].vertices.tobytes()
    assert ends[0].texture.tobytes() == ends[1].texture.tobytes()


def test_a_vertex_without_a_face_stays():
    start = dented(truth())
    lonely = replace(start, vertices=np.concatenate([start.vertices, [[9, 9, 9]]]).astype(np.float32))
    found, _ = reshape(lonely, seen(), light_of(lonely), ReshapeSettings(iterations=2, lobe_samples=2), smoothness=FIRM)
    assert np.isfinite(found.vertices).all()
    assert (found.vertices[-1] == 9).all()


@pytest.mark.parametrize("turned", [False, True])
def test_a_light_that_explains_nothing_moves_no_vertex(turned):
    """The found sky, or one whose bright side is opposite."""
    start = dented(truth(), 0.01)
    if turned:
        start = replace(start, environment=np.roll(start.environment, start.environment.shape[1] // 2, axis=1))
    ctx = FakeContext(node="reshape", seed=2)
    found, history = stage3.refine(ctx, start, seen(), light_of(start), p=stage3.RefineParams(iterations=3))
    assert (history.values["explained"] < 0) == turned
    assert (found is start) == turned
    assert bool(ctx.warnings) == turned


def test_no_iterations_leave_the_asset_and_another_meshs_transport_is_refused():
    one = truth()
    same, history = reshape(one, seen(), light_of(one, 0), ReshapeSettings(iterations=0))
    assert same is one
    assert history == {}
    with pytest.raises(GeometryError):
        reshape(one, seen(), light_of(asset(), 0), ReshapeSettings(iterations=1))


def test_the_node():
    ctx = FakeContext(node="reshape", seed=2)
    start = dented(truth())
    light = transport.direct(ctx, start, p=TransportSettings(directions=64, points=800)).transport
    lit = transport.bounce(ctx, light, p=BounceSettings(bounces=1)).transport
    found, history = stage3.refine(ctx, start, seen(), lit, p=stage3.RefineParams(iterations=3, lobe_samples=2))
    assert isinstance(found, Asset)
    assert found.vertices.tobytes() != start.vertices.tobytes()
    assert history.values["moved"]["largest"] > 0
    assert any("vertices moved" in line for line in ctx.lines)
