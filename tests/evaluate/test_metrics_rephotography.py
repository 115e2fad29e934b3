"""Rephotography: the true surface foretells best, and what is wrong with another one shows."""

from dataclasses import replace

import numpy as np
import pytest

from exmesh_graph.errors import DataError
from exmesh_graph.evaluate.metrics.rephotography import Foretold, gain, prediction_psnr, prediction_scores, rephotograph
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.types import Views
from tests.priors.prior_scenes import paint


def painted_sphere(count: int, size: int = 64, split: str = "train", turn: float = 0.0, radius: float = 0.7) -> Views:
    """Pictures of a painted sphere, exact colours at pixel centres, from a ring of cameras a little above it."""
    k = np.array([[1.6 * size, 0, size / 2], [0, 1.6 * size, size / 2], [0, 0, 1]])
    rows, columns = np.indices((size, size)) + 0.5
    local = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(k).T
    images, alpha, poses = [], [], []
    for i in range(count):
        angle = 2 * np.pi * (i + turn) / count
        eye = 3.5 * np.array([np.cos(angle), 0.2, np.sin(angle)])
        z = -eye / np.linalg.norm(eye)
        x = np.cross(z, [0.0, 1, 0])
        x /= np.linalg.norm(x)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), eye
        d = local @ pose[:3, :3].T
        a, b, c = (d * d).sum(-1), 2 * (d @ eye), eye @ eye - radius**2
        hit = b * b - 4 * a * c > 0
        near = np.where(hit, (-b - np.sqrt(np.maximum(b * b - 4 * a * c, 0))) / (2 * a), 0)
        shade = np.where(hit, paint(eye + near[..., None] * d, 1.0) ** 2.2, 0)
        images.append(np.repeat(shade[..., None], 3, -1))
        alpha.append(hit)
        poses.append(pose)
    names = tuple(f"{split}{i}" for i in range(count))
    stacks = np.stack(images).astype(np.float32), np.stack(alpha).astype(np.float32)
    return Views(names, *stacks, np.repeat(k[None], count, 0), np.stack(poses), split)


@pytest.fixture(scope="module")
def views() -> tuple[Views, Views]:
    return painted_sphere(16), painted_sphere(3, split="test", turn=0.22)


def score(radius: float, train: Views, held_out: Views, shift: float = 0.0) -> float:
    vertices, faces = icosphere(5, radius)
    made = rephotograph(vertices + np.float32(shift), faces, train, held_out)
    return float(prediction_psnr(made, held_out, held_out.alpha > 0.5).mean())


def test_the_true_surface_foretells_best(views) -> None:
    true, larger, smaller, moved = (score(r, *views, s) for r, s in ((0.7, 0), (0.75, 0), (0.65, 0), (0.7, 0.05)))
    assert true > 27
    assert max(larger, smaller, moved) < true - 4


def test_exposure_is_no_matter_of_shape(views) -> None:
    train, held_out = views
    made = rephotograph(*icosphere(5, 0.7), train, held_out)
    regions = held_out.alpha > 0.5
    darker = replace(made, images=made.images * np.float32([0.5, 0.7, 0.9]))
    assert prediction_psnr(darker, held_out, regions) == pytest.approx(
        prediction_psnr(made, held_out, regions), abs=1e-4
    )


def test_what_no_training_view_sees_is_not_foretold(views) -> None:
    """Two opposite cameras only: the flanks are covered, and seen by nobody; a wall before the sphere hides it."""
    held_out = views[1]
    two = painted_sphere(2)
    made = rephotograph(*icosphere(5, 0.7), two, held_out)
    assert made.covered[made.seen].all()
    assert 0.2 < made.seen.sum() / made.covered.sum() < 0.98
    assert (made.images[~made.seen] == 0).all()
    sphere, faces = icosphere(4, 0.7)
    shell = icosphere(4, 0.95)[0] * np.float32(1.0)
    hidden = rephotograph(np.concatenate([sphere, shell]), np.concatenate([faces, faces + len(sphere)]), *views)
    alone = rephotograph(shell, faces, *views)
    assert np.array_equal(hidden.images, alone.images)


def test_nothing_to_compare_is_refused(views) -> None:
    train, held_out = views
    made = rephotograph(*icosphere(3, 0.7), train, held_out)
    with pytest.raises(DataError, match="no pixel"):
        prediction_psnr(made, held_out, np.zeros_like(held_out.alpha, bool))


def test_the_better_of_two_surfaces_is_told_from_the_training_views_alone() -> None:
    views = painted_sphere(20)
    foretold = Foretold(views)
    true, larger = (foretold.scores(icosphere(4, radius)) for radius in (0.7, 0.74))
    better, error = gain(larger.picture, true.picture)
    assert better > 3 * error > 0
    assert gain(true.picture, larger.picture) == pytest.approx((-better, error))
    assert gain(larger.detail, true.detail)[0] > 3
    with pytest.raises(DataError, match="too few"):
        Foretold(views.subset(range(10)))


def test_what_is_smooth_is_no_detail_and_noise_is(views) -> None:
    """A slope over the picture, as gloss lays on it, costs PSNR alone; noise of the same strength costs both."""
    train, held_out = views
    made = rephotograph(*icosphere(5, 0.7), train, held_out)
    regions = held_out.alpha > 0.5
    exact = replace(made, images=np.where(regions[..., None], held_out.images, 0))
    column = np.linspace(-1, 1, held_out.width, dtype=np.float32)[None, None, :, None]
    noise = np.random.default_rng(0).normal(size=exact.images.shape).astype(np.float32) * np.float32(0.33)
    sloped, noisy = (
        prediction_scores(replace(exact, images=exact.images * (1 + np.float32(0.2) * by)), held_out, regions)
        for by in (column, noise)
    )
    assert abs(float(sloped.picture.mean() - noisy.picture.mean())) < 3
    assert sloped.detail.mean() > noisy.detail.mean() + 8


def test_a_rim_of_a_pixel_has_no_say(views) -> None:
    foretold = Foretold(painted_sphere(20))
    assert (foretold.inside <= (foretold.held_out.alpha > 0.5)).all()
    lost = (foretold.held_out.alpha > 0.5) & ~foretold.inside
    assert 0 < lost.sum() < 0.15 * foretold.inside.sum()
