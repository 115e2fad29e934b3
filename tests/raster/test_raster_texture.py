"""Bilinear lookup: convention, borders, gradients, agreement of the kernel with plain torch."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from exmesh_graph.raster import sample_texture
from exmesh_graph.raster.texture import sample_texture_reference


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_texel_centres_give_texels_with_v_up(dtype):
    texture = torch.arange(24, dtype=dtype).reshape(3, 4, 2)
    for row in range(3):
        for column in range(4):
            uv = torch.tensor([(column + 0.5) / 4, 1 - (row + 0.5) / 3], dtype=dtype)
            assert torch.allclose(sample_texture(texture, uv), texture[row, column], atol=1e-4)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_border_is_repeated_and_halfway_is_the_mean(dtype):
    texture = torch.tensor([[[1.0], [3.0]], [[5.0], [7.0]]], dtype=dtype)
    uv = torch.tensor([[-2.0, 2.0], [3.0, -1.0], [0.0, 0.0], [0.5, 0.5]], dtype=dtype)
    assert sample_texture(texture, uv)[:, 0].tolist() == pytest.approx([1.0, 7.0, 5.0, 4.0])


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 9), st.integers(1, 9), st.integers(1, 5), st.integers(0, 10**6))
def test_kernel_equals_reference(height, width, channels, seed):
    g = torch.Generator().manual_seed(seed)
    texture = torch.randn(height, width, channels, generator=g)
    uv = torch.rand(3, 7, 2, generator=g) * 1.4 - 0.2
    weight = torch.randn(3, 7, channels, generator=g)
    results = []
    for of in (sample_texture, sample_texture_reference):
        t, q = texture.clone().requires_grad_(), uv.clone().requires_grad_()
        value = of(t, q)
        results.append((value, *torch.autograd.grad((value * weight).sum(), (t, q))))
    for got, want in zip(*results, strict=True):
        assert torch.allclose(got, want, atol=2e-4, rtol=1e-4)


def test_gradients_in_float64():
    g = torch.Generator().manual_seed(0)
    texture = torch.randn(4, 5, 2, generator=g, dtype=torch.float64, requires_grad=True)
    uv = (torch.rand(6, 2, generator=g, dtype=torch.float64) * 0.9 + 0.05).requires_grad_()
    assert torch.autograd.gradcheck(sample_texture, (texture, uv))


def test_texel_gradient_alone_and_no_points():
    texture = torch.rand(4, 4, 3, requires_grad=True)
    value = sample_texture(texture, torch.rand(50, 2))
    (gradient,) = torch.autograd.grad(value.sum(), texture)
    assert float(gradient.sum()) == pytest.approx(150, rel=1e-5)
    assert sample_texture(texture, torch.zeros(0, 2)).shape == (0, 3)
