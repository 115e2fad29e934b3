"""Precomputed transport against closed forms, brute-force quadrature and finite differences."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import angle_weighted_normals, face_normals
from exmesh_graph.gpu.cores import cores
from exmesh_graph.rays import make_ray_tracer, offset_origins
from exmesh_graph.shading import envmap
from exmesh_graph.shading.lattice import build_lattice, locate
from exmesh_graph.shading.operators import MOST_BEYOND, Binning, Deeper, LightTransport, at_surface
from exmesh_graph.shading.products import dense_adjoint, dense_product, sparse_product
from exmesh_graph.shading.transport import check_fits, choose_steps, trace_transport, with_bounces
from exmesh_graph.types import Transport


def _sphere(count=16):
    """A closed sphere of radius 0.8: (vertices float32, faces int32)."""
    lat = np.linspace(0, np.pi, count + 1)[1:-1]
    lon = np.linspace(0, 2 * np.pi, 2 * count, endpoint=False)
    t, p = np.meshgrid(lat, lon, indexing="ij")
    ring = np.stack([np.sin(t) * np.sin(p), np.cos(t), np.sin(t) * np.cos(p)], -1).reshape(-1, 3)
    vertices = 0.8 * np.concatenate([[[0, 1, 0]], ring, [[0, -1, 0]]])
    n, faces = 2 * count, []
    for j in range(n):
        k = (j + 1) % n
        faces.append([0, 1 + j, 1 + k])
        for i in range(len(lat) - 1):
            a, b = 1 + i * n, 1 + (i + 1) * n
            faces += [[a + j, b + j, b + k], [a + j, b + k, a + k]]
        faces.append([len(vertices) - 1, 1 + (len(lat) - 1) * n + k, 1 + (len(lat) - 1) * n + j])
    return vertices.astype(np.float32), np.array(faces, np.int32)


def _corner():
    """Floor (y = 0, x > 0) and wall (x = 0, y > 0), both 1 x 2, facing into one another; doubled at the crease."""
    vertices = [[0, 0, -1], [1, 0, -1], [1, 0, 1], [0, 0, 1], [0, 0, -1], [0, 1, -1], [0, 1, 1], [0, 0, 1]]
    faces = [[0, 3, 2], [0, 2, 1], [4, 5, 6], [4, 6, 7]]
    return np.array(vertices, np.float32), np.array(faces, np.int32)


@settings(max_examples=20, deadline=None)
@given(n=st.integers(1, 6), seed=st.integers(0, 10_000))
def test_lattice_interpolates_linear_functions_exactly(n, seed):
    vertices, faces = _sphere(4)
    lattice = build_lattice(vertices, faces, n)
    rng = np.random.default_rng(seed)
    face = rng.integers(0, len(faces), 200)
    bary = rng.dirichlet([0.5] * 3, 200)
    bary[:3] = np.eye(3)
    index, weight = locate(lattice, face, bary)
    assert (weight >= 0).all()
    np.testing.assert_allclose(weight.sum(axis=1), 1, rtol=1e-6)
    expected = np.einsum("nc,ncx->nx", bary, vertices[faces[face]])
    np.testing.assert_allclose(np.einsum("nc,ncx->nx", weight, lattice.points[index]), expected, atol=1e-6)


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_lattice_points_are_shared(n):
    vertices, faces = _sphere(4)
    lattice = build_lattice(vertices, faces, n)
    edges = len(faces) * 3 // 2
    inside = (n - 1) * (n - 2) // 2
    assert len(lattice.points) == len(vertices) + edges * (n - 1) + len(faces) * inside
    assert len(np.unique(np.round(lattice.points, 5), axis=0)) == len(lattice.points)
    on_face = np.einsum("pc,pcx->px", lattice.point_bary, vertices[faces[lattice.point_face]])
    np.testing.assert_allclose(on_face, lattice.points, atol=1e-7)


def test_a_symmetric_body_keeps_its_carrying_faces_under_rounding():
    vertices = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float64) * 0.8
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    expected = build_lattice(vertices, faces, 4).point_face
    for seed in range(4):
        moved = vertices + np.random.default_rng(seed).uniform(-1e-7, 1e-7, vertices.shape)
        np.testing.assert_array_equal(build_lattice(moved, faces, 4).point_face, expected)


def test_normals_of_a_sphere_and_degenerate_faces():
    vertices, faces = _sphere(24)
    np.testing.assert_allclose(angle_weighted_normals(vertices, faces), vertices / 0.8, atol=0.02)
    flat = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]], float)
    assert (face_normals(flat, np.array([[0, 1, 2]])) == 0).all()


def test_faces_of_unlike_steps_share_what_both_have():
    """Two triangles of a square, 2 and 4 steps: 6 + 15 points, of which the diagonal's 3 of the coarser are shared."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)
    faces = np.array([[0, 1, 2], [2, 3, 0]])
    lattice = build_lattice(vertices, faces, np.array([2, 4]))
    assert len(lattice.points) == 6 + 15 - 3
    assert len(np.unique(np.round(lattice.points, 6), axis=0)) == len(lattice.points)
    rng = np.random.default_rng(0)
    face, bary = rng.integers(0, 2, 100), rng.dirichlet([0.5] * 3, 100)
    index, weight = locate(lattice, face, bary)
    expected = np.einsum("nc,ncx->nx", bary, vertices[faces[face]])
    np.testing.assert_allclose(np.einsum("nc,ncx->nx", weight, lattice.points[index]), expected, atol=1e-6)


