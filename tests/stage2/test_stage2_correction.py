"""The specular factor's start and the light a mirrored surface sends, each against its definition spelt out."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks import corrections
from exmesh_graph.shading import envmap
from exmesh_graph.shading.lattice import face_starts
from exmesh_graph.shading.operators import at_surface
from exmesh_graph.shading.specular import scattered
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.light import correction
from exmesh_graph.stage2.light.correction import measured_specular_scale
from exmesh_graph.stage2.light.precomputed import initial_specular_scale
from exmesh_graph.stage2.light.sparse import HEARD, Sparse, find_near, plain_near, shared_lobes
from exmesh_graph.stage2.maps import Appearance
from exmesh_graph.stage2.settings import DecompositionSettings
from exmesh_graph.stage2.surface import texel_footprint


@pytest.fixture(scope="module", params=[False, True])
def model(request, carrier, train_views, transport):
    settings = DecompositionSettings(iterations=2, texture_size=64, environment_height=16, metallic=request.param)
    return Decomposition(carrier, train_views, transport, settings, "cpu")


def test_the_factor_starts_as_the_lobes_visible_share(model):
    """Pixel by pixel: visibility interpolated between the three lattice points, averaged over the GGX lobe."""
    model.light.start(model.maps, envmap.radiance_of(model.environment.detach()), model.buffers)
    bits = model.light.operators.visible.double().numpy()
    sky = np.asarray(model.light.operators.light.directions, float)
    alpha = max(0.5**2, math.sqrt(4 * math.pi / len(sky)) / 4)
    values = []
    for buffer in model.buffers[:3]:
        kept = buffer.light
        reflected = buffer.samples(model.geometry).reflected.double().numpy()
        for pixel in range(0, len(buffer.pixel), 17):
            seen = sum(
                float(w) * bits[int(p)] for p, w in zip(kept.point[pixel], kept.point_weight[pixel], strict=True)
            )
            cosine = sky @ reflected[pixel]
            lobe = np.clip(cosine, 0, None) / (alpha**2 + (1 - alpha**2) * (1 - cosine) / 2) ** 2
            expected = (lobe * seen).sum() / lobe.sum()
            found = kept.specular_scale[pixel].numpy()
            np.testing.assert_allclose(found, expected, atol=1e-4)
            values.append(expected)
    assert min(values) < 0.3  # under the ball, at grazing angles
    assert max(values) > 0.9


def test_every_pixel_is_set_whatever_the_chunk(model):
    for buffer in model.buffers:
        whole = initial_specular_scale(model.light, buffer, 0.5, plain=True)
        torch.testing.assert_close(initial_specular_scale(model.light, buffer, 0.5, chunk=7, plain=True), whole)


@pytest.mark.parametrize(("roughness", "every"), [(0.5, 1), (0.02, 1), (1.0, 2), (0.3, 5)])
def test_the_fused_start_equals_the_plain_one(model, roughness, every, monkeypatch):
    """Any number of directions, of which a row of eight may be left over; lobes narrower than they resolve."""
    operators = model.light.operators
    fewer = replace(operators.light, directions=operators.light.directions[1::every])
    monkeypatch.setattr(operators, "light", fewer)
    monkeypatch.setattr(operators, "visible", operators.visible[:, 1::every].contiguous())
    for buffer in model.buffers[:4]:
        plain = initial_specular_scale(model.light, buffer, roughness, plain=True)
        torch.testing.assert_close(initial_specular_scale(model.light, buffer, roughness), plain, rtol=1e-4, atol=1e-5)


def test_rays_of_neighbours_count_as_far_as_their_lobes_are_a_pixels_own(model, monkeypatch):
    """The factor is the ratio of sums over a pixel and those beside it on one surface, and rays are fewer for it."""
    buffer = model.buffers[2]
    first, second, third = (torch.Generator().manual_seed(k) for k in range(3))
    traced, split = (
        torch.rand(len(buffer.pixel), 3, generator=first),
        torch.rand(len(buffer.pixel), 3, generator=second),
    )
    rays = []
    monkeypatch.setattr(correction, "traced_specular", lambda *args: (rays.append(args[-3:]), traced)[1])
    monkeypatch.setattr(model.light, "split_sum", lambda *_: split)
    material = model.maps.read(model.maps.values(), buffer.texel, buffer.texel_weight)
    found = measured_specular_scale(
        model.light, buffer, material, None, torch.ones(16, 32, 3), lambda face, bary: None, third
    )
    beside = [[] for _ in buffer.pixel]
    for one, other in buffer.pairs.tolist():
        beside[one].append(other)
        beside[other].append(one)
    assert {len(others) for others in beside} >= {2, 3, 4}
    mirrored, counted = buffer.samples(model.geometry).reflected.double(), []
    for pixel, others in enumerate(beside):
        alpha = float(material.roughness[pixel]) ** 2
        angle = torch.acos((mirrored[others] @ mirrored[pixel]).clamp(-1, 1))
        share = torch.exp(-((2 * torch.sin(angle / 2) / (2 * alpha)) ** 2))[:, None]
        counted.append(float(share.sum()))
        expected = (traced[pixel] + (share * traced[others]).sum(0)) / (split[pixel] + (share * split[others]).sum(0))
        torch.testing.assert_close(found[pixel].double(), expected.clamp(0, 4), rtol=1e-3, atol=1e-4)
    assert 1 < np.mean(counted) < 4
    ((count, shift, shared),) = rays
    assert count == math.ceil(16 / (1 + np.mean(counted)))
    assert shift.shape == (len(buffer.pixel), 2)
    assert count * shared == pytest.approx(16)


def test_some_pixels_of_a_buffer_have_all_that_was_theirs(model):
    """Whatever a view's buffer keeps for each of its pixels, by what has as many rows."""
    buffer = model.buffers[0]
    count, rows = len(buffer.pixel), torch.tensor([3, 11, 4])
    assert count not in (len(buffer.pairs), 3)
    some = buffer.at(rows)
    for whole, part in ((buffer, some), (buffer.light, some.light)):
        kept = {name for name, value in vars(whole).items() if isinstance(value, torch.Tensor) and len(value) == count}
        for name in kept - {"neighbours"}:  # made when asked for, of the pairs
            assert torch.equal(getattr(part, name), getattr(whole, name)[rows]), name
    assert some.neighbours.tolist() == [[k] * 4 for k in range(3)]


