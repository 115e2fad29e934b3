"""A sun or lamp found in Stage I's texture: its direction, strength and reach; what a fit makes of it."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from exmesh_graph.colour import linear_to_srgb
from exmesh_graph.errors import DataError
from exmesh_graph.rays import make_ray_tracer
from exmesh_graph.shading import envmap
from exmesh_graph.shading.point_sets import disc, fibonacci_sphere
from exmesh_graph.shading.settings import TransportSettings
from exmesh_graph.shading.suns import find_suns
from exmesh_graph.shading.transport import direct_transport
from exmesh_graph.stage2 import key_light
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.init import neutral_asset
from exmesh_graph.stage2.key_light import counts, described, find_key_light
from exmesh_graph.stage2.settings import DecompositionSettings, StartSettings
from exmesh_graph.stage2.start_light import SPOT, KeyLight, is_neutral, white_light, with_key
from exmesh_graph.uv.surface import texel_surface

SIZE = 192
TOWARDS = np.array([0.52, 0.66, -0.54]) / np.linalg.norm([0.52, 0.66, -0.54])


@pytest.fixture(scope="module")
def seen(carrier):
    """The ball on its slab with a transport of many points, and its paint: two colours in patches."""
    light = direct_transport(carrier.vertices, carrier.faces, TransportSettings(points=6000, directions=64))
    where = texel_surface(carrier, SIZE)
    patches = np.sin(9 * where.position).prod(axis=-1) > 0
    return carrier, light, where, np.where(patches, 0.55, 0.3)


def _photographed(seen, strength, reach=0.0, most=1.0):
    """The carrier with the texture that Stage I would find: even light and a key light towards `TOWARDS`, by rays, and
    0.3 of the mean of both from what hides the sky; clipped."""
    carrier, _, (position, normal), paint = seen
    tracer = make_ray_tracer(carrier.vertices, carrier.faces)
    flat = normal.reshape(-1, 3)
    origins = (position.reshape(-1, 3) + 1e-3 * flat).astype(np.float32)

    def arriving(directions):
        """Mean cosine of those that are above the horizon, seen and hidden."""
        seen, hidden = np.zeros(len(flat)), np.zeros(len(flat))
        for d in directions:
            cosine = np.maximum(flat @ d, 0)
            free = ~tracer.any_hit(origins, np.broadcast_to(d.astype(np.float32), origins.shape).copy())
            seen += cosine * free / len(directions)
            hidden += cosine * ~free / len(directions)
        return seen, hidden

    even, hidden = (4 * x for x in arriving(fibonacci_sphere(96)))
    lit, _ = arriving(disc(TOWARDS, 64, reach) if reach else TOWARDS[None])
    direct = even + strength * lit
    sent = paint.reshape(-1) * (direct + 0.3 * hidden * direct.mean()) * 0.4
    display = linear_to_srgb(torch.from_numpy(sent.clip(0, most))).numpy().reshape(SIZE, SIZE, 1)
    return dataclasses.replace(carrier, texture=np.repeat(display, 3, axis=2).astype(np.float32))


def _off(found):
    return math.degrees(math.acos(min(1.0, float(found.direction @ TOWARDS))))


def test_a_sun_is_found_where_it_stands(seen):
    found = find_key_light(_photographed(seen, 3.0), seen[1])
    assert counts(found)
    assert found.reach <= 6
    assert _off(found) < 2
    assert found.strength == pytest.approx(3.0, rel=0.5)
    assert described(found).endswith("; taken.")


def test_a_sun_whose_light_is_clipped_is_found_by_its_shadow(seen):
    """Most of what it lights has one display value: only what is in its shade tells of paint."""
    bright = _photographed(seen, 6.0, most=0.45)
    bright = dataclasses.replace(bright, texture=bright.texture / bright.texture.max())
    assert (bright.texture > key_light.CLIPPED).mean() > 0.15
    found = find_key_light(bright, seen[1])
    assert counts(found)
    assert _off(found) < 5
    assert found.strength > 1


def test_even_light_has_no_key_light_whatever_the_paint(seen):
    found = find_key_light(_photographed(seen, 0.0), seen[1])
    assert not counts(found)
    assert "taken from" in described(found)


@pytest.mark.thorough
def test_a_wide_light_is_known_as_one(seen):
    """Begun with as a small one, its shade would be too sharp; it grows by itself."""
    small, lamp, wide = (find_key_light(_photographed(seen, 3.0, reach), seen[1]) for reach in (6.0, 12.0, 45.0))
    assert small.reach == 6
    assert counts(small)
    assert lamp.reach == 12
    assert max(_off(small), _off(lamp)) < 3
    assert wide.reach > 12
    assert not counts(wide)


def test_a_texture_without_any_shade_tells_of_no_light(seen):
    """Where parts hide the sky from one another, a sun that shines into the corners would explain it best."""
    flat = dataclasses.replace(seen[0], texture=np.full((SIZE, SIZE, 3), 0.6, np.float32))
    assert find_key_light(flat, seen[1]).gain == 0


@pytest.mark.filterwarnings("error")
def test_white_and_black_textures_tell_of_no_light(seen):
    for value in (1.0, 0.0):
        found = find_key_light(dataclasses.replace(seen[0], texture=np.full((8, 8, 3), value, np.float32)), seen[1])
        assert found.gain == 0
        assert not counts(found)
        assert np.isfinite(found.direction).all()


@pytest.mark.thorough
def test_equal_inputs_find_equal_lights(seen):
    sunny = _photographed(seen, 3.0)
    one, other = (find_key_light(sunny, seen[1]) for _ in range(2))
    assert np.array_equal(one.direction, other.direction)
    assert one[1:] == other[1:]


def _half_clipped(seen):
    sunny = _photographed(seen, 3.0, most=0.4)
    return key_light._Points(dataclasses.replace(sunny, texture=sunny.texture / sunny.texture.max()), seen[1])


def test_the_measure_is_that_of_its_definition(seen):
    """E pair by pair, in plain loops."""
    points = _half_clipped(seen)
    pairs = points.pairs(300)
    assert pairs.p_clipped.any()
    assert pairs.q_clipped.any()
    t, s = points.arriving(pairs.points, TOWARDS), 1.7
    sky = points.sky[pairs.points]
    arriving = np.log(sky + s * t + points.sent_on[pairs.points] * (sky.mean() + s * t.mean()))
    total = 0.0
    for p, q, step, low, high in zip(*pairs[1:], strict=True):
        off = step - (arriving[p] - arriving[q])
        error = abs(off)
        if low:
            error = max(off, 0.0)
        elif high:
            error = max(-off, 0.0)
        total += min(error, 1.0)
    assert points.cost(pairs, t, s) == pytest.approx(total / len(pairs.p), rel=1e-12)


def test_no_pair_is_clipped_on_both_sides_and_none_faces_away(seen):
    points = _half_clipped(seen)
    pairs = points.pairs(10**9)
    assert not (pairs.p_clipped & pairs.q_clipped).any()
    at = pairs.points
    assert ((points.normals[at[pairs.p]] * points.normals[at[pairs.q]]).sum(1) > 0).all()
    assert len(np.unique(np.stack([pairs.p, pairs.q]), axis=1).T) == len(pairs.p)


@settings(max_examples=25, deadline=None)
@given(
    st.floats(-1.5, 1.5), st.floats(0, 6.28), st.floats(0.3, 30), st.sampled_from([0, 6, 20]), st.sampled_from([32, 64])
)
def test_a_key_light_brings_what_it_says(latitude, longitude, strength, reach, rows):
    """A surface that faces it receives `strength` times what level ground has of the rest: pi under radiance 1."""
    towards = np.array(
        [math.cos(latitude) * math.sin(longitude), math.sin(latitude), math.cos(latitude) * math.cos(longitude)]
    )
    lit = with_key(white_light(0.0, rows), KeyLight(towards, strength, reach))
    added = (lit.astype(float) - 1)[..., 0] * envmap.solid_angles(rows, 2 * rows)[:, None]
    assert added.sum() == pytest.approx(strength * math.pi, rel=1e-3)
    mean = np.einsum("hw,hwc->c", added, envmap.texel_directions(rows, 2 * rows))
    mean /= np.linalg.norm(mean)
    assert math.degrees(math.acos(min(1.0, float(mean @ towards)))) < 180 / rows
    assert is_neutral(lit)


@pytest.mark.parametrize("above", [0.0, 0.95])
def test_a_light_is_neutral_with_one_key_light_and_not_with_a_dark_spot_or_a_wide_one(above):
    even = white_light(above, 64)
    overhead = KeyLight(np.array([0.05, 0.99, 0.1]) / np.linalg.norm([0.05, 0.99, 0.1]), 3.0, 20)
    assert is_neutral(2 * with_key(even, overhead) * np.float32([1, 0.8, 0.6]))
    dark = even.copy()
    dark[20, 30] = 0.1
    wide = with_key(even, KeyLight(TOWARDS, 3.0, 45))
    assert not is_neutral(dark)
    assert not is_neutral(wide)
    assert SPOT < 0.1


@settings(max_examples=60, deadline=None)
@given(st.floats(1e-4, 1e6))
def test_radiance_and_its_parameter_are_inverse_of_one_another(radiance):
    value = torch.tensor([radiance], dtype=torch.float64)
    assert float(envmap.radiance_of(envmap.parameter_of(value))) == pytest.approx(radiance, rel=1e-9)


def test_radiance_grows_on_smoothly_where_it_turns_exponential():
    near = envmap.BRIGHT + torch.linspace(-1e-3, 1e-3, 5, dtype=torch.float64)
    near.requires_grad_()
    (slope,) = torch.autograd.grad(envmap.radiance_of(near).sum(), near)
    assert torch.allclose(slope, torch.ones_like(slope), atol=1e-4)
    assert torch.autograd.gradcheck(
        envmap.radiance_of, torch.tensor([-3.0, 19.0, 21.0, 90.0]).double().requires_grad_()
    )


def test_a_fit_starts_with_its_sun_apart_and_as_bright_as_the_photographs(carrier, train_views, transport):
    start = neutral_asset(carrier, StartSettings(base_color="gray"), key=KeyLight(TOWARDS, 4.0))
    model = Decomposition(
        carrier, train_views, transport, DecompositionSettings(environment_height=64), "cpu", start=start
    )
    assert model.neutral
    model.start()
    sky = envmap.radiance_of(model.environment.detach())
    assert len(find_suns(sky, len(transport.directions))) == 1
    assert model.light.suns is not None
    prepared, shown, photographed = model.prepare(0.0, 0), 0.0, 0.0
    for buffer in model.buffers:
        shown += float((model.shade(buffer, prepared)[0].detach() * buffer.coverage[:, None]).sum())
        photographed += float((buffer.target * buffer.coverage[:, None]).sum())
    assert shown == pytest.approx(photographed, rel=0.02)


def test_a_key_light_without_a_transport_says_what_to_wire(carrier):
    from exmesh_nodes import stage2 as nodes

    with pytest.raises(DataError, match="transport"):
        nodes.init(None, carrier, p=StartSettings(key_light=True))
