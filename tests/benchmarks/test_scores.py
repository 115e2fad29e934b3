"""The table of a role: what is run, in what time it is expected to end, and what it says of a scene that fails."""

from pathlib import Path
from types import SimpleNamespace

import pytest

import exmesh_graph as ex
from benchmarks import scores
from benchmarks.register import scenes
from exmesh_graph.errors import ExmeshError

FIGURE = {"PSNR": SimpleNamespace(value=30.0, unit="dB", floor=20.0)}


class FakeRun:
    metrics, folder = FIGURE, Path("runs/one")


@pytest.fixture
def data(tmp_path):
    for name in ("padlock", "still", "chair"):
        (tmp_path / "data" / name).mkdir(parents=True)
        (tmp_path / "data" / name / "transforms_train.json").write_text("{}")
    return tmp_path / "data"


def test_scores_only_the_role_and_goes_on_after_a_failure(data, tmp_path, monkeypatch):
    asked = {}

    def run(graph, *, scene, **_):
        asked[Path(scene).name] = Path(graph)
        if Path(scene).name == "still":
            raise ExmeshError("no depth was found", where="coarse", fix="more texture")
        return FakeRun()

    monkeypatch.setattr(ex, "run", run)
    said: list[str] = []
    rows = scores.score_scenes("score", tmp_path / "out", data=[data], say=said.append)
    assert set(asked) == {"padlock", "still"}
    assert asked["padlock"] == scores.QUICKSTART
    written = asked["still"].read_text()
    assert "init.auto" in written
    assert "hull: null" in written
    assert [row["scene"] for row in rows] == ["padlock", "still"]
    table = (tmp_path / "out" / "table.md").read_text()
    assert "30 (20)" in table
    assert "failed" in table
    assert scores.processor() in table
    assert "plant" in said[0]


def test_says_how_long_before_anything_runs(data, tmp_path, monkeypatch):
    monkeypatch.setattr(ex, "run", lambda *_, **__: pytest.fail("nothing was to run"))
    said: list[str] = []
    assert scores.score_scenes("score", tmp_path / "out", data=[data], dry=True, say=said.append) == []
    assert "2 scenes" in " ".join(said)
    memory = {"quickstart": {"chair": 250.0}}
    assert scores.expected(scenes()["padlock"], "quickstart", memory) == pytest.approx(250.0)
    assert scores.expected(scenes()["chair_sample"], "quickstart", memory) == pytest.approx(
        250 * 36 * 256**2 / 48 / 512**2
    )
    assert scores.expected(scenes()["chair"], "other", {}) > scores.MODEL[0]


def test_a_scene_of_another_role_is_refused(data, tmp_path):
    with pytest.raises(ValueError, match="chair"):
        scores.score_scenes("score", tmp_path / "out", data=[data], names=["chair"])
    with pytest.raises(ValueError, match="no scene"):
        scores.score_scenes("score", tmp_path / "out", data=[tmp_path / "nothing"])


def test_the_graph_for_scenes_without_masks_is_sound(tmp_path):
    file = tmp_path / "no_masks.yaml"
    file.write_text(scores.NO_MASKS.format(graph=scores.QUICKSTART, name="quickstart"))
    checked = ex.check(file, scene=str(scores.ROOT / "graphs" / "samples" / "chair"))
    assert checked.name == "quickstart_no_masks"
