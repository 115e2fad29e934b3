"""Small bright lights: found, taken out without losing energy, sampled where they are, shadowed sharply."""

import math

import numpy as np
import pytest
import torch

from exmesh_graph.rays import make_ray_tracer
from exmesh_graph.shading import envmap
from exmesh_graph.shading.operators import LightTransport
from exmesh_graph.shading.point_sets import sobol_points
from exmesh_graph.shading.suns import find_suns, open_irradiance, overlap, seen_irradiance, sun_transfer, unoccluded
from exmesh_graph.shading.transport import lattice_origins, trace_transport, with_bounces
from tests.shading.monte_carlo_scenes import wall_and_floor
from tests.shading.shading_statistics import chi_square_excess


def _sky(height=32, level=0.3):
    return torch.full((height, 2 * height, 3), level)


def test_no_sun_where_none_is():
    assert len(find_suns(_sky(), 128)) == 0
    assert len(find_suns(_sky(level=0.0), 128)) == 0
    wide = _sky()
    wide[8:24, 20:36] = 100  # a window, which the directions resolve
    assert len(find_suns(wide, 128)) == 0
    dim = _sky(64)
    dim[20, 30] = 0.3 * 30  # bright but without power
    assert len(find_suns(dim, 128)) == 0


@pytest.mark.parametrize(("row", "column"), [(0, 5), (31, 63), (15, 0), (9, 40)])
def test_a_sun_at_the_pole_the_seam_or_elsewhere(row, column):
    sky = _sky()
    sky[row, column] = torch.tensor([3e4, 2e4, 1e4])
    suns = find_suns(sky, 128)
    assert suns.texel.tolist() == [row * 64 + column]
    flux = suns.flux(sky)
    angle = envmap.solid_angles(32, 64)[row]
    torch.testing.assert_close(flux[0], torch.tensor([3e4, 2e4, 1e4]) * float(angle))
    direction = suns.directions(torch.rand(4000, 3, generator=torch.Generator().manual_seed(0)))[0].mean(0)
    centre = torch.from_numpy(envmap.texel_directions(32, 64)[row, column]).float()
    assert float(direction @ centre) / float(direction.norm()) > math.cos(0.03 if 0 < row < 31 else 0.1)


def test_texels_across_the_seam_are_one_sun_and_others_another():
    sky = _sky()
    sky[10, 63] = sky[11, 0] = 1e4
    sky[25, 30] = 3e4
    suns = find_suns(sky, 64)
    assert len(suns) == 2
    assert suns.texel[suns.sun == 0].tolist() == [25 * 64 + 30]  # the strongest first
    assert sorted(suns.texel[suns.sun == 1].tolist()) == [10 * 64 + 63, 11 * 64]


