"""Without masks a pixel is the mean of its samples, as a photograph's is; one that lacks a sample is missing."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from exmesh_graph.evaluate.asset import score_asset
from exmesh_graph.evaluate.coverage import surface_depths
from exmesh_graph.evaluate.renders import Renderer, Steps
from exmesh_graph.evaluate.settings import Quality
from exmesh_graph.stage2.render import render_views
from exmesh_graph.testing import asset, views
from exmesh_graph.types import Region


@pytest.fixture(scope="module")
def striped():
    """A ball in stripes finer than a pixel, its photographs before a gray wall, and the region of whole pixels."""
    plain = asset()
    stripes = np.indices((512, 512)).sum(axis=0) // 4 % 2
    ball = replace(
        plain, base_color=np.repeat((0.1 + 0.6 * stripes)[..., None], 3, axis=-1).astype(np.float32),
        roughness=np.full((512, 512), 0.9, np.float32), seen=np.ones((512, 512), bool), metallic=None, normal=None,
    )  # fmt: skip
    held_out = views(plain, 2, 40, split="test")
    cameras = (held_out.intrinsics, held_out.camera_to_world, 40, 40)
    shown = render_views(ball, *cameras, supersampling=6, bounces=0, specular_samples=4)
    images = shown.images + 0.4 * (1 - shown.alpha[..., None])
    photographs = replace(
        held_out, images=images.astype(np.float32), alpha=np.ones((2, 40, 40), np.float32), has_masks=False
    )
    depth = surface_depths(ball, photographs)
    inside = (shown.alpha > 0.99) & (depth > 0)
    near, far = (np.where(inside, depth + step, 0).astype(np.float32) for step in (-0.2, 0.2))
    return ball, photographs, Region(photographs.names, inside, near, far, "masks")


def test_the_true_surface_is_judged_by_what_a_pixel_holds(striped):
    ball, photographs, region = striped

    def score(samples):
        quality = Quality(directions=64, bounces=0, supersampling=samples, specular_samples=4)
        return score_asset(ball, photographs, quality=quality, region=region).values["held_out"]

    centre, mean = score(1), score(4)
    assert mean["psnr"] > centre["psnr"] + 5
    assert mean["shares"]["covered"] > 0.95


def test_a_pixel_that_lacks_a_sample_is_not_covered(striped):
    ball, photographs, region = striped
    gone = np.random.default_rng(0).random(len(ball.faces)) < 0.1
    holed = replace(ball, faces=ball.faces[~gone], uv_faces=ball.uv_faces[~gone])
    with torch.no_grad():
        alphas = [
            Renderer(each, photographs, Quality(directions=32, bounces=0, supersampling=samples, specular_samples=1),
                     Steps(None, 2), 0, region=region).render([0, 1])[0].alpha
            for each in (ball, holed) for samples in (1, 2)
        ]  # fmt: skip
    whole_centre, whole, holed_centre, holed_all = alphas
    assert set(np.unique(np.stack(alphas))) == {0, 1}
    assert (whole <= whole_centre).mean() > 0.98  # at rims a sample may lie in the interval where the centre does not
    assert (holed_all <= whole).all()
    assert holed_all.sum() < holed_centre.sum()  # one sample of four is gone more often than the one at the centre
