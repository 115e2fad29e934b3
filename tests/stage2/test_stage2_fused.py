"""The fused step against plain operations: values, gradients, hard inputs; the same bytes for any number of cores."""

import copy
import dataclasses

import numpy as np
import pytest
import torch

from exmesh_graph.gpu.cores import cores
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.fused import step as fused
from exmesh_graph.stage2.objective import plain_terms, weighted_terms
from exmesh_graph.stage2.settings import DecompositionSettings

SETTINGS = DecompositionSettings(
    environment_height=16, texture_size=48, iterations=25, material_rate=0.05, environment_rate=0.1, indirect_ramp=5,
    corrections=1, correction_samples=2, material_weight=0.05,
)  # fmt: skip
STEP = 10


def _model(carrier, views, transport, start=None, **settings):
    model = Decomposition(carrier, views, transport, SETTINGS.replaced(**settings), "cpu", start=start)
    model.start()
    return model


def _stir(model, seed=0, spread=1.0):
    """Parameters away from where they start."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in (model.maps.parameter, model.environment, model.factor.parameter):
            scale = spread if parameter.dim() > 1 else 0.1
            parameter += scale * torch.randn(parameter.shape, generator=generator)
    return model


def _found(terms_of, model, number, step=STEP):
    """Terms, radiance, and the gradients of their sum, float64."""
    parameters = [p for p in (model.maps.parameter, model.environment, model.factor.parameter) if p.requires_grad]
    for parameter in parameters:
        parameter.grad = None
    terms, predicted = terms_of(model, model.buffers[number], step)
    torch.stack(list(terms.values())).sum().backward()
    gradients = [p.grad.double() for p in parameters]
    return {name: float(value.detach()) for name, value in terms.items()}, predicted.double(), gradients


def _doubled(value):
    """A deep copy with every float32 tensor in float64: the reference."""
    memo = {}

    def visit(item):
        if id(item) in memo:
            return memo[id(item)]
        if isinstance(item, torch.Tensor):
            wide = item.detach().double() if item.dtype == torch.float32 else item
            result = wide.requires_grad_(item.requires_grad) if item.requires_grad else wide
        elif isinstance(item, dict):
            result = {key: visit(entry) for key, entry in item.items()}
        elif isinstance(item, tuple) and hasattr(item, "_fields"):
            result = type(item)(*map(visit, item))
        elif isinstance(item, list | tuple):
            result = type(item)(map(visit, item))
        elif type(item).__module__.startswith("exmesh_graph.s") and hasattr(item, "__dict__"):
            result = copy.copy(item)
            memo[id(item)] = result
            for name, entry in vars(item).items():
                object.__setattr__(result, name, visit(entry))
        else:
            result = item
        memo[id(item)] = result
        return result

    return visit(value)


def _agree(model, number=2, tolerance=2e-5, step=STEP):
    assert fused.serves(model)
    for operators in (model.light.operators, getattr(model.light.suns, "operators", None)):
        if operators is not None and operators.gather is not None:
            assert operators.gather_transposed is not None  # made when first asked for: doubled with the rest
    reference = _doubled(model)
    assert not fused.serves(reference)
    terms, predicted, gradients = _found(weighted_terms, model, number, step)
    known, shown, slopes = _found(plain_terms, reference, number, step)
    assert terms.keys() == known.keys()
    for name, value in known.items():
        assert terms[name] == pytest.approx(value, rel=tolerance, abs=1e-9), name
    torch.testing.assert_close(predicted, shown, rtol=tolerance, atol=1e-6)
    for found, expected in zip(gradients, slopes, strict=True):
        # the common factor's gradient is what is left of sums a hundred times as large
        close = tolerance * (5 if expected.dim() == 1 else 1)
        assert float((found - expected).norm()) <= close * float(expected.norm()) + 1e-12
    return known


@pytest.mark.thorough
@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"metallic": True, "exposure": True},
        {"ssim_weight": 0.0, "material_weight": 0.0, "chroma_weight": 0.0},
        {"texture_size": 2, "environment_height": 8},
        {"log_weight": 0.0},
        {"metallic": True, "gloss_weight": 7.0},
        {"variation": "log", "metallic": True},
    ],
)
def test_terms_and_gradients_are_those_of_plain_operations_in_float64(carrier, train_views, transport, settings):
    model = _stir(_model(carrier, train_views, transport, **settings))
    if model.exposure is not None:
        model.exposure.logs += torch.linspace(-0.5, 0.5, 8)
    model.measure(1.0, torch.Generator().manual_seed(0))
    _agree(model)


def test_every_kind_of_transport(carrier, train_views, transport, true_asset):
    direct = dataclasses.replace(transport, bounces=0, gather_start=None, gather_point=None, gather_weight=None)
    _agree(_stir(_model(carrier, train_views, direct)))
    _agree(_stir(_model(carrier, train_views, dataclasses.replace(transport, secondary_material=False))))
    _agree(_stir(_model(carrier, train_views, dataclasses.replace(transport, deeper=True))))
    known = _agree(_stir(_model(carrier, train_views, transport, start=true_asset, keep_light=True)))
    assert "environment" not in known


def test_suns_kept_apart(carrier, train_views, transport, true_asset):
    sky = np.full((16, 32, 3), 0.3, np.float32)
    sky[4, 20], sky[3, 7] = 300, 150
    model = _model(carrier, train_views, transport, start=dataclasses.replace(true_asset, environment=sky))
    model.measure(1.0, torch.Generator().manual_seed(0))
    assert len(model.light.suns.suns) == 2
    _agree(_stir(model, spread=0.3))


@pytest.mark.parametrize(
    ("maps", "sky"),
    [
        ((0.0, -30.0), 0.0),  # roughness at its lower end
        ((0.0, 30.0), 0.0),  # and past 1
        ((-80.0, 0.0), -80.0),  # black under no light
        ((30.0, 0.0), 6.0),  # white, and far above what a file holds
        ((0.0, 0.0), 80.0),
    ],
)
def test_hard_states(carrier, train_views, transport, maps, sky):
    views = dataclasses.replace(train_views, clipped=True)
    model = _stir(_model(carrier, views, transport, roughness_min=0.03), spread=0.2)
    with torch.no_grad():
        model.maps.parameter[:, :3] += maps[0]
        model.maps.parameter[:, 3] += maps[1]
        model.environment += sky
    _agree(model, tolerance=5e-5)


def test_small_and_empty_views(carrier, train_views, transport):
    alpha = train_views.alpha.copy()
    row, column = (int(k) for k in np.argwhere(alpha[2] > 0.99)[50])
    alpha[2] = 0
    alpha[2, row, column] = 1
    alpha[3, : row + 3] = 0
    alpha[4] = 0
    model = _stir(_model(carrier, dataclasses.replace(train_views, alpha=alpha), transport))
    assert model.buffers.pixels[2] == 1
    assert _agree(model, 2)["material"] == 0
    _agree(model, 3)
    with torch.no_grad():
        terms, predicted = weighted_terms(model, model.buffers[4], STEP)
    assert np.isnan(float(terms["image"]))  # as any mean over nothing
    assert predicted.shape == (0, 3)


def test_photographs_at_the_top_of_their_range(carrier, train_views, transport):
    images = np.minimum(1, 4 * train_views.images)
    views = dataclasses.replace(train_views, images=np.minimum(images, train_views.alpha[..., None]), clipped=True)
    model = _stir(_model(carrier, views, transport), spread=0.3)
    assert float(model.buffers[2].clipped.float().mean()) > 0.3
    _agree(model)


@pytest.mark.thorough
def test_the_same_bytes_for_any_number_of_cores_and_on_repeat(carrier, train_views, transport, monkeypatch):
    """Pieces are cut small enough that there are many; of two sizes of pieces the bytes differ only by rounding."""
    from exmesh_graph.stage2.fused import maps, view

    for module, name, size in ((maps, "POINTS", 64), (maps, "ROWS", 256), (view, "PIXELS", 64), (view, "LEAST", 64)):
        monkeypatch.setattr(module, name, size)
    found = []
    for count in (1, 2, 3, 1):
        with cores(count):
            asset, curves = fit(carrier, train_views, transport, SETTINGS.replaced(iterations=6), seed=3)
        found.append((*(getattr(asset, name).tobytes() for name in ("base_color", "roughness", "environment")), curves))
    assert all(one == found[0] for one in found)


@pytest.mark.thorough
def test_a_fit_goes_the_way_of_plain_operations(carrier, train_views, transport, true_asset, monkeypatch):
    """From maps without equal neighbours, whose variation has no ties for rounding to decide."""
    generator = np.random.default_rng(0)
    color, roughness = (generator.uniform(0.3, 0.7, shape).astype(np.float32) for shape in ((64, 64, 3), (64, 64)))
    start = dataclasses.replace(true_asset, base_color=color, roughness=roughness)
    asset, curves = fit(carrier, train_views, transport, SETTINGS, seed=1, start=start)
    monkeypatch.setattr(fused, "serves", lambda model: False)
    plain, expected = fit(carrier, train_views, transport, SETTINGS, seed=1, start=start)
    np.testing.assert_allclose(curves["loss"], expected["loss"], rtol=5e-4)  # rounding, as Adam magnifies it
    for name in ("base_color", "roughness", "environment"):
        found, known = getattr(asset, name), getattr(plain, name)
        # Adam divides a gradient by its size: a texel with next to none may go either way
        assert np.quantile(np.abs(found - known), 0.95) < 2e-3, name
        assert np.median(np.abs(found - known)) < 1e-5, name


def test_a_views_terms_may_be_differentiated_again_until_the_next_view(carrier, train_views, transport):
    """The guard takes terms apart; the pixels' record then serves the next view."""
    model = _stir(_model(carrier, train_views, transport))
    terms, _ = weighted_terms(model, model.buffers[2], STEP)
    whole = torch.autograd.grad(sum(terms.values()), model.maps.parameter, retain_graph=True)[0]
    parts = [torch.autograd.grad(terms[name], model.maps.parameter, retain_graph=True)[0] for name in terms if
             name not in ("environment", "chroma")]  # fmt: skip
    torch.testing.assert_close(torch.stack(parts).sum(0), whole, rtol=1e-4, atol=1e-9)
    weighted_terms(model, model.buffers[3], STEP)
    with pytest.raises(RuntimeError, match="differentiated again"):
        terms["image"].backward()


def test_the_pass_that_writes_a_gradient_tells_its_largest_value(carrier, train_views, transport):
    model = _stir(_model(carrier, train_views, transport))
    terms, _ = weighted_terms(model, model.buffers[0], 3)
    loss = torch.stack(list(terms.values())).sum()
    for factor in (1.0, float("inf")):
        model.maps.parameter.grad = None
        (factor * loss).backward(retain_graph=True)
        gradient = model.maps.parameter.grad
        address, version, largest = model.maps.extreme
        assert (address, version) == (gradient.data_ptr(), gradient._version)
        assert largest == float(gradient.abs().max()) if factor == 1 else not np.isfinite(largest)
    gradient += 1  # another term's share of it
    assert version != gradient._version
