"""The quick rows of the stability table, and the table itself."""

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from benchmarks.stability import table

ROOT = Path(__file__).parent.parent.parent


@pytest.mark.thorough
@pytest.mark.parametrize("row", [r for r in table.collect() if r.measure and not r.slow], ids=lambda r: r.name)
def test_row(row):
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    outcome = table.run(row)
    torch.set_num_threads(before)
    if outcome.verdict == "skipped":
        pytest.skip(outcome.note)
    assert outcome.verdict == "pass", f"{outcome} expected {outcome.expected}"


@pytest.mark.parametrize(
    ("reached", "verdict"),
    [
        ((0.5, None), "pass"),
        ((0.5, 0.5), "pass"),
        ((0.5, 1.5), "miss"),
        ((1.5, 0.5), "miss"),
        ((math.nan, 0.5), "miss"),
        ((None, None), "miss"),
    ],
)
def test_a_row_passes_only_within_its_bounds_in_both_precisions(reached, verdict):
    row = table.Row("room", "hazard", "figure", 0, 1, lambda: table.Reached(*reached))
    assert table.run(row).verdict == verdict


def test_a_row_that_raises_is_a_miss_and_one_without_its_library_is_not_a_pass():
    def broken():
        raise RuntimeError("overflow")

    outcome = table.run(table.Row("room", "hazard", "figure", 0, 1, broken))
    assert (outcome.verdict, outcome.note) == ("miss", "RuntimeError: overflow")
    row = table.Row("room", "hazard", "figure", 0, 1, broken, needs=("no_such_module",))
    assert table.run(row).verdict == "skipped"
    with pytest.raises(ValueError, match="cannot fail"):
        table.row("room", "hazard", "figure")


@pytest.mark.thorough
def test_the_command_exits_with_1_on_a_miss_and_writes_json(tmp_path):
    code = (
        "import sys\n"
        "from benchmarks.stability import table, __main__\n"
        "@table.row('probe', 'good', 'x', high=1)\n"
        "def good(): return table.Reached(0.0, 0.0)\n"
        "assert __main__.main() == 0\n"
        "@table.row('probe', 'bad', 'x', high=1)\n"
        "def bad(): return table.Reached(2.0)\n"
        "sys.argv[-1] = sys.argv[-1].replace('pass', 'miss')\n"
        "sys.exit(__main__.main())\n"
    )
    words = [sys.executable, "-c", code, "--only", "probe:", "--json", str(tmp_path / "pass.json")]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    assert "AssertionError" not in done.stderr
    for kind, expected in (("pass", ["pass"]), ("miss", ["pass", "miss"])):
        assert [o["verdict"] for o in json.loads((tmp_path / f"{kind}.json").read_text())] == expected
