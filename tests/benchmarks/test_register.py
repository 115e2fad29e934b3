"""The register of scenes: one role each, and no sweep of settings on a scene that is kept for scoring."""

import json
import sys
from pathlib import Path

import pytest

from benchmarks import error_budget, register, stage1, stage2, stage2_mitsuba
from benchmarks.register import WrongRoleError, choosing, find, of_role, role_of, scenes


def test_every_scene_has_one_role_and_both_roles_have_four_kinds():
    known = scenes()
    names = [scene.name for role in ("choose", "score") for scene in of_role(role)]
    assert len(names) == len(set(names))
    assert set(names) == {scene.name for scene in known.values()}
    for role in ("choose", "score"):
        rendered = [scene for scene in of_role(role) if scene.pixels == (512, 512)]
        assert len({scene.kind for scene in rendered}) >= 4, role


def test_a_scoring_scene_is_refused_by_name_and_by_folder(tmp_path):
    folder = tmp_path / "renamed"
    folder.mkdir()
    (folder / "made.json").write_text(json.dumps({"scene": "padlock"}))
    for scene in ("padlock", folder):
        with pytest.raises(WrongRoleError, match=r"kept for scoring.*spot"):
            choosing(scene)
    assert choosing("spot_sample").name == "spot"
    assert choosing(Path("graphs/samples/spot")).name == "spot"
    assert choosing(tmp_path) is None
    assert role_of("padlock") == "score"
    assert role_of(tmp_path) == "unknown"


@pytest.mark.parametrize(
    ("benchmark", "options"),
    [
        (stage1, []),
        (stage2, ["--set", "material_rate=0.1"]),
        (stage2, ["--choosing"]),
        (stage2_mitsuba, ["--set", "corrections=0"]),
        (stage2_mitsuba, ["--rates", "0.1", "0.2"]),
    ],
)
def test_benchmarks_sweep_nothing_on_a_scoring_scene(benchmark, options, tmp_path, monkeypatch):
    (tmp_path / "made.json").write_text(json.dumps({"scene": "grotto"}))
    monkeypatch.setattr(sys, "argv", [benchmark.__name__, str(tmp_path), *options])
    with pytest.raises(WrongRoleError, match="grotto"):
        benchmark.main()


def test_an_entry_of_two_roles_or_a_misspelt_one_is_named(tmp_path):
    entry = "- {name: a, role: %s, kind: k, made: m, licence: CC0, pixels: [8, 8], views: [1, 1]}\n"
    file = tmp_path / "scenes.yaml"
    file.write_text("scenes:\n" + entry % "choose" + entry % "score")
    with pytest.raises(ValueError, match="'a' is entered twice"):
        scenes(file)
    other = tmp_path / "other.yaml"
    other.write_text("scenes:\n" + entry % "both")
    with pytest.raises(ValueError, match=r"entry 1(.|\n)*role"):
        scenes(other)


def test_the_command_tells_a_scene(capsys):
    assert register.main(["chair"]) == 0
    assert "choose" in capsys.readouterr().out
    assert register.main(["nowhere"]) == 1
    assert find("nowhere") is None


def test_an_error_budget_of_a_scoring_scene_changes_no_setting(tmp_path, monkeypatch, capsys):
    folder = tmp_path / "padlock"
    folder.mkdir()
    monkeypatch.setattr(sys, "argv", ["error_budget", str(folder)])
    with pytest.raises(WrongRoleError, match="kept for scoring"):
        error_budget.main()
    assert error_budget.arguments([str(folder), "--scoring", "--downscale", "2"]).scoring
    with pytest.raises(SystemExit):
        error_budget.arguments([str(folder), "--scoring", "--set", "pbr.metal_weight=0.2"])
    assert "leave out --set" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        error_budget.arguments([str(folder), "--set", "probe.thorough=false"])
    assert "not probe.thorough" in capsys.readouterr().err