@pytest.mark.parametrize("every", [2, 3])
@pytest.mark.parametrize("roughness", [0.15, 0.5])
def test_crossings_and_what_they_do_not_speak_for_are_measured(model, every, roughness):
    """Pixel by pixel, by its row and column: who is measured, with whom, and from whom the others take the factor."""
    for buffer in model.buffers[:3]:
        surface = buffer.samples(model.geometry)
        rough = torch.full((len(buffer.pixel),), roughness)
        sparse = Sparse.of(buffer, surface, rough, every)
        rows = sparse.rows.tolist()
        width = buffer.box[1]
        places = [divmod(at, width) for at in buffer.box_pixel.tolist()]
        number = {at: k for k, at in enumerate(places)}
        others = dict(zip(sparse.others.tolist(), zip(sparse.corners, sparse.weight, strict=True), strict=True))
        assert sorted([*rows, *others]) == list(range(len(places)))
        assert len(rows) < (0.6 if roughness > 0.2 else 1) * len(places)

        def alike(one, places_of, number=number, surface=surface, rough=rough):
            """{pixel: how far its lobe is that of `one`} of those of the places that lie on its surface."""
            found = [number[at] for at in places_of if at in number]
            found = [k for k in found if k != one and bool(surface.joined(torch.tensor(one), torch.tensor(k)))]
            shares = shared_lobes(surface, rough, torch.tensor([found], dtype=torch.int64), torch.tensor([one]))[0]
            return dict(zip(found, shares.tolist(), strict=True))

        for pixel, (y, x) in enumerate(places):
            top, left = y - y % every, x - x % every
            crossing = (y, x) == (top, left)
            if crossing:
                around = [(y, x - every), (y, x + every), (y - every, x), (y + every, x)]
                beside = {rows[k] for k in sparse.near[rows.index(pixel)].tolist()} - {pixel}
                assert beside == set(alike(pixel, around))
                continue
            weight = {
                k: share * (1 - abs(y - places[k][0]) / every) * (1 - abs(x - places[k][1]) / every)
                for k, share in alike(pixel, [(top + a, left + b) for a in (0, every) for b in (0, every)]).items()
            }
            total = sum(weight.values())
            assert (pixel in others) == (total >= HEARD)
            if pixel in others:
                found: dict[int, float] = {}
                for place, part in zip(*(values.tolist() for values in others[pixel]), strict=True):
                    found[rows[place]] = found.get(rows[place], 0.0) + part
                for k, part in weight.items():
                    assert found.get(k, 0.0) == pytest.approx(part / total, abs=1e-5)


