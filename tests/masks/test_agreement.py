"""Masks of one ball agree; masks of different ones, of few views or of nothing in common do not."""

import numpy as np
import pytest
from mask_scenes import overlap_of, scene

from exmesh_graph.errors import DataError
from exmesh_graph.masks import agreement
from exmesh_graph.masks.agreement import agreed_masks, covered, overlap
from exmesh_graph.masks.drawn import drawn_outlines
from exmesh_graph.masks.grown import maybe_shown
from exmesh_graph.masks.last import Given, healed
from exmesh_graph.masks.outlines import Small, _display, masks_of_surface, refined
from exmesh_graph.masks.settings import AgreementSettings, CutSettings
from exmesh_graph.masks.shape import common_shape

CUTTING, CHECKS = CutSettings(band=4), AgreementSettings(least_overlap=0.85)


@pytest.fixture(scope="module")
def ball():
    return scene(size=48)


def outcome(ball, masks, monkeypatch, settings=CHECKS):
    """What is said of `masks`, in place of those that the first turn cuts."""
    monkeypatch.setattr(agreement, "small_masks", lambda *_, **__: masks.copy())
    return agreed_masks(ball.views, *ball.ball, CUTTING, settings)


def test_masks_of_one_ball_agree_and_come_out_at_its_edges(ball):
    vertices, faces = ball.ball
    steps = []
    found = agreed_masks(ball.views, 1.1 * vertices, faces, CUTTING, CHECKS, progress=lambda *s: steps.append(s))
    assert found.fault == ""
    assert found.figures["overlap"] > 0.9
    assert (found.figures["seen"], found.figures["contradicted"]) == (1.0, 0.0)
    assert min(overlap_of(a, b) for a, b in zip(found.masks, ball.masks, strict=True)) > 0.93
    assert steps == [(k, 24) for k in range(1, 17)]  # a third turn is for masks that grow


def test_masks_of_large_pictures_are_found_in_small_ones_and_refined_once(monkeypatch):
    large, cut = scene(size=96), []
    monkeypatch.setattr(agreement, "refined", lambda *given: cut.append(given[1].shape) or refined(*given))
    found = agreed_masks(large.views, *large.ball, CUTTING.replaced(side=48), CHECKS)
    assert (cut, found.fault) == ([(8, 48, 48)], "")
    assert found.masks.shape == (8, 96, 96)
    assert min(overlap_of(a, b) for a, b in zip(found.masks, large.masks, strict=True)) > 0.95


def test_a_turn_that_fails_leaves_what_earlier_ones_found(ball, monkeypatch):
    vertices, faces = ball.ball
    low = vertices.copy()
    low[:, 1] = np.minimum(low[:, 1], 0.1)  # a second turn follows where so much is found
    grown, turns = agreement._grown, []

    def once(*arguments):
        turns.append(1)
        if len(turns) > 1:
            raise DataError("nothing in common")
        return grown(*arguments)

    monkeypatch.setattr(agreement, "_grown", once)
    found = agreed_masks(ball.views, low, faces, CutSettings(band=2), CHECKS)
    assert (len(turns), found.fault) == (2, "")
    monkeypatch.setattr(agreement, "_grown", lambda *_: once())
    assert "no common shape" in agreed_masks(ball.views, low, faces, CutSettings(band=2), CHECKS).fault


def test_few_views_that_show_it_are_a_fault(ball, monkeypatch):
    masks = ball.masks.copy()
    masks[3:] = False
    found = outcome(ball, masks, monkeypatch)
    assert "38% of the views show it (least_seen 0.6)" in found.fault
    assert outcome(ball, masks, monkeypatch, CHECKS.replaced(least_seen=0.3)).figures["overlap"] > 0


def test_masks_of_different_things_are_a_fault(ball, monkeypatch):
    moved = np.stack([np.roll(mask, 6 * (-1) ** k, axis=1) for k, mask in enumerate(ball.masks)])
    found = outcome(ball, moved, monkeypatch)
    assert "least_overlap 0.85" in found.fault
    apart = np.stack([np.roll(mask, 22 * (k % 3 - 1), axis=1) for k, mask in enumerate(ball.masks)])
    assert "no common shape" in outcome(ball, apart, monkeypatch).fault


def test_masks_that_many_others_contradict_are_a_fault(ball, monkeypatch):
    masks = ball.masks.copy()
    masks[[1, 5]] = True
    found = outcome(ball, masks, monkeypatch)
    assert found.figures["overlap"] > 0.85
    assert "25% of the masks are another than their common shape (most_contradicted 0.2)" in found.fault
    assert outcome(ball, masks, monkeypatch, CHECKS.replaced(most_contradicted=0.3)).fault == ""


def test_one_view_is_outvoted_and_mended(ball, monkeypatch):
    real, given = agreement.small_masks, []

    def first_is_wrong(*arguments, **named):
        masks = real(*arguments, **named)
        if not given:
            masks[2] = False
            masks[2, 5:12, 5:12] = True
        given.append(masks)
        return masks

    monkeypatch.setattr(agreement, "small_masks", first_is_wrong)
    found = agreed_masks(ball.views, *ball.ball, CUTTING, CHECKS)
    assert found.fault == ""
    assert found.figures["contradicted"] == pytest.approx(1 / 8)
    assert overlap_of(found.masks[2], ball.masks[2]) > 0.9


