"""Nodes that share a process do not reach each other through it."""

from __future__ import annotations

import locale
import os
import random
import subprocess
import sys
import time
from typing import Any

import numpy as np
import pytest
import torch

from exmesh_graph.graph.run.backends.local import Local
from exmesh_graph.graph.run.hermetic import apart

CLOCK = time.localtime(0).tm_hour  # before any node could change it


@pytest.mark.thorough
@pytest.mark.parametrize("workers", [0, 1])
@pytest.mark.reliability(
    "a node leaves environment, folder, seeds, default type or error states changed",
    "the next one finds them untouched",
)
def test_what_a_node_leaves_behind_reaches_no_other(bench: Any, tmp_path: Any, workers: int) -> None:
    here = _here()
    text = f"""
nodes:
  a: {{type: toy.const, value: 5}}
  before: {{type: toy.found, number: "@a.number", seed: 3}}
  b: {{type: toy.found, number: "@a.number", seed: 4}}
  x: {{type: toy.untidy, number: "@a.number", folder: {tmp_path}}}
  after: {{type: toy.found, number: "@x.number", seed: 3}}
"""
    record = bench.run(text, **({"backend": Local(workers)} if workers else {}))
    before, other, after = (bench.value(record, name, "metrics").values for name in ("before", "b", "after"))
    assert {row["state"] for row in record["nodes"]} == {"done"}, "no hit tells anything"
    assert other["numpy"] != before["numpy"], "another seed"
    assert after["pid"] == before["pid"], "one process"
    assert after == before
    fresh = {  # `before` may run after the untidy one, and be as spoilt
        "left": "", "home": os.environ.get("HOME", ""), "folder": os.getcwd(), "dtype": "torch.float32", "grad": True,
        "device": "cpu", "clock": CLOCK, "matmul": "highest", "strict": False, "call": "None",
        "printed": "[0.33333333]", "third": "0." + 28 * "3",
    }  # fmt: skip
    assert {name: after[name] for name in fresh} == fresh
    assert after["stdout"] != "StringIO"
    assert here == _here()


def _here() -> Any:
    """What this process is like, in which nodes run without workers."""
    threads, kind = torch.get_num_threads(), torch.get_default_dtype()
    return os.getcwd(), dict(os.environ), kind, threads, np.geterr(), random.getstate()


def test_global_generators_start_from_the_seed_and_go_on_after_it() -> None:
    def drawn() -> tuple[float, float, float]:
        return random.random(), float(np.random.rand()), float(torch.rand(()))  # noqa: NPY002

    random.seed(7), np.random.seed(7), torch.manual_seed(7)  # noqa: NPY002
    expected = drawn(), drawn()
    random.seed(7), np.random.seed(7), torch.manual_seed(7)  # noqa: NPY002
    first = drawn()
    inside = []
    for seed in (4, 4, 5):
        with apart(seed):
            inside.append(drawn())
    assert inside[0] == inside[1]
    assert not set(inside[0]) & set(inside[2])
    assert (first, drawn()) == expected


def test_the_locale_is_put_back() -> None:
    before = locale.setlocale(locale.LC_ALL)
    with apart(1):
        try:
            locale.setlocale(locale.LC_ALL, "C.UTF-8" if before == "C" else "C")
        except locale.Error:
            pytest.skip("this system has one locale alone")
        assert locale.setlocale(locale.LC_ALL) != before
    assert locale.setlocale(locale.LC_ALL) == before


FIRST = """
import sys
from exmesh_graph.graph.run.hermetic import apart
for module in sys.argv[1:]:
    __import__(module)
with apart(5):
    import numpy, torch
    print(numpy.random.random(), float(torch.rand(1)))
"""


@pytest.mark.thorough
@pytest.mark.reliability("a node is the first in its process to import numpy or torch", "they start from its seed too")
def test_who_imports_first_draws_the_same() -> None:
    runs = [subprocess.run([sys.executable, "-c", FIRST, *loaded], capture_output=True, text=True, check=True).stdout
            for loaded in ([], ["numpy", "torch"])]  # fmt: skip
    assert runs[0] == runs[1]
