"""`exmesh bench` on a folder of stand-in benchmarks: what is kept, what is compared, what is refused."""

import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmarks.bench import KERNELS, changes, flat
from exmesh_graph.cli.app import app
from exmesh_graph.errors import ExmeshError, GraphError

SCRIPT = """
import argparse, json
p = argparse.ArgumentParser()
p.add_argument("--quick", action="store_true")
p.add_argument("--json")
o = p.parse_args()
{extra}
rows = [{{"name": "one ray", "seconds": 0.5, "same": True}}]
json.dump({{"rate": {rate}, "rows": rows, "quick": int(o.quick)}}, open(o.json, "w"))
"""


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")  # a script of the same second and size is read anew
    (tmp_path / "benchmarks").mkdir()
    (tmp_path / "graphs").mkdir()
    shutil.copy(Path(__file__).parents[2] / "benchmarks" / "bench.py", tmp_path / "benchmarks")
    for name in (*KERNELS, "framework"):
        (tmp_path / "benchmarks" / f"{name}.py").write_text(SCRIPT.format(rate=2.0, extra=""))
    return tmp_path


def bench(checkout, *words):
    words = ["bench", *words, "--root", str(checkout), "--history", str(checkout / "kept")]
    return CliRunner().invoke(app, words, catch_exceptions=False)


def test_figures_are_named_after_where_they_stand():
    values = {"a": {"b": 1}, "rows": [{"name": "x", "mode": "fast", "seconds": 2.5}, {"seconds": 3}], "ok": True}
    assert dict(flat(values, "f")) == {"f.a.b": 1, "f.rows.x fast.seconds": 2.5, "f.rows.1.seconds": 3}
    assert changes({"a": 3.0, "b": 1.0, "c": 1.0}, {"a": 2.0, "b": 0.0}) == {"a": 1.5}


def test_a_result_is_kept_and_the_next_is_compared_with_it(checkout):
    out = bench(checkout, "kernels", "framework", "--quick")
    kept = list((checkout / "kept").glob("*-quick.json"))
    assert len(kept) == 1
    result = json.loads(kept[0].read_text())
    assert result["schema"] == "exmesh.bench.v1"
    assert set(result["suites"]) == {"kernels", "framework"}
    assert result["suites"]["kernels"]["rays.rows.one ray.seconds"] == 0.5
    assert result["suites"]["kernels"]["rays.quick"] == 1
    assert result["machine"]["cpus"] > 0
    assert 0 < result["processor_seconds"] < 60
    assert "x 1.00" not in out.stdout
    (checkout / "benchmarks" / "rays.py").write_text(SCRIPT.format(rate=3.0, extra=""))
    kept[0].rename(checkout / "kept" / "2000-quick.json")
    again = bench(checkout, "kernels", "--quick", "--compare", "latest", "--json", str(checkout / "now.json"))
    changed = next(line for line in again.stdout.splitlines() if "rays.rate" in line)
    assert "x 1.50  <--" in changed
    assert "x 1.00" in again.stdout
    assert json.loads((checkout / "now.json").read_text())["suites"]["kernels"]["rays.rate"] == 3.0


@pytest.mark.thorough
def test_what_earlier_results_span_is_not_marked(checkout):
    """Noise: a figure that came out so before; a result of another machine teaches nothing."""
    for number, rate in enumerate((2.0, 3.0, 2.0)):
        (checkout / "benchmarks" / "rays.py").write_text(SCRIPT.format(rate=rate, extra=""))
        bench(checkout, "kernels", "--quick", "--json", str(checkout / "now.json"))
        for file in (checkout / "kept").glob("202*.json"):
            file.rename(checkout / "kept" / f"200{number}-quick.json")
    for rate, expected in ((3.0, "x 1.50  (seen before)"), (3.2, "x 1.60  <--"), (1.0, "x 0.50  <--"), (2.1, "x 1.05")):
        (checkout / "benchmarks" / "rays.py").write_text(SCRIPT.format(rate=rate, extra=""))
        out = bench(checkout, "kernels", "--quick", "--compare", str(checkout / "kept" / "2002-quick.json")).stdout
        assert next(line for line in out.splitlines() if "rays.rate" in line).endswith(expected)
        for file in (checkout / "kept").glob("202*.json"):
            file.unlink()
    wide = checkout / "kept" / "2001-quick.json"
    other = json.loads(wide.read_text())
    other["machine"]["cpus"] += 1
    wide.write_text(json.dumps(other))
    (checkout / "kept" / "2000-9-quick.json").write_text("no result")
    (checkout / "benchmarks" / "rays.py").write_text(SCRIPT.format(rate=3.0, extra=""))
    out = bench(checkout, "kernels", "--quick", "--compare", str(checkout / "kept" / "2002-quick.json")).stdout
    assert next(line for line in out.splitlines() if "rays.rate" in line).endswith("x 1.50  <--")


