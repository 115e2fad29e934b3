"""Bad images, gradients, terms and rates: what the guard says and does, and that the fit goes on from there."""

import dataclasses
import math
import re

import numpy as np
import pytest
import torch

from exmesh_graph.errors import NumericsError
from exmesh_graph.stage2 import fit as fitting
from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.guard import RETURNS, Guard
from exmesh_graph.stage2.settings import DecompositionSettings
from exmesh_graph.types.state import load_state, save_state

SETTINGS = DecompositionSettings(
    environment_height=8, iterations=40, material_rate=0.05, environment_rate=0.2, indirect_ramp=5, corrections=1,
    correction_samples=2, ssim_weight=0.0, material_weight=0.01, environment_weight=0.01,
)  # fmt: skip


def _finite(asset):
    return all(np.isfinite(m).all() for m in (asset.base_color, asset.roughness, asset.environment))


def _broken(views, numbers):
    images = views.images.copy()
    for number in numbers:
        row, column = np.argwhere(views.alpha[number] > 0.99)[10]
        images[number, row, column, 1] = np.nan
    return dataclasses.replace(views, images=images)


@pytest.fixture
def spoil(monkeypatch):
    """spoil(when, change): terms = change(terms, model) wherever when(step, view name, model) holds."""

    def install(when, change):
        plain = fitting.weighted_terms

        def weighted_terms(model, buffer, step):
            terms, predicted = plain(model, buffer, step)
            if when(step, buffer.name, model):
                change(terms, model)
            return terms, predicted

        monkeypatch.setattr(fitting, "weighted_terms", weighted_terms)

    return install


class _NanGradient(torch.autograd.Function):
    @staticmethod
    def forward(ctx, value):
        return value.clone()

    @staticmethod
    def backward(ctx, gradient):
        return gradient * math.nan


@pytest.mark.thorough
def test_a_photograph_with_a_nan_pixel_is_named_left_out_and_changes_nothing_else(carrier, train_views, transport):
    said = []
    asset, curves = fit(carrier, _broken(train_views, [5]), transport, SETTINGS, warn=said.append)
    assert len(said) == 1
    assert "view v5" in said[0]
    row, column = np.argwhere(train_views.alpha[5] > 0.99)[10]
    assert f"column {column}, row {row}" in said[0]
    assert _finite(asset)
    assert curves["image"][-1] < 0.5 * curves["image"][0]
    # the same as a view without pixels
    alpha = train_views.alpha.copy()
    alpha[5] = 0
    without, _ = fit(carrier, dataclasses.replace(train_views, alpha=alpha), transport, SETTINGS)
    assert without.base_color.tobytes() == asset.base_color.tobytes()
    with pytest.raises(NumericsError, match=r"(?s)view v0.*no view can be used.*column"):
        fit(carrier, _broken(train_views, range(8)), transport, SETTINGS)


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["value", "gradient"])
def test_a_term_that_fails_once_costs_a_return_to_the_last_good_state(spoil, carrier, train_views, transport, kind):
    calls = []

    def once(step, view, model):
        calls.append(step)
        return step == 30 and calls.count(30) == 1

    def change(terms, model):
        terms["image"] = terms["image"] * math.nan if kind == "value" else _NanGradient.apply(terms["image"])

    spoil(once, change)
    said = []
    asset, curves = fit(carrier, train_views, transport, SETTINGS, warn=said.append)
    assert len(said) == 1
    assert "step 30, view v" in said[0]
    assert "back to the last good state, rates times 0.5" in said[0]
    assert _finite(asset)
    assert curves["iteration"][-1] == 39
    assert curves["image"][-1] < 0.5 * curves["image"][0]


def test_a_return_takes_the_exposures_back_too(spoil, carrier, train_views, transport):
    calls, gains = [], []

    def once(step, view, model):
        calls.append(step)
        gains.append(model.exposure.logs.clone())
        return step == 30 and calls.count(30) == 1

    def change(terms, model):
        model.exposure.logs = torch.full_like(model.exposure.logs, 1.0)
        terms["image"] = terms["image"] * math.nan

    spoil(once, change)
    said = []
    fit(carrier, train_views, transport, SETTINGS.replaced(exposure=True), warn=said.append)
    assert len(said) == 1
    assert not bool((gains[-1] == 1.0).any())


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["value", "gradient"])
def test_a_view_that_always_fails_is_left_out_by_name_and_term(spoil, carrier, train_views, transport, kind):
    def change(terms, model):
        terms["material"] = _NanGradient.apply(terms["material"]) * (math.inf if kind == "value" else 1)

    spoil(lambda step, view, model: view == "v3", change)
    said = []
    asset, _ = fit(carrier, train_views, transport, SETTINGS, warn=said.append)
    assert len(said) == 1
    assert "view v3" in said[0]
    assert "material term" in said[0]
    assert "left out" in said[0]
    assert _finite(asset)


