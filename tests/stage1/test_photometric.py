"""Moving a mesh to where photographs agree: on a ball whose cap was pushed out of place."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from exmesh_nodes import init
from stage1_scenes import ball, photographs

from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.stage1 import photometric
from exmesh_graph.stage1.photometric import correlations, sweep
from exmesh_graph.stage1.settings import PhotometricSettings
from exmesh_graph.targets import prepare_targets
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import Mesh, Views

RADIUS = 0.6


@pytest.fixture(scope="module")
def views() -> Views:
    """A finely patterned ball from twelve sides."""
    true = ball(radius=RADIUS, rings=40, sectors=64)
    grain = np.random.default_rng(4).uniform(0, 1, (24, 24, 3)).astype(np.float32)
    return photographs(replace(true, texture=np.kron(grain, np.ones((4, 4, 1), np.float32))), count=12, size=96)


def bulged(depth: float):
    """(vertices, faces, which): the ball with a wide cap at +z that stands out by up to `depth`."""
    vertices, faces = icosphere(3, RADIUS)
    cap = np.clip((vertices[:, 2] / RADIUS - 0.7) / 0.2, 0, 1)
    return (vertices * (1 + depth / RADIUS * cap)[:, None]).astype(np.float32), faces, cap == 1


@pytest.mark.thorough
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_a_bulge_goes_back_and_the_rest_stays(views, scale):
    """Most of 0.1 radii is won back, what is right moves by less than a fiftieth; the same at every scale."""
    vertices, faces, cap = bulged(0.06)
    poses = views.camera_to_world.copy()
    poses[:, :3, 3] *= scale
    targets = prepare_targets(replace(views, camera_to_world=poses))
    moved, figures = sweep(vertices * np.float32(scale), faces, targets, PhotometricSettings())
    error = np.abs(np.linalg.norm(moved, axis=1) / scale - RADIUS)
    assert error[cap].mean() < 0.3 * 0.06
    far = vertices[:, 2] < 0.5 * RADIUS
    assert error[far].mean() < 0.02 * RADIUS
    assert figures["known"] > 0.5
    assert 0.02 < figures["moved"] < 0.4


def test_correlation_peaks_where_the_surface_is(views):
    """From a ball that is 5 % too large, offsets towards the truth correlate best."""
    vertices, faces = icosphere(2, 1.05 * RADIUS)
    offsets = np.linspace(-0.1, 0.05, 16)
    normals = (vertices / np.linalg.norm(vertices, axis=1, keepdims=True)).astype(np.float32)
    score = correlations(vertices.astype(np.float32), faces, normals, offsets, prepare_targets(views))
    known = np.isfinite(score).all(axis=1)
    assert known.mean() > 0.3
    assert np.abs(score[known]).max() <= 1 + 1e-5
    assert abs(np.median(offsets[score[known].argmax(axis=1)]) + 0.05 * RADIUS) < 0.011


def test_blank_photographs_move_nothing(views):
    grey = replace(views, images=np.where(views.alpha[..., None] > 0, 0.3, 0.0).repeat(3, axis=-1).astype(np.float32))
    vertices, faces, _ = bulged(0.06)
    moved, figures = sweep(vertices, faces, prepare_targets(grey), PhotometricSettings(passes=1))
    assert figures["known"] < 0.2  # rims against the black ground
    assert np.abs(moved - vertices).max() < 0.03


def test_interpolation_is_the_minimum_of_its_energy():
    """The gradient of sum w (d - b)^2 + s sum over edges (d_i - d_j)^2 + 1e-3 sum d^2 vanishes there."""
    rng = np.random.default_rng(1)
    edges = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [0, 2]])
    best, weight = rng.normal(size=5), np.array([1.0, 0.0, 0.5, 2.0, 0.0])
    d = torch.from_numpy(photometric._interpolate(best, weight, edges, 0.3)).requires_grad_()
    energy = (torch.from_numpy(weight) * (d - torch.from_numpy(best)) ** 2).sum() + 1e-3 * d.square().sum()
    energy = energy + 0.3 * (d[edges[:, 0]] - d[edges[:, 1]]).square().sum()
    assert torch.autograd.grad(energy, d)[0].abs().max() < 1e-12


def test_the_node_keeps_the_faces_and_reports(views):
    vertices, faces, _ = bulged(0.06)
    ctx = FakeContext()
    out = init.photometric(ctx, Mesh(vertices, faces), views, p=init.PhotometricParams(passes=1)).mesh
    assert np.array_equal(out.faces, faces)
    assert np.abs(out.vertices - vertices).max() > 0.01
    assert ctx.steps == [(1, 1)]
