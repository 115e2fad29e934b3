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


WRAPS = ["clamp", "repeat", "mirror"]


@settings(max_examples=40, deadline=None)
@given(
    st.integers(1, 9),
    st.integers(1, 9),
    st.integers(1, 5),
    st.integers(0, 10**6),
    st.sampled_from(WRAPS),
    st.booleans(),
)
def test_kernel_equals_reference(height, width, channels, seed, wrap, sparse):
    g = torch.Generator().manual_seed(seed)
    texture = torch.randn(height, width, channels, generator=g)
    # several periods for the wrap modes, but off the texel centres, where the gradient in uv jumps
    uv = torch.rand(3, 7, 2, generator=g) * (1.4 if wrap == "clamp" else 6.0) - (0.2 if wrap == "clamp" else 3.0)
    texels = torch.tensor([width, height])
    kink = ((uv * texels - 0.5).frac().abs() - 0.5).abs() > 0.499
    uv = torch.where(kink, uv + 0.01 / texels, uv)
    weight = torch.randn(3, 7, channels, generator=g)
    results = []
    for of in (lambda t, q: sample_texture(t, q, wrap=wrap, sparse=sparse), sample_texture_reference):
        t, q = texture.clone().requires_grad_(), uv.clone().requires_grad_()
        value = of(t, q) if of is not sample_texture_reference else of(t, q, wrap=wrap)
        by_texture, by_uv = torch.autograd.grad((value * weight).sum(), (t, q))
        results.append((value, by_texture.to_dense(), by_uv))
    for got, want in zip(*results, strict=True):
        assert torch.allclose(got, want, atol=2e-4, rtol=1e-4)


@pytest.mark.parametrize("wrap", WRAPS)
def test_gradients_in_float64(wrap):
    g = torch.Generator().manual_seed(0)
    texture = torch.randn(4, 5, 2, generator=g, dtype=torch.float64, requires_grad=True)
    uv = torch.rand(6, 2, generator=g, dtype=torch.float64) * 0.9 + 0.05
    uv = (uv if wrap == "clamp" else 4 * uv - 1.5).requires_grad_()
    assert torch.autograd.gradcheck(lambda t, q: sample_texture(t, q, wrap=wrap), (texture, uv))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_wrap_modes_are_copies_of_the_texture_laid_side_by_side(dtype):
    texture = torch.rand(3, 4, 2, dtype=dtype, generator=torch.Generator().manual_seed(1))
    uv = torch.rand(60, 2, dtype=dtype, generator=torch.Generator().manual_seed(2))
    inner = (uv * 0.5 + 0.25).double()
    for wrap in ("repeat", "mirror"):
        row = [texture, texture.flip(1), texture] if wrap == "mirror" else [texture] * 3
        wide = torch.cat(row, dim=1)
        laid = torch.cat([wide.flip(0), wide, wide.flip(0)] if wrap == "mirror" else [wide] * 3)
        for u, v in ((0, 0), (1, 0), (0, 1), (-1, -1)):
            moved = (inner + torch.tensor([u, v])).to(dtype)
            # the laid picture starts one period left of and below the texture; mirrored copies alternate
            start = torch.tensor([1 + u, 1 + v]) if wrap == "repeat" else torch.tensor([u % 2, (v + 1) % 2])
            want = sample_texture(laid, ((inner + start) / 3).to(dtype))
            assert torch.allclose(sample_texture(texture, moved, wrap=wrap), want, atol=2e-5)
    assert torch.equal(sample_texture(texture, uv, wrap="clamp"), sample_texture(texture, uv))


def test_an_unknown_wrap_mode_is_named():
    with pytest.raises(ValueError, match="clamp, repeat, mirror"):
        sample_texture(torch.zeros(2, 2, 1), torch.zeros(1, 2), wrap="wrap")


def test_a_sparse_gradient_names_the_texels_read_and_drives_a_sparse_optimiser():
    texture = torch.rand(64, 32, 3, generator=torch.Generator().manual_seed(0)).requires_grad_()
    uv = torch.rand(40, 2, generator=torch.Generator().manual_seed(1)) * 0.25
    loss = (sample_texture(texture, uv, sparse=True) - 0.5).square().sum()
    (gradient,) = torch.autograd.grad(loss, texture)
    assert gradient.is_sparse
    assert gradient.is_coalesced()
    rows, columns = gradient.indices()
    assert 0 < len(rows) <= 160
    assert bool((rows >= 47).all())
    assert bool((columns <= 8).all())
    flat = rows * 32 + columns
    assert bool((flat[1:] > flat[:-1]).all())
    before = texture.detach().clone()
    texture.grad = gradient
    torch.optim.SparseAdam([texture], lr=0.01).step()
    moved = (texture.detach() != before).any(-1)
    untouched = torch.ones(64, 32, dtype=torch.bool)
    untouched[rows, columns] = False
    assert int(moved.sum()) > 40
    assert not bool((moved & untouched).any())


def test_sparse_gradients_of_nothing_and_of_float64():
    texture = torch.rand(4, 4, 3, requires_grad=True)
    value = sample_texture(texture, torch.zeros(0, 2), sparse=True)
    (gradient,) = torch.autograd.grad(value.sum(), texture)
    assert gradient.to_dense().abs().sum() == 0
    with pytest.raises(ValueError, match="float32"):
        sample_texture(texture.double(), torch.zeros(1, 2).double(), sparse=True)


def test_texel_gradient_alone_and_no_points():
    texture = torch.rand(4, 4, 3, requires_grad=True)
    value = sample_texture(texture, torch.rand(50, 2))
    (gradient,) = torch.autograd.grad(value.sum(), texture)
    assert float(gradient.sum()) == pytest.approx(150, rel=1e-5)
    assert sample_texture(texture, torch.zeros(0, 2)).shape == (0, 3)