def test_parameters_that_run_away_come_back_with_lower_rates(spoil, carrier, train_views, transport):
    """A term that overflows once the sky is brighter than some level, as a rate that is too large makes it."""

    def too_bright(step, view, model):
        return float(model.environment.detach().max()) > 4

    spoil(too_bright, lambda terms, model: terms.update(image=terms["image"] * math.inf))
    said = []
    wild = SETTINGS.replaced(environment_rate=3.0, iterations=60)
    asset, _ = fit(carrier, train_views, transport, wild, warn=said.append)
    assert 1 <= len(said) <= RETURNS
    assert all("rates times" in message for message in said)
    assert _finite(asset)


@pytest.mark.thorough
def test_a_fit_that_gets_worse_than_it_started_comes_back(spoil, carrier, train_views, transport):
    spoil(lambda step, view, model: step >= 20, lambda terms, model: terms.update(image=terms["image"] * 50))
    said = []
    asset, _ = fit(carrier, train_views, transport, SETTINGS.replaced(iterations=400), warn=said.append)
    assert len(said) == RETURNS + 1
    assert all(re.match(r"step \d+: the image term rose.*rates times", message) for message in said[:-1])
    assert "the last good state is kept" in said[-1]
    assert _finite(asset)


@pytest.mark.thorough
def test_a_rise_below_the_start_is_taken_back_at_the_end(spoil, carrier, train_views, transport, monkeypatch):
    """Far above its best and yet below 1.25 times its start, as a sky that runs away may end."""
    start, plain = [], Guard.start
    monkeypatch.setattr(Guard, "start", lambda guard: (plain(guard), start.append(guard.first)))
    spoil(
        lambda step, view, model: step >= 160,
        lambda terms, model: terms.update(image=terms["image"] * 0 + 1.1 * start[0]),
    )
    said = []
    fit(carrier, train_views, transport, SETTINGS.replaced(iterations=200), warn=said.append)
    assert len(said) == 1, said
    assert "the last good state is kept" in said[0]


def test_a_sky_term_that_never_is_finite_ends_in_an_error_that_names_it(spoil, carrier, train_views, transport):
    spoil(lambda step, view, model: step >= 10, lambda terms, model: terms.update(chroma=terms["chroma"] + math.nan))
    with pytest.raises(NumericsError, match=r"(?s)stage2 step 1\d, view v\d.*chroma term.*fix:"):
        fit(carrier, train_views, transport, SETTINGS)


@pytest.mark.thorough
def test_a_guarded_fit_resumes_to_the_same_bytes_and_says_its_warnings_again(
    spoil, carrier, train_views, transport, tmp_path
):
    class CutOff(Exception):
        pass

    spoil(
        lambda step, view, model: step in (12, 25),
        lambda terms, model: terms.update(environment=terms["environment"] * math.nan),
    )
    views = _broken(train_views, [2])
    whole_said, said = [], []
    whole, curves = fit(carrier, views, transport, SETTINGS, warn=whole_said.append)
    assert len(whole_said) == 3

    def checkpoint(now, state):
        if now == 20:
            save_state(tmp_path / "state", state)
            raise CutOff

    (tmp_path / "state").mkdir()
    with pytest.raises(CutOff):
        fit(carrier, views, transport, SETTINGS, checkpoint=checkpoint)
    again, same = fit(
        carrier, views, transport, SETTINGS, resumed=(20, load_state(tmp_path / "state")), warn=said.append
    )
    assert same == curves
    assert said == whole_said
    for name in ("base_color", "roughness", "environment", "seen"):
        assert getattr(again, name).tobytes() == getattr(whole, name).tobytes(), name


@pytest.mark.thorough
@pytest.mark.parametrize("share", [0.0, 0.4])
def test_the_memory_budget_does_not_change_a_byte(carrier, train_views, transport, share):
    settings = SETTINGS.replaced(iterations=20, ssim_weight=0.2, corrections=2)
    whole, curves = fit(carrier, train_views, transport, settings)
    from exmesh_graph.stage2.decomposition import Decomposition

    total = sum(Decomposition(carrier, train_views, transport, settings, "cpu").buffers.sizes)
    tight = settings.replaced(memory_gib=share * total / 2**30)
    held = Decomposition(carrier, train_views, transport, tight, "cpu").buffers.held
    assert len(held) == int(share * len(train_views))
    small, same = fit(carrier, train_views, transport, tight)
    assert same == curves
    for name in ("base_color", "roughness", "environment", "seen"):
        assert getattr(small, name).tobytes() == getattr(whole, name).tobytes(), name


@pytest.mark.thorough
@pytest.mark.parametrize("renewed", [True, False])
def test_colours_that_gather_are_no_running_away(monkeypatch, carrier, train_views, transport, renewed):
    """They raise the image term on purpose, in a fit that was near its end by far."""
    settings = SETTINGS.replaced(iterations=200, palette_width=0.1, corrections=0, material_rate=0.1)
    before, _ = fit(carrier, train_views, transport, settings.replaced(palette_width=0))

    def moved_far(maps, *_):
        maps.parameter.data[:, :3] += 2
        return 1.0

    monkeypatch.setattr(fitting, "gather_colors", moved_far)
    if not renewed:
        monkeypatch.setattr(Guard, "renew", lambda guard: None)
    said = []
    fit(carrier, train_views, transport, settings, start=before, warn=said.append)
    assert bool(said) != renewed
