"""What noise in the light does to a fit: the albedo of a sphere under known light, from 8 samples a point.

    python -m benchmarks.light_bias             # some seconds
    python -m benchmarks.light_bias --quick

Worst relative error of the albedo after a short fit by Adam, for three losses; the gradient drawn by a seed of its own,
and by the image's; samples drawn by the sky, and spread over the sphere, which is much noisier.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import torch

from benchmarks.stability.rows_light import fitted_bias, log_l1
from exmesh_graph.losses import l1

LOSSES = {"L1": l1, "log-L1": log_l1, "squared": lambda image, target: (image - target).square().mean()}


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.light_bias",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--quick", action="store_true", help="20 steps on a tenth of the points")
    parser.add_argument("--json", type=Path, help="write the rows here too")
    options = parser.parse_args()
    torch.set_num_threads(1)
    steps, count = (20, 50) if options.quick else (options.steps, 500)
    rows = []
    print(f"{'':34}{'own seed':>10}{'one seed':>10}")
    for uniform in (False, True):
        for name, loss in LOSSES.items():
            own, one = (fitted_bias(loss, seed, uniform, steps, count) for seed in (True, False))
            samples = "spread uniformly" if uniform else "by the sky"
            rows.append({"loss": name, "samples": samples, "own_seed": own, "one_seed": one})
            print(f"{name + ', samples ' + samples:34}{own:10.1%}{one:10.1%}", flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