def test_steps_reach_the_count_and_follow_the_faces_size():
    vertices, faces = _sphere(6)
    for points in (1, 500, 5000):
        steps = choose_steps(vertices, faces, points)
        found = len(build_lattice(vertices, faces, steps).points)
        assert found >= points
        assert found < max(4.5 * points, len(vertices) + 1)  # twice the steps are four times the points
    # a floor of two triangles under the sphere: its points stand as close together as the sphere's
    floor = np.array([[-2, -1, -2], [2, -1, -2], [2, -1, 2], [-2, -1, 2]], np.float32)
    whole = np.concatenate([vertices, floor])
    n = len(vertices)
    both = np.concatenate([faces, [[n, n + 1, n + 2], [n, n + 2, n + 3]]]).astype(np.int32)
    steps = choose_steps(whole, both, 3000)
    lattice = build_lattice(whole, both, steps)
    assert len(lattice.points) >= 3000
    on_floor = (lattice.points[:, 1] < -0.99).sum()
    share = 16 / (16 + 4 * np.pi * 0.8**2)
    assert on_floor / len(lattice.points) == pytest.approx(share, abs=0.2)
    counted = np.arange(len(both)) < len(faces)  # what is not counted does not change how densely the rest is sampled
    np.testing.assert_array_equal(
        choose_steps(whole, both, 500, counted)[: len(faces)], choose_steps(vertices, faces, 500)
    )
    # and the rest has no more points than were asked for, however few and small the counted faces are
    few = np.arange(len(both)) == 0
    assert choose_steps(whole, both, 3000, few)[0] ** 2 > 3000
    assert len(build_lattice(whole, both, choose_steps(whole, both, 3000, few)).points) < 6 * 3000


def test_a_large_face_gets_points_though_fine_parts_have_corners_enough():
    vertices, faces = _sphere(40)
    wall = np.array([[-2, -1, -2], [2, -1, -2], [2, -1, 2], [-2, -1, 2]], np.float32)
    n = len(vertices)
    both = np.concatenate([faces, [[n, n + 1, n + 2], [n, n + 2, n + 3]]]).astype(np.int32)
    steps = choose_steps(np.concatenate([vertices, wall]), both, 1000)
    assert n > 1000
    assert (steps[:-2] == 1).all()
    share = 16 / (16 + 4 * np.pi * 0.8**2)
    assert steps[-1] ** 2 > 0.5 * share * 1000  # of its share of 1000 points, within a factor of two in the spacing


