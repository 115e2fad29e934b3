"""Masks laid on views, as loaders lay them on; in files, the same bits."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mask_scenes import scene

from exmesh_graph.errors import DataError
from exmesh_graph.io.images import write_image
from exmesh_graph.masks.apply import soft, with_found_masks, with_masks
from exmesh_graph.masks.files import mask_files, masks_for
from exmesh_graph.masks.outlines import masks_of_surface
from exmesh_graph.masks.settings import CutSettings
from exmesh_graph.types import pictures
from exmesh_graph.types.pictures import Pictures


@pytest.fixture(scope="module")
def ball():
    return scene(count=3, size=48)


def test_pictures_are_multiplied_by_their_masks(ball):
    views = ball.views
    masks = [soft(mask) for mask in ball.masks]
    masked = with_masks(views, masks, "here")
    assert masked.has_masks
    assert masked.masked.all()
    assert (masked.alpha == np.stack(masks)).all()
    assert (masked.images == views.images * masked.alpha[..., None]).all()
    assert masked.images.dtype == masked.alpha.dtype == np.float32
    assert (masked.camera_to_world == views.camera_to_world).all()
    assert (views.alpha == 1).all()


def test_a_rim_is_spread_and_has_256_steps(ball):
    alpha = soft(ball.masks[0])
    assert alpha.dtype == np.float32
    assert (np.rint(255 * alpha) / 255).astype(np.float32) == pytest.approx(alpha, abs=0)
    assert ((alpha >= 0.5) == ball.masks[0]).mean() > 0.995
    assert 0.01 < ((alpha > 0) & (alpha < 1)).mean() < 0.2
    assert alpha.sum() == pytest.approx(ball.masks[0].sum(), rel=0.01)


def test_a_large_set_goes_into_files_with_the_same_bits(ball, tmp_path, monkeypatch):
    masks = [soft(mask) for mask in ball.masks]
    small = with_masks(ball.views, masks, "here")
    monkeypatch.setattr(pictures, "LARGE", 1000)
    with pictures.kept_in(tmp_path):
        large = with_masks(ball.views, masks, "here")
        assert isinstance(large.images, Pictures)
        assert (np.asarray(large.images) == small.images).all()
        assert (np.asarray(large.alpha) == small.alpha).all()
        codes = np.random.default_rng(0).integers(0, 256, (3, 48, 48, 3), np.uint8)
        stack = kept_codes(codes)
        from_codes = with_masks(replace(ball.views, images=stack), masks, "here")
        assert from_codes.images.codes(0).shape == (48, 48, 4)  # as a loader keeps a mask beside an opaque picture
        assert (np.asarray(from_codes.images) == np.asarray(stack) * small.alpha[..., None]).all()


def kept_codes(codes):
    from exmesh_graph.io.picture_files import Files
    from exmesh_graph.types.pictures import decoded

    files = Files.of(*codes.shape[:3])
    table = files.images.tables[np.dtype(np.uint8)]
    for number, picture in enumerate(codes):
        files.images.put(number, decoded(picture, table), picture)
    return files.images.stack()


def test_views_with_masks_and_empty_masks_are_refused(ball):
    masks = [soft(mask) for mask in ball.masks]
    masked = with_masks(ball.views, masks, "here")
    with pytest.raises(DataError, match=r"(?s)have masks already.*masks: false"):
        with_masks(masked, masks, "here")
    with pytest.raises(DataError, match=r"(?s)view v1.*mask is empty"):
        with_masks(ball.views, [masks[0], 0.4 * masks[1], masks[2]], "here")


def test_views_that_do_not_show_the_surface_are_left_out(ball):
    masks = ball.masks.copy()
    masks[1] = False
    masked, bare = with_found_masks(ball.views, masks, "here")
    assert (masked.names, bare) == (("v0", "v2"), ["v1"])
    with pytest.raises(DataError, match="no view shows"):
        with_found_masks(ball.views, masks & False, "here")


def test_masks_of_a_surface_go_to_the_edges_at_full_size_too(ball):
    views, _, masks, (vertices, faces) = ball
    steps = []
    for side in (64, 32):  # as they are; reduced by 2
        found = masks_of_surface(
            views, 1.12 * vertices, faces, CutSettings(side=side, band=4), progress=lambda *s: steps.append(s)
        )
        assert (found & masks).sum() / (found | masks).sum() > 0.97
    assert steps == [(1, 3), (2, 3), (3, 3)] * 2
    away = masks_of_surface(views, vertices + np.array([0, 50, 0], np.float32), faces)
    assert not away.any()


def test_odd_sizes_are_cut_to_their_last_pixel():
    odd = scene(count=2, size=45)
    found = masks_of_surface(odd.views, *odd.ball, CutSettings(side=32, band=3))
    assert found.shape == (2, 45, 45)
    assert (found & odd.masks).sum() / (found | odd.masks).sum() > 0.95


@pytest.mark.parametrize("called", ["{}_mask.png", "{}.png", "{}.jpg.png", "{}.JPG.png"])
def test_files_are_found_by_the_names_of_the_views(ball, tmp_path, called):
    for name, mask in zip(ball.views.names, ball.masks, strict=True):
        write_image(tmp_path / called.format(name), mask.astype(np.float32))
    found = np.stack(list(masks_for(ball.views, tmp_path)))
    assert (found == ball.masks).all()
    assert found.dtype == np.float32


def test_larger_masks_are_reduced_by_exact_means(ball, tmp_path):
    views = ball.views
    large = np.random.default_rng(0).integers(0, 256, (3, 97, 97)).astype(np.float32) / 255
    for name, mask in zip(views.names, large, strict=True):
        write_image(tmp_path / f"{name}.png", mask)
    found = np.stack(list(masks_for(views, tmp_path)))
    assert found == pytest.approx(large[:, :96, :96].reshape(3, 48, 2, 48, 2).mean(axis=(2, 4)), abs=1e-6)


def test_what_is_wrong_with_the_files_is_said(ball, tmp_path):
    with pytest.raises(DataError, match=r"(?s)holds no masks.*path"):
        mask_files(tmp_path)
    with pytest.raises(DataError, match="nowhere"):
        mask_files(tmp_path / "nowhere")
    for name in ("v0", "v2"):
        write_image(tmp_path / f"{name}.png", np.ones((48, 48), np.float32))
    with pytest.raises(DataError, match=r"(?s)view v1 has no mask.*v1_mask.png, v1.png, v1.jpg.png"):
        list(masks_for(ball.views, tmp_path))
    write_image(tmp_path / "v1.png", np.ones((48, 60), np.float32))
    with pytest.raises(DataError, match=r"(?s)view v1 is 60 x 48.*48 x 48, or a whole multiple"):
        list(masks_for(ball.views, tmp_path))
    assert sorted(mask_files(tmp_path)) == ["v0.png", "v1.png", "v2.png"]
    assert all(isinstance(file, Path) for file in mask_files(tmp_path).values())
