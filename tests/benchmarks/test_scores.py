"""The table of a role: what is run, in what time it is expected to end, and what it says of a scene that fails."""

from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import pytest

import exmesh_graph as ex
from benchmarks import scores, scores_time
from benchmarks.register import scenes
from exmesh_graph.errors import ExmeshError

FIGURE = {"PSNR": SimpleNamespace(value=30.0, unit="dB", floor=20.0)}


class FakeRun:
    metrics, folder = FIGURE, Path("runs/one")
    record: ClassVar[dict] = {
        "nodes": [{"seconds": 200.0, "state": "done"}, {"seconds": 100.0, "state": "hit"}],
        "resolved": {"nodes": {"views": {"seed": 7}}},
    }


@pytest.fixture
def data(tmp_path):
    for name in ("padlock", "still", "chair"):
        (tmp_path / "data" / name).mkdir(parents=True)
        (tmp_path / "data" / name / "transforms_train.json").write_text("{}")
    return tmp_path / "data"


@pytest.mark.thorough
def test_scores_only_the_role_and_goes_on_after_a_failure(data, tmp_path, monkeypatch):
    asked = {}

    def run(graph, *, scene, **_):
        asked[Path(scene).name] = Path(graph)
        if Path(scene).name == "still":
            raise ExmeshError("no depth was found", where="coarse", fix="more texture")
        return FakeRun()

    (data / "still" / "masks").mkdir()
    monkeypatch.setattr(ex, "run", run)
    said: list[str] = []
    rows = scores.score_scenes("score", tmp_path / "out", data=[data], say=said.append)
    assert set(asked) == {"padlock", "still"}
    assert asked["padlock"] == scores.QUICKSTART
    written = asked["still"].read_text()
    assert "init.auto" not in written  # the quickstart has it, and no hull
    assert "hull" not in written
    assert f"masks: {data}/still/masks" in written
    scores.score_scenes("score", tmp_path / "ours", data=[data], graph=scores.ROOT / "graphs" / "hull.yaml")
    assert "hull: null\n  coarse: {type: init.auto" in asked["still"].read_text()
    assert [row["scene"] for row in rows] == ["padlock", "still"]
    table = (tmp_path / "out" / "table.md").read_text()
    assert "30 (20)" in table
    assert "failed" in table
    assert scores_time.processor() in table
    assert "seed 7" in table
    assert "Not there, not scored: plant" in table
    assert "plant" in said[0]
    assert "scenes make plant" in said[0]
    assert "--worlds" in said[0]


def test_says_how_long_before_anything_runs(data, tmp_path, monkeypatch):
    monkeypatch.setattr(ex, "run", lambda *_, **__: pytest.fail("nothing was to run"))
    monkeypatch.setattr(scores_time, "reference", lambda: 2 * scores_time.REFERENCE)
    said: list[str] = []
    assert scores.score_scenes("score", tmp_path / "out", data=[data], dry=True, say=said.append) == []
    assert "2 scenes" in " ".join(said)
    assert "measured now (0.50 of the model's machine)" in said[-1]


def test_what_scenes_took_before_is_what_is_expected(tmp_path, monkeypatch):
    """In this order: the scene itself, others of the same graph, others of any graph, the machine's speed."""
    work = scores_time.work_of(scores.QUICKSTART, {"views.downscale": 2}, scores.SAMPLE)
    assert work == scores_time.Work(3000, 1100, 2)
    models = {name: scores_time.modelled(scenes()[name], work) for name in ("padlock", "phone", "still")}
    assert models["padlock"] == models["phone"] < models["still"]
    monkeypatch.setattr(scores_time, "reference", lambda: 3 * scores_time.REFERENCE)
    memory = scores_time.Memory(tmp_path / "seconds.json")
    expected = {name: memory.expected("short", scenes()[name], models[name]) for name in models}
    assert expected == {name: pytest.approx(3 * models[name]) for name in models}
    memory.keep("other", "padlock", 0.5 * models["padlock"], models["padlock"])
    memory = scores_time.Memory(tmp_path / "seconds.json")
    assert memory.expected("short", scenes()["phone"], models["phone"]) == pytest.approx(
        0.5 * models["phone"], rel=0.01
    )
    assert "scenes of other graphs or settings (1)" in memory.basis("short")
    memory.keep("short", "phone", 250.0, models["phone"])
    assert memory.expected("short", scenes()["phone"], models["phone"]) == 250.0
    assert memory.expected("short", scenes()["padlock"], models["padlock"]) == pytest.approx(250.0, rel=0.01)
    assert "seconds of phone" in memory.basis("short")
    monkeypatch.setattr(scores_time, "processor", lambda: "another processor")
    elsewhere = scores_time.Memory(tmp_path / "seconds.json")
    assert elsewhere.expected("short", scenes()["phone"], models["phone"]) == pytest.approx(3 * models["phone"])


def test_the_reference_is_a_piece_of_work_of_which_a_slow_one_does_not_count(monkeypatch):
    monkeypatch.setattr(scores_time, "REPEATS", 3)
    assert 1e-4 < scores_time.reference() < 60
    clock = iter([0.0, 1.0, 1.0, 3.0, 3.0, 90.0])
    monkeypatch.setattr(scores_time, "time", SimpleNamespace(perf_counter=clock.__next__))
    assert scores_time.reference() == 2


def test_a_scene_of_another_role_is_refused(data, tmp_path):
    with pytest.raises(ValueError, match="chair"):
        scores.score_scenes("score", tmp_path / "out", data=[data], names=["chair"])
    with pytest.raises(ValueError, match=r"no scene of the role 'score' is in .*made by .*make plant padlock"):
        scores.score_scenes("score", tmp_path / "out", data=[tmp_path / "nothing"])


def test_the_graph_for_scenes_without_masks_is_sound(tmp_path):
    file = tmp_path / "no_masks.yaml"
    file.write_text(
        scores.NO_MASKS.format(graph=scores.QUICKSTART, name="quickstart", masks=tmp_path, start="", mesh="")
    )
    checked = ex.check(file, scene=str(scores.ROOT / "graphs" / "samples" / "chair"))
    assert checked.name == "quickstart_no_masks"
    assert checked.nodes["region"].params.masks == tmp_path
    for node in ("look", "score", "rounds[1].progress"):
        assert str(checked.nodes[node].inputs["region"]) == "@region.region"
