"""The estimate of a long graph: its arithmetic, and that a trial runs and counts each fit at its whole length."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import estimate

ROOT = Path(__file__).parents[2]


def test_the_fixed_part_is_counted_once() -> None:
    # 5 s beside the loop and 0.25 s an iteration
    assert estimate.extended(5 + 0.25 * 8, 5 + 0.25 * 24, few=8, gap=16, length=1000) == pytest.approx(5 + 250)


def test_noise_cannot_make_an_iteration_free() -> None:
    assert estimate.extended(4.0, 3.0, few=10, gap=20, length=900) == pytest.approx(90.0)


def test_rounds_are_summed_up_and_stages_stand_beside_the_paper() -> None:
    rows = [
        estimate.Row("rounds[1].refine", "Stage I", 1.0, 60.0, 1000),
        estimate.Row("rounds[2].refine", "Stage I", 1.0, 30.0, 500),
        estimate.Row("pbr", "Stage II", 2.0, 600.0, 10000),
    ]
    text = "\n".join(estimate.lines(rows))
    assert "rounds.refine" in text
    assert "1500" in text
    assert "1.5 min    the paper: 10 min" in text
    assert "10.0 min    the paper: 17 min" in text
    assert text.endswith("11.5 min")


@pytest.mark.slow
def test_a_trial_of_the_papers_graph() -> None:
    small = {
        "views.downscale": 8, "views.max_views": 6, "views.max_test_views": 1, "texels": 64, "faces": 3000,
        "coarse.faces": 400, "gaussians.count": 800, "gaussians.max_gaussians": 1000,
        "pbr.environment_height": 16, "rounds.repeat": 3,
    }  # fmt: skip
    rows = {row.node: row for row in estimate.estimate(ROOT / "graphs" / "paper.yaml", small, share=0.001)}
    assert {"gaussians", "rounds[1].refine", "settle", "pbr"} <= set(rows)
    assert "fused" not in rows
    for name, iterations in (("gaussians", 5000), ("rounds[1].refine", 1000), ("settle", 4000), ("pbr", 10000)):
        assert rows[name].iterations == iterations
        assert rows[name].whole > 3 * rows[name].trial > 0, name
