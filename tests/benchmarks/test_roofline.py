"""The roofline's arithmetic: what a floor is, and what the model of more cores divides."""

import pytest

from benchmarks import roofline

ROW = {
    "ms": 10.0,
    "kernels": {
        "shared": {"ms": 6.0, "shared": True, "items": 4},
        "alone": {"ms": 1.0, "shared": False, "items": 100},
    },
}


def test_only_shared_launches_are_divided_and_by_no_more_than_their_items():
    assert roofline.modelled(ROW, 1) == pytest.approx(10)
    assert roofline.modelled(ROW, 2) == pytest.approx(7)
    assert roofline.modelled(ROW, 4) == roofline.modelled(ROW, 32) == pytest.approx(5.5)


def test_a_floor_is_the_longer_of_moving_and_computing():
    limits = {"GB/s": 10.0, "GFLOP/s": 100.0}
    found = roofline.floors({"shared": (2e7, 1e8), "not there": (1.0, 1.0)}, ROW["kernels"], limits)
    assert list(found) == ["shared"]
    assert (found["shared"]["by_bytes"], found["shared"]["by_flops"]) == pytest.approx((2.0, 1.0))
    text = "\n".join(roofline.lines("a stage", {**ROW, "floors": found}))
    assert "33%  memory" in text
    assert "outside of kernels" in text
    assert "serial 40%" in text


def test_a_step_of_stage_one_is_timed_kernel_by_kernel():
    options = roofline.argparse.Namespace(size=64, faces=500, texels=96)
    step = roofline.STAGES["stage1"](options)
    row = roofline.measured(step, 2)
    counted = step.counts()
    assert {"paint_faces", "paint_adjoint", "ssim_strips", "adam_blocks"} <= row["kernels"].keys() & counted.keys()
    assert sum(kernel["ms"] for kernel in row["kernels"].values()) < row["ms"]
    assert all(moved > 0 and computed > 0 for moved, computed in counted.values())