def test_the_shadow_on_a_floor_of_two_triangles_is_sharp():
    """A lamp over a ball over a floor: the floor's irradiance against 32 times as dense a lattice."""
    ball, faces = _sphere(10)
    ball = 0.5 * ball + np.array([0, 0.45, 0], np.float32)
    n = len(ball)
    vertices = np.concatenate([ball, [[-2, 0, -2], [2, 0, -2], [2, 0, 2], [-2, 0, 2]]]).astype(np.float32)
    both = np.concatenate([faces, [[n, n + 2, n + 1], [n, n + 3, n + 2]]]).astype(np.int32)
    sky = np.full((16, 32, 3), 0.3, np.float32)
    sky[3:5, 5:7] = 20
    rng = np.random.default_rng(0)
    place = torch.from_numpy(len(both) - 2 + rng.integers(0, 2, 500)), torch.from_numpy(rng.dirichlet([1.0] * 3, 500))

    def received(steps):
        operators = LightTransport(trace_transport(vertices, both, 128, steps))
        light = operators.bin_matrix(16, 32) @ torch.from_numpy(sky).reshape(-1, 3)
        return at_surface(operators.light, operators.irradiance(light), *place)[:, 0]

    dense = received(np.where(np.arange(len(both)) < len(faces), 1, 128))
    steps = choose_steps(vertices, both, 1500)
    wrong = ((received(steps) - dense).square().mean().sqrt() / dense.mean()).item()
    even = ((received(5) - dense).square().mean().sqrt() / dense.mean()).item()
    assert len(build_lattice(vertices, both, 5).points) > len(build_lattice(vertices, both, steps).points)
    assert wrong < 0.3 * even


def test_convex_body_in_uniform_light_receives_pi_everywhere():
    vertices, faces = _sphere(24)
    light = trace_transport(vertices, faces, 512)
    assert len(light.hit_point) == 0
    operators = LightTransport(light)
    uniform = operators.bin_matrix(16, 32) @ torch.ones(16 * 32, 3)
    np.testing.assert_allclose(operators.irradiance(uniform).numpy(), math.pi, rtol=0.06)


@pytest.mark.parametrize(("height", "directions"), [(8, 512), (32, 128), (25, 64)])
def test_binning_keeps_the_energy_of_every_texel(height, directions):
    vertices, faces = _corner()
    operators = LightTransport(trace_transport(vertices, faces, directions))
    matrix = operators.bin_matrix(height, 2 * height).to_dense()
    per_texel = np.repeat(envmap.solid_angles(height, 2 * height), 2 * height)
    np.testing.assert_allclose(matrix.sum(0).numpy(), per_texel, rtol=1e-5)
    assert bool((matrix.sum(1) > 0).all())