def test_what_is_refused_before_anything_runs(checkout, tmp_path):
    with pytest.raises(GraphError, match="no suite 'kernel'") as caught:
        bench(checkout, "kernel")
    assert "kernels" in caught.value.expected
    with pytest.raises(GraphError, match="no earlier quick result"):
        bench(checkout, "kernels", "--quick", "--compare", "latest")
    with pytest.raises(GraphError, match="no benchmarks/"):
        CliRunner().invoke(app, ["bench", "--root", str(tmp_path / "graphs")], catch_exceptions=False)
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(GraphError, match="no result of `exmesh bench`"):
        bench(checkout, "kernels", "--compare", str(tmp_path / "other.json"))
    long = {"schema": "exmesh.bench.v1", "quick": False, "suites": {}}
    (tmp_path / "long.json").write_text(json.dumps(long))
    with pytest.raises(GraphError, match="without --quick"):
        bench(checkout, "kernels", "--quick", "--compare", str(tmp_path / "long.json"))


def test_a_benchmark_that_fails_says_why(checkout):
    (checkout / "benchmarks" / "losses.py").write_text(SCRIPT.format(rate=1, extra="raise ValueError('no such scene')"))
    with pytest.raises(ExmeshError, match="no such scene"):
        bench(checkout, "kernels")


SCORES = """
import json, sys
json.dump(sys.argv[1:], open("asked.json", "w"))
sys.exit(3 if "broken" in sys.argv else 0)
"""


def test_scenes_are_scored_by_the_checkout(checkout, monkeypatch, tmp_path):
    (checkout / "benchmarks" / "scores.py").write_text(SCORES)
    done = bench(checkout, "--scenes", "score", "--scene", "padlock", "--set", "settle.iterations=20", "--dry")
    assert done.exit_code == 0
    asked = json.loads((checkout / "asked.json").read_text())
    places = {asked[k]: asked[k + 1] for k in (0, 2, 4)}
    assert places == {"--role": "score", "--out": str(checkout / "kept" / "score"), "--data": str(checkout / "scenes")}
    assert asked[6:] == ["--scene", "padlock", "--set", "settle.iterations=20", "--dry"]
    monkeypatch.chdir(tmp_path)
    done = bench(checkout, "--scenes", "choose", "--data", "mine", "--data", "yours", "--scene", "broken")
    assert done.exit_code == 3
    asked = json.loads((checkout / "asked.json").read_text())
    assert [Path(asked[k]) for k in (5, 7)] == [tmp_path / "mine", tmp_path / "yours"]


def test_speed_is_measured_by_the_checkout(checkout):
    (checkout / "benchmarks" / "speed.py").write_text(SCORES)
    assert bench(checkout, "--speed", "--quick", "--against", "abc").exit_code == 0
    assert json.loads((checkout / "asked.json").read_text()) == ["--quick", "--against", "abc"]
    assert bench(checkout, "--speed", "--against", "broken").exit_code == 3
    with pytest.raises(GraphError, match="--against goes with --speed"):
        bench(checkout, "--against", "abc")
    with pytest.raises(GraphError, match="--scenes does not go with --speed"):
        bench(checkout, "--speed", "--scenes", "score")


def test_options_that_do_not_go_together_are_refused(checkout):
    with pytest.raises(GraphError, match="kernels measures the machine"):
        bench(checkout, "kernels", "--scenes", "score")
    with pytest.raises(GraphError, match="--data goes with --scenes"):
        bench(checkout, "--data", "mine")
