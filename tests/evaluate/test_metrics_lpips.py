"""LPIPS against a slow reading of its formula, on made-up weights: the published ones are not in the repository."""

import os

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from exmesh_graph.errors import MissingLibraryError, NumericsError
from exmesh_graph.evaluate.metrics.lpips import Lpips
from exmesh_graph.evaluate.metrics.weights import expected_shapes, lpips_source
from exmesh_graph.evaluate.scores import add_lpips


@pytest.fixture(scope="module")
def weights():
    generator = torch.Generator().manual_seed(0)
    return {
        name: torch.randn(shape, generator=generator).abs() * 0.1
        if name.startswith("lin")
        else torch.randn(shape, generator=generator) * (2 / max(1, int(np.prod(shape[1:])))) ** 0.5 * 0.8
        for name, shape in expected_shapes().items()
    }


@pytest.fixture(scope="module")
def pictures():
    rng = np.random.default_rng(3)
    return rng.uniform(0, 1, (2, 16, 16, 3))


def slow(weights, image, reference):
    """Convolution by sums over shifted planes, float64."""

    def features(x):
        x = ((2 * x - 1) - [-0.030, -0.088, -0.188]) / np.array([0.458, 0.448, 0.450])
        found = []
        for block in ((0, 2), (5, 7), (10, 12, 14), (17, 19, 21), (24, 26, 28)):
            if block[0]:
                h, w, c = x.shape
                x = x.reshape(h // 2, 2, w // 2, 2, c).max((1, 3))
            for i in block:
                kernel = weights[f"features.{i}.weight"].double().numpy()
                p = np.pad(x, ((1, 1), (1, 1), (0, 0)))
                h, w, _ = x.shape
                x = sum(p[a : a + h, b : b + w] @ kernel[:, :, a, b].T for a in range(3) for b in range(3))
                x = np.maximum(x + weights[f"features.{i}.bias"].double().numpy(), 0)
            found.append(x / (np.sqrt((x**2).sum(-1, keepdims=True)) + 1e-10))
        return found

    total = 0.0
    for layer, (a, b) in enumerate(zip(features(image), features(reference), strict=True)):
        w = weights[f"lin{layer}.model.1.weight"].double().numpy().ravel()
        total += float((((a - b) ** 2) @ w).mean())
    return total


def test_it_equals_the_formula(weights, pictures):
    lpips = Lpips(weights)
    assert lpips(*pictures) == pytest.approx(slow(weights, *pictures), rel=1e-4)
    assert lpips(pictures[0], pictures[0]) == 0
    assert lpips(*pictures) == lpips(*pictures)


def test_mistakes_change_it_or_are_refused(weights, pictures):
    lpips = Lpips(weights)
    first, second = pictures
    right = lpips(first, second)
    assert abs(lpips(first[..., ::-1], second[..., ::-1]) / right - 1) > 1e-3  # BGR
    assert abs(lpips(first**2.2, second**2.2) / right - 1) > 1e-3  # linear light
    for wrong in (first * 255, first * 2 - 1, first * np.nan):
        with pytest.raises(NumericsError, match="display values"):
            lpips(wrong, second)
    with pytest.raises(NumericsError, match="shapes"):
        lpips(first[:8], second)


def test_without_weights_it_says_what_to_do(weights, tmp_path):
    with pytest.raises(MissingLibraryError, match="no file") as caught:
        Lpips.from_file(None)
    assert "docs/metrics.md" in caught.value.fix
    with pytest.raises(MissingLibraryError, match="is there"):
        Lpips.from_file(tmp_path / "none.safetensors")
    (tmp_path / "old.pth").write_bytes(b"\x80\x02}q\x00.")
    with pytest.raises(MissingLibraryError, match="cannot be read"):
        Lpips.from_file(tmp_path / "old.pth")
    save_file({k: v for k, v in weights.items() if k != "lin3.model.1.weight"}, str(tmp_path / "part.safetensors"))
    with pytest.raises(MissingLibraryError, match=r"lin3\.model\.1\.weight is missing"):
        Lpips.from_file(tmp_path / "part.safetensors")
    save_file(weights | {"lin3.model.1.weight": torch.ones(1, 256, 1, 1)}, str(tmp_path / "other.safetensors"))
    with pytest.raises(MissingLibraryError, match=r"lin3\.model\.1\.weight is \(1, 256, 1, 1\)"):
        lpips_source(tmp_path / "other.safetensors")  # before anything runs
    assert lpips_source(None) == {}


def test_scores_get_it_for_the_pictures_their_psnr_was_taken_on(weights, pictures, tmp_path):
    first, second = pictures
    file = tmp_path / "weights.safetensors"
    save_file(weights, str(file))
    values = {"headline": [], "held_out": {"psnr_per_view": {"a": 1.0, "b": 2.0}}, "relit": {"per_light": {"sun": {}}}}
    held_out, relit = [(first, second), (first, first)], {"sun": [(second, first)]}
    add_lpips(values, None, held_out, relit)
    assert values["headline"] == []
    add_lpips(values, file, held_out, relit)
    lpips = Lpips(weights)
    one = lpips(first, second)
    assert values["held_out"]["lpips"] == pytest.approx(one / 2)
    assert values["held_out"]["lpips_per_view"] == {"a": pytest.approx(one), "b": 0}
    assert values["relit"]["lpips"] == values["relit"]["per_light"]["sun"]["lpips"] == lpips(second, first)
    shown = [(row["label"], row["better"], row.get("series")) for row in values["headline"]]
    assert shown == [("Held-out LPIPS", "lower", "held-out LPIPS"), ("Relit LPIPS", "lower", None)]


def test_the_published_weights_give_the_values_of_the_package():
    """docs/metrics.md's table, whose values the `lpips` package gave too (benchmarks/lpips_reference.py)."""
    file = os.environ.get("EXMESH_LPIPS")
    if not file:
        pytest.skip("EXMESH_LPIPS names no file of the published weights")
    from benchmarks.lpips_reference import faults, sample

    lpips, picture, found = Lpips.from_file(file), sample(), faults()
    for name, value in (("noise of 0.05", 0.363322), ("blurred by a pixel", 0.064075), ("moved by a pixel", 0.012079)):
        assert lpips(np.clip(found[name](picture), 0, 1), picture) == pytest.approx(value, abs=2e-6)
