"""Relative depth brought to the world: the fit is a least-absolute one, corrections stay near what was measured."""

import numpy as np
import pytest
from exmesh_nodes import prior
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from exmesh_graph.errors import DataError
from exmesh_graph.priors.align import align, fit_affine
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import DepthMaps


def maps(seed=0, size=40):
    """True depth, the same up to scale and shift, and a third of the true values as measured, with outliers."""
    rng = np.random.default_rng(seed)
    true = (2.5 + 0.5 * np.sin(np.arange(size) / 9)[None, :, None] + 0.01 * np.arange(size)).astype(np.float32)
    true = np.concatenate([true, true[:, ::-1]])
    relative = (true - 1) / 3
    measured = np.where(rng.random(true.shape) < 0.33, true, 0)
    measured = np.where(rng.random(true.shape) < 0.05, 9.0, measured).astype(np.float32)
    names = ("a", "b")
    return true, DepthMaps(names, relative, "relative"), DepthMaps(names, measured)


def test_scale_and_shift_are_found_among_outliers():
    true, relative, measured = maps()
    done = align(relative, measured, 0.0)
    assert done.depths.depth == pytest.approx(true, abs=1e-3)
    assert done.left_out == ()
    assert max(done.error.values()) < 1e-3
    assert done.depths.units == "normalised"
    flipped = DepthMaps(("b", "x", "a"), relative.depth[[1, 0, 0]], "relative")
    assert np.array_equal(align(flipped, measured, 0.0).depths.depth, done.depths.depth)  # maps are found by name


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([1e-3, 1.0, 1e3]))
def test_the_fit_has_the_least_sum_of_absolute_errors(seed, scale):
    rng = np.random.default_rng(seed)
    x = rng.uniform(1, 2, 30)
    y = scale * (3 * x + rng.standard_cauchy(30) * 0.2)
    s, t = fit_affine(x, y)
    # minimise sum e subject to -e <= s x + t - y <= e
    n = len(x)
    rows = np.stack([x, np.ones(n)], axis=1)
    exact = linprog(
        np.r_[0, 0, np.ones(n)], np.block([[rows, -np.eye(n)], [-rows, -np.eye(n)]]), np.r_[y, -y] / scale * scale,
        bounds=[(None, None)] * 2 + [(0, None)] * n,
    )  # fmt: skip
    assert np.abs(s * x + t - y).sum() <= 1.05 * exact.fun


def test_a_constant_map_and_a_map_turned_round_are_left_out():
    _, relative, measured = maps()
    assert fit_affine(np.ones(60), np.arange(60.0)) == (0.0, 29.5)
    depth = relative.depth.copy()
    depth[0] = 0.7
    depth[1] = 1.5 - depth[1]
    done = align(DepthMaps(relative.names, depth, "relative"), measured, 0.0)
    assert done.left_out == ("a", "b")
    assert (done.depths.depth == 0).all()
    context = FakeContext()
    prior.align(context, DepthMaps(relative.names, depth, "relative"), measured, p=prior.AlignParams())
    assert "2 views: a, b" in context.warnings[0]


def test_corrections_reach_as_far_as_they_were_told():
    true, relative, _ = maps()
    bent = relative.depth.copy()
    bent[:, :, :20] += 0.05  # the network is off on the left half
    measured = np.zeros_like(true)
    measured[:, :, 4:16] = true[:, :, 4:16]
    measured[:, :, 24:30] = true[:, :, 24:30]
    plain = align(DepthMaps(relative.names, bent, "relative"), DepthMaps(relative.names, measured), 0.0).depths.depth
    near = align(DepthMaps(relative.names, bent, "relative"), DepthMaps(relative.names, measured), 0.05).depths.depth
    known = near > 0
    assert known[:, :, 5:15].all()
    assert not known[:, :, 36:].any()
    inner = np.s_[:, :, 6:14]
    assert np.abs(near - true)[inner].max() < 0.3 * np.abs(plain - true)[:, :, :30].max()
    assert np.abs(near - true)[inner].max() < 0.02


def test_refusals_and_the_node():
    _true, relative, measured = maps()
    with pytest.raises(DataError, match=r"no relative depth for view 'b' \(1 missing\)"):
        align(DepthMaps(("a",), relative.depth[:1], "relative"), measured, 0.0)
    with pytest.raises(DataError, match="maps of one size"):
        align(DepthMaps(relative.names, relative.depth[:, :9], "relative"), measured, 0.0)
    context = FakeContext()
    out = prior.align(context, relative, measured, p=prior.AlignParams(reach=0))
    assert np.array_equal(out.depths.depth, align(relative, measured, 0.0).depths.depth)
    assert "median error" in context.lines[0]
    few = DepthMaps(measured.names, np.where(np.arange(40) < 1, measured.depth, 0))
    assert align(relative, few, 0.0).left_out == ("a", "b")
