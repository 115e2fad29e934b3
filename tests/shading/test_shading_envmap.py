"""Conventions, energy and regularisers of lat-long environments."""

import math

import numpy as np
import pytest
import torch

from exmesh_graph.shading import envmap


@pytest.mark.parametrize(
    ("u", "v", "direction"),
    [
        (0.5, 0.5, (0, 0, 1)),
        (0.25, 0.5, (1, 0, 0)),
        (0.75, 0.5, (-1, 0, 0)),
        (0.3, 0.0, (0, 1, 0)),
        (0.3, 1, (0, -1, 0)),
    ],
)
def test_image_axes(u, v, direction):
    found = envmap.direction_of(torch.tensor(u), torch.tensor(v))
    np.testing.assert_allclose(found.numpy(), direction, atol=1e-6)


def test_directions_and_coordinates_invert_each_other():
    d = torch.randn(500, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    d /= d.norm(dim=-1, keepdim=True)
    torch.testing.assert_close(envmap.direction_of(*envmap.uv_of(d)), d)
    centres = torch.from_numpy(envmap.texel_directions(6, 12)).reshape(-1, 3)
    u, v = envmap.uv_of(centres)
    np.testing.assert_allclose((u * 12 - 0.5).numpy().reshape(6, 12)[2], np.arange(12), atol=1e-9)
    np.testing.assert_allclose((v * 6 - 0.5).numpy().reshape(6, 12)[:, 3], np.arange(6), atol=1e-9)


def test_lookup_is_exact_at_texels_and_wraps():
    image = torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    centres = torch.from_numpy(envmap.texel_directions(8, 16))
    torch.testing.assert_close(envmap.lookup(image, centres), image)
    seam = envmap.direction_of(torch.tensor(0.0).double(), torch.tensor(3.5 / 8).double())
    torch.testing.assert_close(envmap.lookup(image, seam), (image[3, 0] + image[3, 15]) / 2)


def test_lookup_gradient():
    image = torch.rand(4, 8, 3, dtype=torch.float64, requires_grad=True)
    d = torch.randn(9, 3, dtype=torch.float64)
    d /= d.norm(dim=-1, keepdim=True)
    assert torch.autograd.gradcheck(lambda e: envmap.lookup(e, d), (image,))


def test_solid_angles_cover_the_sphere():
    for height, width in ((1, 2), (7, 12), (64, 128)):
        assert envmap.solid_angles(height, width).sum() * width == pytest.approx(4 * math.pi, rel=1e-12)


@pytest.mark.parametrize("size", [(32, 64), (25, 50), (16, 32)])
def test_resample_keeps_energy_of_a_sun(size):
    image = np.full((50, 100, 3), 0.2, np.float32)
    image[12, 30] = 500
    image[1, 3] = 100
    new = envmap.resample(image, *size)
    old_flux = (image * envmap.solid_angles(50, 100)[:, None, None]).sum()
    new_flux = (new * envmap.solid_angles(*size)[:, None, None]).sum()
    assert new_flux == pytest.approx(old_flux, rel=0.05)


@pytest.mark.parametrize("size", [(32, 64), (25, 50), (100, 200)])
def test_resample_keeps_everything_in_its_place(size):
    source, target = envmap.texel_directions(50, 100), envmap.texel_directions(*size)
    axes = np.array([[0.5, 0.1, 0.0], [0.0, 0.4, 0.2], [0.1, 0.0, 0.6]])
    new = envmap.resample((1 + source @ axes).astype(np.float32), *size)
    np.testing.assert_allclose(new, 1 + target @ axes, atol=0.02)


def test_parameter_round_trip_and_non_negativity():
    radiance = torch.tensor([1e-4, 0.01, 1.0, 19.0, 25.0, 3e4])
    torch.testing.assert_close(envmap.radiance_of(envmap.parameter_of(radiance)), radiance, rtol=1e-3, atol=1e-6)
    assert float(envmap.radiance_of(torch.tensor(-100.0))) >= 0


def test_regularisers_do_not_see_the_seam_and_weight_by_solid_angle():
    image = torch.rand(8, 16, 3, dtype=torch.float64)
    shifted = image.roll(5, dims=1)
    torch.testing.assert_close(envmap.total_variation(shifted), envmap.total_variation(image))
    torch.testing.assert_close(envmap.chroma(shifted), envmap.chroma(image))
    assert float(envmap.chroma(torch.full((8, 16, 3), 0.7))) == pytest.approx(0, abs=1e-12)
    pole, equator = torch.zeros(2, 16, 32, 3, dtype=torch.float64)
    pole[0, 4], equator[8, 4] = 1, 1
    assert float(envmap.total_variation(pole)) < 0.3 * float(envmap.total_variation(equator))
    assert float(envmap.mean_radiance(pole)[0]) < 0.2 * float(envmap.mean_radiance(equator)[0])


def test_chroma_is_equation_24():
    image = torch.zeros(4, 8, 3, dtype=torch.float64)
    image[..., 0], image[..., 1], image[..., 2] = 0.9, 0.6, 0.3
    assert float(envmap.chroma(image)) == pytest.approx(2 * 0.3**2)


def test_maps_of_one_row_have_regularisers():
    image = torch.tensor([[[0.0, 0, 0], [1, 1, 1], [1, 1, 1], [0, 0, 0]]], requires_grad=True)
    loss = envmap.total_variation(image)
    assert float(loss.detach()) == pytest.approx(0.5)
    assert torch.isfinite(torch.autograd.grad(loss + envmap.chroma(image), image)[0]).all()
    assert float(envmap.total_variation(torch.ones(1, 1, 3))) == 0