@pytest.mark.parametrize("every", [1, 2, 5])
@pytest.mark.parametrize("roughness", [0.0, 0.02, 0.3, 1.0])
def test_fused_crossings_equal_the_plain_ones(model, every, roughness):
    for buffer in model.buffers[:4]:
        surface = buffer.samples(model.geometry)
        rough = roughness + 0.2 * torch.rand(len(surface), generator=torch.Generator().manual_seed(0))
        near, share = find_near(buffer, surface, rough, every)
        there, wanted = plain_near(buffer, surface, rough, every)
        torch.testing.assert_close(share, wanted, rtol=1e-3, atol=1e-4)  # of 1 - cosine, which has few digits
        assert torch.equal(near[wanted > 0].long(), there[wanted > 0])
        assert bool((wanted[there == torch.arange(len(near))[:, None]] == 0).all())


def test_a_view_of_many_pixels_is_measured_as_well_at_its_crossings(model):
    """Against many rays of each pixel: hardly further off than all pixels with rays of their own, at a part of the
    rays."""
    environment = envmap.radiance_of(model.environment.detach())
    ramp = torch.linspace(0.2, 3.0, environment.shape[1])[None, :, None]
    appearance = Appearance(model.maps, model.maps.values(), (environment * ramp).contiguous())
    prepared = model.light.prepare(appearance)
    sent = torch.full((len(model.light.operators.light.points), 3), 0.3)

    def at(face, bary):
        return at_surface(model.light.operators.light, sent, face, bary)

    wrong = {}
    for buffer in model.buffers[:4]:
        material = model.maps.read(model.maps.values(), buffer.texel, buffer.texel_weight)

        def found(crossings, samples, buffer=buffer, material=material):
            rays = model.light.settings.replaced(correction_samples=samples)
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(model.light, "settings", rays)
                return measured_specular_scale(
                    model.light, buffer, material, prepared, appearance.environment, at,
                    torch.Generator().manual_seed(1), crossings,
                )  # fmt: skip

        exact = found(len(buffer.pixel), 1024)
        for name, crossings in (("all", len(buffer.pixel)), ("some", len(buffer.pixel) // 4)):
            wrong.setdefault(name, []).append(float((found(crossings, 16) - exact).abs().mean()))
    assert np.mean(wrong["some"]) < np.mean(wrong["all"])


def test_the_benchmark_of_corrections_tells_both_ways_apart(model, monkeypatch):
    monkeypatch.setattr(corrections, "MANY", 64)
    settings = model.light.settings
    whole, crossings = corrections.factors(model, 80)
    assert 0 < crossings.rms < whole.rms < 0.5
    assert model.light.settings is settings
    assert corrections.suns(model, 80) == []


def test_hits_send_what_they_scatter_of_their_irradiance(model):
    """At a lattice point: what the maps there scatter, of its irradiance; between points, linear."""
    values = model.maps.values().detach().clone()
    values[:, :3] = torch.rand(values[:, :3].shape, generator=torch.Generator().manual_seed(0))
    if model.settings.metallic:
        values[:, 4] = 0.25
    transport = model.light.operators.light
    count = len(transport.points)
    irradiance = torch.rand(count, 3, generator=torch.Generator().manual_seed(1))
    sent = model.light.lattice_sends(model.maps, values) * irradiance

    def radiance(face, bary):
        return at_surface(transport, sent, face, bary)

    corners = model.geometry.uvs[model.geometry.uv_faces[torch.from_numpy(transport.point_face.astype(np.int64))]]
    uv = (corners * torch.from_numpy(transport.point_bary)[..., None]).sum(1)
    index, weight = texel_footprint(uv, model.maps.size)
    whole = torch.full((model.maps.size**2, values.shape[1]), torch.nan)
    whole[model.maps.texels] = values
    material = (whole[index] * weight[..., None]).sum(1)
    metallic = material[:, 4] if model.settings.metallic else None
    leaving = scattered(material[:, :3], material[:, 3], metallic) * irradiance
    starts = face_starts(transport.steps)
    for face in range(0, len(transport.steps), 29):
        last = int(transport.steps[face])
        corner = [0, (last + 1) * (last + 2) // 2 - 1, last]  # lattice numbers of the face's corners
        for i, number in enumerate(corner):
            bary = torch.eye(3)[i : i + 1]
            found = radiance(torch.tensor([face]), bary)[0]
            torch.testing.assert_close(
                found, leaving[int(transport.face_points[starts[face] + number])], rtol=1e-5, atol=1e-6
            )
    middle = at_surface(transport, leaving, torch.tensor([3]), torch.tensor([[0.5, 0.5, 0.0]]))[0]
    torch.testing.assert_close(radiance(torch.tensor([3]), torch.tensor([[0.5, 0.5, 0.0]]))[0], middle)


CUDA = pytest.param(
    "cuda",
    marks=[pytest.mark.gpu, pytest.mark.skipif(not torch.cuda.is_available(), reason="torch sees no CUDA device")],
)


@pytest.mark.parametrize("device", ["cpu", CUDA])
def test_traced_specular_is_the_same_over_warp_as_over_embree(carrier, transport, device):
    from exmesh_graph.rays import make_ray_tracer
    from exmesh_graph.rays.warp_bvh import WarpTracer
    from exmesh_graph.shading.envmap import Pyramid
    from exmesh_graph.stage2.light.traced import traced_specular
    from exmesh_graph.stage2.surface import CarrierGeometry

    rng = np.random.default_rng(0)
    face = torch.from_numpy(rng.integers(0, len(carrier.faces), 600))
    bary = torch.from_numpy(rng.dirichlet([1, 1, 1], 600).astype(np.float32))
    leaving = torch.rand(len(transport.points), 3, generator=torch.Generator().manual_seed(2))
    sky = torch.rand(16, 32, 3, generator=torch.Generator().manual_seed(3))
    found = []
    for where, tracer in (
        ("cpu", make_ray_tracer(carrier.vertices, carrier.faces)),
        (device, WarpTracer(carrier.vertices, carrier.faces, device)),
    ):
        geometry = CarrierGeometry(carrier, where)
        surface = geometry.samples(face.to(where), bary.to(where), torch.tensor([0.3, 1.5, 2.0], device=where))
        radiance = traced_specular(
            surface,
            geometry.face_normals,
            torch.full((600,), 0.3, device=where),
            torch.full((600, 3), 0.04, device=where),
            Pyramid(sky.to(where)),
            tracer,
            lambda face, bary, sent=leaving.to(where): at_surface(transport, sent, face, bary),
            8,
            torch.rand(600, 2, generator=torch.Generator().manual_seed(0)),
        )
        found.append(radiance.cpu())
    assert 0 < float(found[0].mean()) < 1
    # a ray within rounding of an edge may meet the other side of it
    assert ((found[0] - found[1]).abs().amax(dim=1) < 1e-5).float().mean() > 0.99