def test_no_flux_is_lost_and_all_of_it_is_linear_in_the_texels():
    sky = torch.rand(32, 64, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    sky[4, 7] = sky[5, 7] = 5e4
    sky.requires_grad_()
    suns = find_suns(sky, 128)
    angle = torch.from_numpy(envmap.solid_angles(32, 64))[:, None, None]
    whole = suns.flux(sky).sum(0) + (suns.without(sky) * angle).sum((0, 1))
    torch.testing.assert_close(whole, (sky * angle).sum((0, 1)), rtol=1e-6, atol=0)
    whole.sum().backward()
    torch.testing.assert_close(sky.grad, angle.expand_as(sky), rtol=1e-6, atol=0)


def test_directions_follow_the_bilinear_radiance():
    """Chi-square over cells of a quarter texel, against the tents of three texels of different radiance."""
    sky = _sky(32, 0.01)
    bright = {(12, 20): 4e3, (12, 21): 1e3, (13, 21): 2e3}
    for place, value in bright.items():
        sky[place] = value
    suns = find_suns(sky, 64)
    assert len(suns) == 1
    count = 40_000
    found = suns.directions(torch.rand(count, 3, generator=torch.Generator().manual_seed(0)))[0]
    u, v = envmap.uv_of(found)
    cells = torch.histogramdd(
        torch.stack([v * 32, u * 64], 1).double(), bins=[12, 12], range=[11.5, 14.5, 19.5, 22.5]
    ).hist
    fine = (np.arange(12 * 8) + 0.5) / 32  # 8 x 8 quadrature points in a cell
    y, x = np.meshgrid(11.5 + fine, 19.5 + fine, indexing="ij")
    density = np.zeros_like(x)
    for (row, column), value in bright.items():
        tent = np.clip(1 - abs(y - row - 0.5), 0, None) * np.clip(1 - abs(x - column - 0.5), 0, None)
        density += tent * value * envmap.solid_angles(32, 64)[row]
    expected = density.reshape(12, 8, 12, 8).sum((1, 3))
    expected *= count / expected.sum()
    assert int(cells.sum()) == count
    assert chi_square_excess(cells.reshape(-1), torch.from_numpy(expected).reshape(-1)) < 4


def test_a_walls_shadow_ends_where_it_should():
    """The wall stands on the line z = 0 of the floor; a sun 45 degrees high behind it shades the floor up to z = 1."""
    vertices, faces = wall_and_floor()
    tracer = make_ray_tracer(vertices, faces)
    rng = torch.Generator().manual_seed(0)
    points = torch.rand(4000, 3, generator=rng, dtype=torch.float64)
    points[:, 1] = 1e-4
    up = torch.tensor([0.0, 1.0, 0.0]).expand(4000, 3)
    low, high = float(vertices[:4].min(0)[2]), float(vertices[:4].max(0)[2])
    points[:, 0] = 0.05 + 0.9 * points[:, 0]
    points[:, 2] = low + (high - low) * points[:, 2]
    for slope in (0.5, 2.0):
        towards = torch.nn.functional.normalize(torch.tensor([0.0, slope, -1.0]), dim=0)
        free = unoccluded(points, up, towards.expand(1, 4000, 3), tracer)[0]
        shaded = (points[:, 2] * slope < 1 - 1e-3).numpy()
        edge = np.abs(points[:, 2].numpy() * slope - 1) < 2e-3
        assert (free.numpy() == ~shaded)[~edge].all()
    below = unoccluded(points, up, torch.tensor([0.0, -0.1, 1.0]).expand(1, 4000, 3), tracer)
    assert not bool(below.any())


def test_transfer_is_the_cosine_of_what_is_seen_and_bounces_like_a_direction():
    vertices, faces = wall_and_floor()
    tracer = make_ray_tracer(vertices, faces)
    light = with_bounces(trace_transport(vertices, faces, 64, steps=6), 1)
    sky = _sky(64)
    sky[16, 64 + 3] = 2e4
    suns = find_suns(sky, 64)
    origins = torch.from_numpy(lattice_origins(light, vertices, faces, tracer.radius))
    normal = torch.from_numpy(light.normals)
    transfer = sun_transfer(suns, origins, normal, normal, tracer)
    towards = torch.from_numpy(envmap.texel_directions(64, 128)[16, 67]).float()
    expected = (normal @ towards).clamp_min(0)
    seen = transfer[:, 0] > 0
    assert bool((expected[seen] > 0).all())
    torch.testing.assert_close(transfer[seen, 0], expected[seen], rtol=0.1, atol=0.02)
    operators = LightTransport(light).with_columns(transfer)
    rows = torch.rand(65, 3, generator=torch.Generator().manual_seed(0))
    rho = torch.rand(len(light.points), 3, generator=torch.Generator().manual_seed(1))
    direct = LightTransport(light).transfer @ rows[:64] + transfer @ rows[64:]
    torch.testing.assert_close(operators.irradiance(rows), direct)
    torch.testing.assert_close(operators.irradiance(rows, rho), direct + operators.gather @ (rho * direct))
    operators.transfer, operators.gather, operators.gather_transposed = (
        m.double() for m in (operators.transfer, operators.gather, operators.gather_transposed)
    )
    inputs = tuple(t.double().requires_grad_() for t in (rows, rho))
    assert torch.autograd.gradcheck(lambda e, a: operators.irradiance(e, a, 0.6), inputs)


@pytest.mark.parametrize("kind", [torch.float32, torch.float64])
def test_transfer_is_what_all_rays_at_once_give_but_where_half_of_them_agree(kind):
    vertices, faces = wall_and_floor()
    tracer = make_ray_tracer(vertices, faces)
    light = trace_transport(vertices, faces, 256, steps=12)
    sky = _sky(64)
    sky[16, 64 + 3], sky[20, 20] = 2e4, 9e3
    suns = find_suns(sky, 64)
    assert len(suns) == 2
    rng = torch.Generator().manual_seed(3)
    origins = torch.from_numpy(lattice_origins(light, vertices, faces, tracer.radius)).to(kind)
    flat = torch.from_numpy(light.normals).to(kind)
    normal = torch.nn.functional.normalize(flat + 0.3 * torch.randn(flat.shape, generator=rng).to(kind), dim=1)
    ours = sun_transfer(suns, origins, normal, flat, tracer)
    rays, cosine = _reference(suns, origins, normal, flat, tracer)
    first, shown = rays[:, :4], cosine[:, :4] > 0
    agree = shown.any(1) & (((first > 0) == shown).all(1) | ~(first > 0).any(1))
    clear = agree & (first > 0).any(1)
    expected = torch.where(agree[:, None], torch.where(clear[:, None], cosine, 0), rays)
    expected[:, :4] = first
    torch.testing.assert_close(ours, expected.mean(1), rtol=1e-5, atol=1e-6)
    whole = rays.mean(1)
    assert float((ours - whole).abs().mean() / whole.mean()) < 0.01  # penumbras are a small part
    assert bool((~agree & (whole > 0)).any())


def _reference(suns, origins, normal, flat, tracer, samples=8):
    """[N, samples, S]: irradiance by each direction, all points and suns at once; and where nothing were in between."""
    directions = suns.directions(sobol_points(samples))
    parts, open_ = [], []
    for number in range(samples):
        towards = directions[:, number, None].expand(len(suns), len(normal), 3)
        cosine = (towards * normal).sum(-1).clamp_min(0) * ((towards * flat).sum(-1) > 0)
        parts.append((cosine * unoccluded(origins, flat, towards, tracer)).t())
        open_.append(cosine.t())
    return torch.stack(parts, 1), torch.stack(open_, 1)


def test_overlap_is_the_light_that_leaves_from_the_same_places():
    sky = torch.full((32, 64, 3), 0.01)
    sky[8, 20], sky[8, 21], sky[20, 50] = 60.0, 20.0, 50.0
    suns = find_suns(sky, 64)
    assert len(suns) == 2
    assert overlap(suns, find_suns(3 * sky, 64)) == pytest.approx(1)
    for change, expected in (((20.0, 60.0), 0.5), ((60.0, 0.01), 0.75), ((0.01, 90.0), 0.25)):
        moved = sky.clone()
        moved[8, 20], moved[8, 21] = change
        there = find_suns(moved, 64)
        assert overlap(suns, there) == pytest.approx(expected, abs=1e-3)
        assert overlap(there, suns) == pytest.approx(expected, abs=1e-3)
    moved[20, 50] = 0.01
    assert overlap(suns, find_suns(moved, 64)) == 0
    assert overlap(suns, find_suns(torch.ones(16, 32, 3), 64)) == 0


def test_open_irradiance_is_what_is_seen_where_nothing_stands_in_the_way():
    away = make_ray_tracer(np.array([[90.0, 0, 0], [91, 0, 0], [90, 1, 0]]), np.array([[0, 1, 2]]))
    generator = torch.Generator().manual_seed(0)
    normal, flat, towards = (
        torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=-1) for count in (400, 400, 8)
    )
    free = open_irradiance(towards, normal, flat)
    seen = seen_irradiance(towards, torch.zeros(400, 3, dtype=torch.float64), normal, flat, away)
    torch.testing.assert_close(seen, free)
    cosine = (normal @ towards.T).clamp_min(0) * (flat @ towards.T > 0)
    torch.testing.assert_close(free, cosine.mean(1))