def test_what_three_views_of_many_bite_off_is_put_back():
    many = scene(count=25, size=48)
    everywhere, band = np.ones(25, bool), CutSettings(band=2)
    bitten = many.masks.copy()
    for view in (3, 4, 5):  # the same side of the ball
        rows = np.argwhere(bitten[view])[:, 0]
        bitten[view, : int(np.quantile(rows, 0.4))] = False
    lacking = drawn_outlines(*common_shape(many.views, bitten, many.ball[0]), many.views)
    assert overlap(lacking, many.masks)[[3, 4, 5]].max() < 0.85
    mended = healed(Given(Small.of(many.views, band), everywhere, many.ball[0], band), bitten)
    assert overlap(mended, many.masks).min() > 0.93
    few = everywhere.copy()
    few[12:] = False  # of twelve one may err, as before
    assert healed(Given(Small.of(many.views, band), few, many.ball[0], band), bitten) is None


@pytest.mark.parametrize("more", [True, False])
def test_masks_are_healed_where_outlines_then_lie_better(ball, monkeypatch, more):
    asked = []

    def all_or_none(given, masks):
        asked.append(masks)
        return np.full_like(masks, more)

    monkeypatch.setattr(agreement, "on_edges", lambda shown, masks: masks.mean())  # the more is shown the better
    monkeypatch.setattr(agreement, "healed", all_or_none)
    found = agreed_masks(ball.views, *ball.ball, CUTTING, CHECKS)
    assert len(asked) == (2 if more else 1)  # what brings no more is not asked again
    assert found.masks.all() == more


@pytest.mark.parametrize("leaks", [False, True])
def test_what_stereo_confirms_is_taken_unless_it_leaks(ball, monkeypatch, leaks):
    """Outlines of thin parts lie less well on edges."""
    more = ball.masks.copy()
    more[:, 40:, :] |= leaks
    more[:, 2, 2] = True
    monkeypatch.setattr(agreement, "confirmed", lambda given, masks: more)
    for step in ("healed", "undercut", "opened"):
        monkeypatch.setattr(agreement, step, lambda given, masks: None)
    found = agreed_masks(ball.views, *ball.ball, CUTTING, CHECKS)
    assert found.masks[:, 2, 2].all() == (not leaks)


def test_of_a_step_that_is_no_better_those_parts_are_taken_that_are(ball, monkeypatch):
    def both_ways(given, masks):
        changed = ball.masks.copy()
        rows = np.argwhere(changed[5])[:, 0]
        changed[5, : int(np.quantile(rows, 0.6))] = False  # and a large piece across the ball is gone
        return changed

    real = agreement.small_masks

    def bitten(*arguments, **named):
        masks = real(*arguments, **named)
        masks[2, : int(np.quantile(np.argwhere(masks[2])[:, 0], 0.2))] = False
        return masks

    monkeypatch.setattr(agreement, "small_masks", bitten)
    monkeypatch.setattr(agreement, "healed", both_ways)
    found = agreed_masks(ball.views, *ball.ball, CUTTING, CHECKS)
    assert overlap(found.masks, ball.masks)[[2, 5]].min() > 0.95


def test_the_common_shape_is_found_wherever_the_world_puts_it(ball):
    views, _, masks, (vertices, _) = ball
    hull = common_shape(views, masks, vertices)
    drawn = drawn_outlines(*hull, views)
    assert np.median(overlap(drawn, masks)) > 0.9


def test_what_stereo_lost_is_found_by_its_colour(ball):
    """The upper third of the ball is missing in the mesh, more than the band can reach."""
    vertices, faces = ball.ball
    low = vertices.copy()
    low[:, 1] = np.minimum(low[:, 1], 0.1)
    cutting = CutSettings(band=2)
    before = masks_of_surface(ball.views, low, faces, cutting)
    found = agreed_masks(ball.views, low, faces, cutting, CHECKS)
    assert found.fault == ""
    lost = [overlap_of(a, b) for a, b in zip(before, ball.masks, strict=True)]
    assert max(lost) < 0.95
    assert min(overlap_of(a, b) for a, b in zip(found.masks, ball.masks, strict=True)) > max(lost)


def test_masks_with_little_in_common_agree_once_their_colours_fill_the_rest(ball):
    """Each view has lost another third of the ball: little is common, and the whole is found."""
    masks = ball.masks.copy()
    for view, mask in enumerate(masks):
        left, right = np.quantile(np.argwhere(mask)[:, 1], (0.33, 0.67)).astype(int)
        mask[:, slice(right, None) if view % 2 else slice(0, left)] = False
    hull = common_shape(ball.views, masks, ball.ball[0])
    assert np.median(overlap(drawn_outlines(*hull, ball.views), masks)) < 0.75
    shown = np.stack([_display(one) for one in ball.views.images])
    more = maybe_shown(shown, masks)
    assert (more >= masks).all()
    assert np.median(overlap(more, ball.masks)) > 0.85
    grown = common_shape(ball.views, more, ball.ball[0])
    assert np.median(overlap(drawn_outlines(*grown, ball.views), ball.masks)) > 0.85


def test_covered_written_out():
    shape, masks = np.zeros((3, 4, 4), bool), np.zeros((3, 4, 4), bool)
    shape[0, :3], masks[0, 2:] = True, True
    masks[1, 0, 0] = True
    assert covered(shape, masks).tolist() == [0.5, 0.0, 1.0]


def test_overlap_written_out():
    a, b = np.zeros((3, 4, 4), bool), np.zeros((3, 4, 4), bool)
    a[0, :2], b[0, 1:3] = True, True
    a[1, 0, 0] = True
    assert overlap(a, b).tolist() == [pytest.approx(1 / 3), 0.0, 1.0]