@pytest.mark.parametrize("height", [4, 25])
def test_binning_by_rows_equals_the_plain_product(height):
    """Value and gradient in float64, of a sky with black texels and a sun; directions without a texel too."""
    vertices, faces = _corner()
    matrix = LightTransport(trace_transport(vertices, faces, 200)).bin_matrix(height, 2 * height)
    generator = torch.Generator().manual_seed(0)
    sky = (torch.rand(height, 2 * height, 3, generator=generator) - 0.5).clamp_min(0)
    sky[height // 2, 3] = 1e5
    weight = torch.rand(200, 3, generator=generator)
    results = []
    for convert, product in (
        (torch.Tensor.float, Binning(matrix)),
        (torch.Tensor.double, lambda sky: matrix.double().to_dense() @ sky.reshape(-1, 3)),
    ):
        texels = convert(sky).requires_grad_()
        binned = product(texels)
        (gradient,) = torch.autograd.grad((binned * convert(weight)).sum(), texels)
        results.append((binned.detach().double(), gradient.double()))
    torch.testing.assert_close(results[0][0], results[1][0], rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(results[0][1], results[1][1], rtol=1e-5, atol=1e-8)


def test_irradiance_equals_brute_force_quadrature():
    """The corner under a rough sky, against a sum over 20 000 directions with a ray for each."""
    vertices, faces = _corner()
    generator = torch.Generator().manual_seed(3)
    sky = torch.rand(16, 32, 3, generator=generator) ** 4
    light = trace_transport(vertices, faces, 2048, steps=3)
    operators = LightTransport(light)
    fast = operators.irradiance(operators.bin_matrix(16, 32) @ sky.reshape(-1, 3)).numpy()
    rng = np.random.default_rng(0)
    d = rng.normal(size=(20_000, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    radiance = envmap.lookup(sky, torch.from_numpy(d).float()).numpy()
    tracer = make_ray_tracer(vertices, faces)
    flat = face_normals(vertices, faces)
    centre = vertices[faces[light.point_face]].mean(axis=1)
    for p in range(0, len(fast), 5):
        origin = light.points[p] + 0.02 * (centre[p] - light.points[p])
        origin = offset_origins(origin[None].astype(float), flat[light.point_face[p]][None], tracer.radius)
        free = ~tracer.any_hit(np.repeat(origin, len(d), 0), d)
        cosine = np.clip(d @ light.normals[p], 0, None) * free
        slow = (cosine[:, None] * radiance).mean(axis=0) * 4 * math.pi
        np.testing.assert_allclose(fast[p], slow, rtol=0.06, atol=0.01)


def test_secondary_hits_lie_on_their_rays():
    vertices, faces = _corner()
    light = trace_transport(vertices, faces, 200, steps=2)
    bary = np.concatenate([1 - light.hit_bary.sum(1, keepdims=True), light.hit_bary], axis=1)
    hit = np.einsum("bc,bcx->bx", bary, vertices[faces[light.hit_face]])
    ray = hit - light.points[light.hit_point]
    direction = light.directions[light.hit_direction]
    across = np.linalg.norm(np.cross(ray, direction), axis=1)
    assert len(hit) > 300
    assert np.percentile(across, 99) < 0.03  # origins stand up to 2 % of a face inside of their points
    assert (ray * direction).sum(1).min() > -0.03


def test_form_factor_of_a_corner():
    """A point on the floor receives from an infinite-looking wall the share (1 - cos) / 2; one bounce adds it."""
    vertices, faces = _corner()
    vertices = vertices * np.array([1, 1, 60], np.float32)  # long along z: two dimensional
    light = with_bounces(trace_transport(vertices, faces, 4096, steps=8), 1)
    operators = LightTransport(light)
    white = torch.full((len(light.points), 3), 1 / math.pi)  # f_d of albedo 1
    wall = torch.zeros(len(light.points), 3)
    wall[torch.from_numpy(light.normals[:, 0] > 0.5)] = math.pi  # the wall leaves radiance 1
    received = operators.gather @ (white * wall)
    middle = np.flatnonzero(
        (light.normals[:, 1] > 0.5) & (np.abs(light.points[:, 2]) < 20) & (light.points[:, 0] > 0.2)
    )
    x = light.points[middle, 0]
    expected = math.pi * 0.5 * (1 - x / np.sqrt(1 + x**2))
    np.testing.assert_allclose(received[middle, 0].numpy(), expected, rtol=0.05, atol=0.02)


def test_bounces_are_the_neumann_series():
    vertices, faces = _corner()
    light = trace_transport(vertices, faces, 256, steps=3)
    rho = torch.rand(len(light.points), 3, generator=torch.Generator().manual_seed(0)) / math.pi
    radiance = torch.rand(256, 3, generator=torch.Generator().manual_seed(1))
    dense = None
    for bounces in (1, 2, 5):
        operators = LightTransport(with_bounces(light, bounces))
        dense = operators.gather.to_dense()
        torch.testing.assert_close(operators.gather_transposed.to_dense(), dense.T)
        total = term = operators.transfer @ radiance
        for _ in range(bounces):
            term = 0.7 * (dense @ (rho * term))
            total = total + term
        torch.testing.assert_close(operators.irradiance(radiance, rho, 0.7), total, rtol=1e-5, atol=1e-6)
    # no point can receive more than the hemisphere holds
    assert float(dense.sum(1).max()) <= math.pi * 1.05


@pytest.mark.parametrize("secondary_material", [True, False])
@pytest.mark.parametrize("bounces", [1, 2])
def test_from_call_to_call_deeper_bounces_come_to_all_of_them(bounces, secondary_material):
    """Between nearly white walls; the light doubles on the way."""
    vertices, faces = _corner()
    light = trace_transport(vertices, faces, 256, steps=3)
    few = LightTransport(with_bounces(light, bounces, secondary_material))
    many = LightTransport(with_bounces(light, 60, secondary_material))
    generator = torch.Generator().manual_seed(0)
    rho = (0.9 + 0.08 * torch.rand(len(light.points), 3, generator=generator)) / math.pi
    radiance = torch.rand(256, 3, generator=generator)
    deeper = Deeper()
    first = few.irradiance(radiance, rho, 1.0, deeper)
    torch.testing.assert_close(first, few.irradiance(radiance, rho))
    for _ in range(20):
        few.irradiance(radiance, rho, 1.0, deeper)
    for _ in range(20):
        found = few.irradiance(2 * radiance, rho, 1.0, deeper)
    whole = many.irradiance(2 * radiance, rho)
    torch.testing.assert_close(found, whole, rtol=1e-5, atol=1e-6)
    assert float((whole / few.irradiance(2 * radiance, rho)).max()) > 1.03  # what it was worth
    settled = LightTransport(with_bounces(light, bounces, secondary_material, deeper=True))
    torch.testing.assert_close(settled.irradiance(2 * radiance, rho), whole, rtol=1e-3, atol=1e-3)


def test_deeper_bounces_between_walls_that_send_more_than_they_get_stay_bounded():
    vertices, faces = _corner()
    light = trace_transport(vertices, faces, 256, steps=3)
    operators = LightTransport(with_bounces(light, 1))
    rho, radiance = torch.full((len(light.points), 3), 20.0), torch.rand(256, 3)
    deeper = Deeper()
    for _ in range(200):
        found = operators.irradiance(radiance, rho, 1.0, deeper)
    assert torch.isfinite(found).all()
    assert deeper.rest is not None
    assert (deeper.rest <= MOST_BEYOND * operators.direct(radiance).amax(0) + 1e-3).all()


def test_the_gradient_of_deeper_bounces_holds_what_was_before():
    vertices, faces = _corner()
    operators = LightTransport(with_bounces(trace_transport(vertices, faces, 32), 2))
    operators.transfer = operators.transfer.double()
    operators.gather, operators.gather_transposed = operators.gather.double(), operators.gather_transposed.double()
    generator = torch.Generator().manual_seed(0)
    radiance = torch.rand(32, 3, generator=generator, dtype=torch.float64, requires_grad=True)
    rho = torch.rand(len(operators.light.points), 3, generator=generator, dtype=torch.float64, requires_grad=True)
    rest = torch.rand(len(operators.light.points), 3, generator=generator, dtype=torch.float64)

    def found(e: torch.Tensor, a: torch.Tensor) -> torch.Tensor:
        deeper = Deeper()
        deeper.rest = rest
        return operators.irradiance(e, a, 0.6, deeper)

    assert torch.autograd.gradcheck(found, (radiance, rho))


def test_without_secondary_material_the_receivers_own_colour_stands_in():
    vertices, faces = _corner()
    traced = trace_transport(vertices, faces, 64)
    own, stand_in = (LightTransport(with_bounces(traced, 1, material)) for material in (True, False))
    generator = torch.Generator().manual_seed(0)
    radiance = torch.rand(64, 3, generator=generator)
    rho = torch.rand(len(traced.points), 3, generator=generator)
    direct = own.transfer @ radiance
    gather = own.gather.to_dense()
    torch.testing.assert_close(own.irradiance(radiance, rho, 0.7), direct + 0.7 * gather @ (rho * direct))
    torch.testing.assert_close(stand_in.irradiance(radiance, rho, 0.7), direct + 0.7 * rho * (gather @ direct))
    one = torch.full_like(rho, 0.2)  # of one colour everywhere: the same light
    torch.testing.assert_close(own.irradiance(radiance, one), stand_in.irradiance(radiance, one))


@pytest.mark.parametrize("secondary_material", [True, False])
def test_adjoints_match_finite_differences(secondary_material):
    vertices, faces = _corner()
    operators = LightTransport(with_bounces(trace_transport(vertices, faces, 32), 3, secondary_material))
    operators.transfer = operators.transfer.double()
    operators.gather, operators.gather_transposed = operators.gather.double(), operators.gather_transposed.double()
    assert operators.gather.values().numel() > 0
    generator = torch.Generator().manual_seed(0)
    radiance = torch.rand(32, 3, generator=generator, dtype=torch.float64, requires_grad=True)
    rho = torch.rand(len(operators.light.points), 3, generator=generator, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda e, a: operators.irradiance(e, a, 0.6), (radiance, rho))


def test_back_faces_return_nothing():
    """The same corner wound the other way still blocks, but its back gives no light."""
    vertices, faces = _corner()
    faces = faces.copy()
    faces[2:] = faces[2:, ::-1]  # the wall faces away from the floor
    light = trace_transport(vertices, faces, 256)
    floor = np.flatnonzero(light.normals[:, 1] > 0.5)
    assert not np.isin(light.hit_point, floor).any()
    blocked = LightTransport(light).visible[floor].sum(1) < 128 - 20
    assert bool(blocked.any())


def test_visibility_does_not_depend_on_scale_or_place():
    vertices, faces = _corner()
    reference = trace_transport(vertices, faces, 128, steps=2)
    for scale, shift in ((1e-3, 0.0), (1e3, 0.0), (1.0, 100.0)):
        moved = trace_transport((vertices * scale + shift).astype(np.float32), faces, 128, steps=2)
        differing = np.unpackbits(moved.visible ^ reference.visible).sum()
        assert differing <= 0.002 * reference.visible.size * 8


def test_transport_round_trip_and_mesh_check(tmp_path):
    vertices, faces = _corner()
    light = with_bounces(trace_transport(vertices, faces, 64, steps=2), 2)
    light.save(tmp_path)
    again = Transport.load(tmp_path)
    assert (again.bounces, set(again.steps)) == (2, {2})
    for name in ("visible", "hit_bary", "gather_weight", "points", "hit_direction"):
        np.testing.assert_array_equal(getattr(again, name), getattr(light, name))
        assert getattr(again, name).dtype == getattr(light, name).dtype
    check_fits(again, vertices, faces)
    with pytest.raises(GeometryError, match="another mesh"):
        check_fits(again, vertices + 0.01, faces)
    with pytest.raises(GeometryError, match="another mesh"):
        check_fits(again, vertices, faces[:2])


@pytest.mark.parametrize("points", [1, 7, 1024, 2500])
def test_products_on_a_cpu_are_those_of_torch_in_float64_with_the_same_bytes_on_any_cores(points):
    generator = torch.Generator().manual_seed(points)
    transfer = torch.rand(37, points, generator=generator).t()
    light, gradient = torch.randn(37, 3, generator=generator), torch.randn(points, 3, generator=generator)
    dense = torch.where(torch.rand(points, points, generator=generator) < 0.01, 1.5, 0.0)
    sparse = dense.to_sparse_csr()
    matrix = torch.sparse_csr_tensor(
        sparse.crow_indices().int(), sparse.col_indices().int(), sparse.values(), sparse.shape
    )
    found = []
    for count in (1, 2, 3):
        with cores(count):
            found.append(
                (
                    dense_product(transfer, light),
                    dense_adjoint(transfer, gradient),
                    sparse_product(matrix, gradient),
                )
            )
    wide, back = transfer.double(), gradient.double()
    expected = (wide @ light.double(), wide.T @ back, dense.double() @ back)
    for one, known in zip(found[0], expected, strict=True):
        torch.testing.assert_close(one.double(), known, rtol=1e-5, atol=1e-4)
    for others in found[1:]:
        assert all(torch.equal(a, b) for a, b in zip(others, found[0], strict=True))
