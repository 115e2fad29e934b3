"""Figures against plausible mistakes of whoever computes it: a wrong protocol must not score like a right one.

The estimate errs a little, as real ones do. Each mistake is made on the estimate or on the scoring, and must move the
figure by more than the estimate's own error leaves room for.
"""

from pathlib import Path

import numpy as np
import pytest

from exmesh_graph.api.opening import checked_graph
from exmesh_graph.evaluate.metrics.image import display, psnr, ssim
from exmesh_graph.evaluate.metrics.material import albedo_psnr, albedo_scale, roughness_mse
from exmesh_graph.evaluate.protocols.dtu import DtuTruth, dtu_chamfer
from exmesh_graph.evaluate.protocols.stanford_orb import albedo_scores, depth_error, normal_error, view_scores
from exmesh_graph.graph.problems import GraphErrors
from exmesh_graph.io.color import linear_to_srgb, srgb_to_linear

ROOT = Path(__file__).parents[2]
SIZE = 48


@pytest.fixture(scope="module")
def scene():
    """(estimate, truth) linear [2, H, W, 3] of two views, coverage [2, H, W], roughness of both, unit normals."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:SIZE, :SIZE] / SIZE
    alpha = (np.hypot(x - 0.45, y - 0.55) < 0.38).astype(float)
    alpha = np.stack([alpha, np.roll(alpha, 3, axis=1)])
    paint = np.stack([0.25 + 0.2 * np.sin(9 * x), 0.3 + 0.15 * np.cos(7 * y), 0.1 + 0.06 * np.sin(5 * (x + y))], -1)
    truth = np.stack([paint, np.roll(paint, 3, axis=1)])
    estimate = truth * (1 + 0.02 * rng.standard_normal(truth.shape))
    rough = np.stack([0.5 + 0.3 * np.sin(8 * x + 3 * y), 0.5 + 0.3 * np.cos(5 * x - 6 * y)])
    normal = np.stack([x - 0.5, 0.2 * (y - 0.5), np.full_like(x, 0.8)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return estimate, truth, alpha, rough, normal


MISTAKES = {
    "channels in the other order": lambda picture: picture[..., ::-1],
    "encoded twice": linear_to_srgb,
    "decoded twice": srgb_to_linear,
    "mirrored": lambda picture: picture[:, :, ::-1],
    "upside down": lambda picture: picture[:, ::-1],
    "two pixels beside": lambda picture: np.roll(picture, 2, axis=2),
}
COLOUR = {name: change for name, change in MISTAKES.items() if name != "channels in the other order"}


def shown_psnr(estimate, truth, alpha):
    return psnr(display(estimate * alpha[..., None], alpha), display(truth * alpha[..., None], alpha))


def shown_ssim(estimate, truth, alpha):
    pictures = [display(p[0] * alpha[0, ..., None], alpha[0]) for p in (estimate, truth)]
    return ssim(*pictures)


def scaled_albedo(estimate, truth, alpha):
    scale = albedo_scale(estimate, truth, alpha)
    return np.mean([albedo_psnr(e, t, a, scale) for e, t, a in zip(estimate, truth, alpha, strict=True)])


def orb(name, relit):
    return lambda estimate, truth, alpha: view_scores(estimate[0], truth[0], alpha[0], relit=relit)[name]


FIGURES = {  # figure: (function, by how much a mistake must lower it)
    "PSNR of views": (shown_psnr, 3),
    "SSIM of views": (shown_ssim, 0.005),
    "albedo PSNR": (scaled_albedo, 3),
    "Stanford-ORB PSNR-H, new views": (orb("psnr_h", False), 3),
    "Stanford-ORB PSNR-L, new views": (orb("psnr_l", False), 3),
    "Stanford-ORB SSIM, new views": (orb("ssim", False), 0.005),
    "Stanford-ORB PSNR-H, relit": (orb("psnr_h", True), 3),
    "Stanford-ORB PSNR-L, relit": (orb("psnr_l", True), 3),
    "Stanford-ORB albedo PSNR": (lambda e, t, a: albedo_scores(e[0], t[0], a[0])["psnr"], 3),
}


@pytest.mark.parametrize("mistake", MISTAKES)
@pytest.mark.parametrize("figure", FIGURES)
def test_a_mistake_lowers_the_figure(scene, figure, mistake):
    estimate, truth, alpha, *_ = scene
    score, margin = FIGURES[figure]
    right, wrong = score(estimate, truth, alpha), score(MISTAKES[mistake](estimate), truth, alpha)
    assert wrong < right - margin


@pytest.mark.parametrize("figure", ["PSNR of views", "albedo PSNR"])
def test_a_forgotten_mask_lowers_the_figure(scene, figure):
    """The background of an estimate that was not masked: another figure, never a better one."""
    estimate, truth, alpha, *_ = scene
    score, margin = FIGURES[figure]
    wall = np.where(alpha[..., None] > 0, estimate, 0.7)
    right, wrong = score(estimate, truth, alpha), score(wall, truth, np.ones_like(alpha))
    assert abs(wrong - right) > margin


@pytest.mark.parametrize("mistake", COLOUR)
def test_a_mistake_raises_the_roughness_error(scene, mistake):
    *_, alpha, rough, _ = scene
    wrong = COLOUR[mistake](rough[..., None])[..., 0]
    right = roughness_mse(rough[0] + 0.01, rough[0], alpha[0])
    assert roughness_mse(wrong[0], rough[0], alpha[0]) > 3 * right
    assert roughness_mse(rough[0] ** 2, rough[0], alpha[0]) > 3 * right  # GGX's alpha in place of roughness


def test_normals_in_another_frame_or_scale_of_depth_per_view_show(scene):
    *_, alpha, rough, normal = scene
    right = normal_error(normal + 0.01, normal, alpha[0])
    for wrong in (normal * [1, -1, -1], normal[..., ::-1], normal * [-1, 1, 1], normal[::-1]):
        assert normal_error(wrong, normal, alpha[0]) > 10 * right
    depths = [2 + rough[0], 3 + rough[1]]
    one = depth_error([5 * d for d in depths], depths, list(alpha))
    each = depth_error([5 * depths[0], 7 * depths[1]], depths, list(alpha))
    rays = depth_error([d / normal[..., 2] for d in depths], depths, list(alpha))  # along the ray, not the axis
    assert one < 1e-6
    assert min(each, rays) > 1


def test_a_dtu_mesh_in_another_frame_shows():
    """Axes exchanged, a flip, the normalised frame's translation forgotten: millimetres all the same, and wrong."""
    x, y = np.meshgrid(np.arange(0, 24, 0.5), np.arange(0, 12, 0.5))
    points = np.stack([x.ravel(), y.ravel(), 3 + 0.1 * x.ravel()], 1)
    box = np.array([[-30.0] * 3, [30.0] * 3])
    truth = DtuTruth(points, np.ones((31, 31, 31), bool), box, 2.0, np.array([0.0, 0, 1, 100]))
    corners = np.array([[0.0, 0, 3], [24, 0, 5.4], [24, 12, 5.4], [0, 12, 3]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    right = dtu_chamfer(corners, faces, truth, spacing=0.5).chamfer
    for wrong in (corners[:, [1, 0, 2]], corners * [1, 1, -1], corners - [4, 0, 0], corners * 1.2):
        assert dtu_chamfer(wrong, faces, truth, spacing=0.5).chamfer > right + 0.3


def test_training_views_cannot_be_wired_where_test_views_are_scored(tmp_path):
    graph = tmp_path / "leak.yaml"
    graph.write_text(
        f"extends: {ROOT}/graphs/quickstart.yaml\n"
        'nodes: {score: {views: "@views.train"}, look: {views: "@views.train"},\n'
        '        rounds: {nodes: {progress: {views: "@views.train"}}},\n'
        '        chamfer: {type: benchmark.nerf_synthetic, mesh: "@settle.state", truth: "@views.truth",\n'
        '                  views: "@views.train", frame: "@views.frame"},\n'
        '        relit: {type: benchmark.synthetic4relight, asset: "@pbr.asset", views: "@views.train",\n'
        '                truth: "@views.truth"}}\n'
    )
    with pytest.raises(GraphErrors) as caught:
        checked_graph(graph, [])
    told = [str(problem) for problem in caught.value.problems]
    for name in ("score", "look", "progress", "chamfer", "relit"):
        assert any(name in line and "test" in line and "train" in line for line in told), (name, told)
