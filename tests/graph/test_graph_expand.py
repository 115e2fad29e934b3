"""Parameters, extends and repeat blocks."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exmesh_graph.graph.language.expand import Unrolled, expand
from exmesh_graph.graph.language.links import Link
from exmesh_graph.graph.language.spec import load_tree
from exmesh_graph.graph.language.yamlfile import Limits
from exmesh_graph.graph.problems import GraphErrors, Problems

LOOP = """
name: loop
params: {n: 3, by: 0.5, here: data/x.txt}
nodes:
  one: {type: toy.const, value: 1}
  rounds:
    repeat: "${n}"
    carry: {state: "@one.number"}
    nodes:
      step: {type: toy.step, state: "@carry.state", amount: "${by}"}
      leap: {type: toy.step, state: "@step.state", amount: "${round}", every: {2: {type: toy.leap, factor: 3}},
             at: {1: {amount: 70}, 3: {amount: "${rounds}"}}}
    next: {state: "@leap.state"}
  last: {type: toy.metrics, number: "@rounds.state"}
"""


def expanded(path: Path, *sets: str) -> Unrolled:
    problems = Problems()
    graph = expand(load_tree(path, sets, problems), problems)
    problems.raise_if_any()
    return graph


@pytest.fixture
def loop(tmp_path: Path) -> Path:
    path = tmp_path / "loop.yaml"
    path.write_text(LOOP)
    return path


def test_repeat_unrolls(loop: Path) -> None:
    graph = expanded(loop)
    assert list(graph.nodes) == [
        "one", "rounds[1].step", "rounds[1].leap", "rounds[2].step", "rounds[2].leap",
        "rounds[3].step", "rounds[3].leap", "last",
    ]  # fmt: skip
    wires = {name: spec.fields["state"].value for name, spec in graph.nodes.items() if "state" in spec.fields}
    assert wires["rounds[1].step"] == Link("one", "number")
    assert wires["rounds[2].step"] == Link("rounds[1].leap", "state")
    assert wires["rounds[3].leap"] == Link("rounds[3].step", "state")
    assert graph.nodes["last"].fields["number"].value == Link("rounds[3].leap", "state")


def test_round_overrides(loop: Path) -> None:
    graph = expanded(loop)
    first, second, third = (graph.nodes[f"rounds[{i}].leap"] for i in (1, 2, 3))
    assert (first.type, second.type, third.type) == ("toy.step", "toy.leap", "toy.step")
    assert first.fields["amount"].value == 70
    assert third.fields["amount"].value == 3
    assert second.fields["factor"].value == 3
    assert second.fields["amount"].inherited
    assert not second.fields["factor"].inherited
    assert graph.nodes["rounds[2].step"].fields["amount"].value == 0.5


def test_at_beats_every(tmp_path: Path) -> None:
    text = LOOP.replace("at: {1: {amount: 70}", "at: {2: {type: toy.step, amount: 9}, 1: {amount: 70}")
    path = tmp_path / "g.yaml"
    path.write_text(text)
    second = expanded(path).nodes["rounds[2].leap"]
    assert (second.type, second.fields["amount"].value) == ("toy.step", 9)


def test_no_rounds_passes_the_first_value_through(loop: Path) -> None:
    graph = expanded(loop, "n=0")
    assert list(graph.nodes) == ["one", "last"]
    assert graph.nodes["last"].fields["number"].value == Link("one", "number")


@settings(max_examples=15, deadline=None)
@given(outer=st.integers(1, 4), inner=st.integers(0, 4))
def test_nested_repeats(tmp_path_factory: pytest.TempPathFactory, outer: int, inner: int) -> None:
    path = tmp_path_factory.mktemp("nested") / "g.yaml"
    path.write_text(
        f"""
nodes:
  one: {{type: toy.const}}
  out:
    repeat: {outer}
    carry: {{s: "@one.number"}}
    nodes:
      in:
        repeat: {inner}
        carry: {{s: "@carry.s"}}
        nodes: {{step: {{type: toy.step, state: "@carry.s"}}}}
        next: {{s: "@step.state"}}
      tail: {{type: toy.step, state: "@in.s"}}
    next: {{s: "@tail.state"}}
"""
    )
    graph = expanded(path)
    assert len(graph.nodes) == 1 + outer * (inner + 1)
    chain = ["one"]
    for o in range(1, outer + 1):
        chain += [f"out[{o}].in[{i}].step" for i in range(1, inner + 1)] + [f"out[{o}].tail"]
    for before, after in itertools.pairwise(chain):
        assert graph.nodes[after].fields["state"].value.node == before


def test_carry_that_is_passed_on_unchanged(tmp_path: Path) -> None:
    path = tmp_path / "g.yaml"
    path.write_text(LOOP.replace('next: {state: "@leap.state"}', 'next: {state: "@carry.state"}'))
    graph = expanded(path, f"n={Limits().rounds}")
    assert graph.nodes["last"].fields["number"].value == Link("one", "number")


@pytest.mark.parametrize("count", ["-1", "2.5", "many", "true", str(Limits().rounds + 1)])
def test_bad_counts(loop: Path, count: str) -> None:
    with pytest.raises(GraphErrors, match=r"repeat is|n cannot be"):
        expanded(loop, f"n={count}")


def test_bounded_expansion(tmp_path: Path) -> None:
    path = tmp_path / "g.yaml"
    body = '{type: toy.step, state: "@carry.s"}'
    path.write_text(
        "nodes:\n  one: {type: toy.const}\n  a:\n    repeat: 1000\n    carry: {s: '@one.number'}\n    nodes:\n"
        f"      b: {{repeat: 1000, carry: {{s: '@carry.s'}}, nodes: {{x: {body}}}, next: {{s: '@x.state'}}}}\n"
        "    next: {s: '@b.s'}\n"
    )
    with pytest.raises(GraphErrors, match="unrolls to more than"):
        expanded(path)


def test_seeds_differ_between_rounds_only(loop: Path) -> None:
    seeds = {name: spec.seed for name, spec in expanded(loop, "seed=5").nodes.items()}
    assert seeds["one"] == seeds["last"] == 5
    assert seeds["rounds[1].step"] == seeds["rounds[1].leap"]
    assert len({seeds[f"rounds[{i}].step"] for i in (1, 2, 3)} | {5}) == 4
    assert expanded(loop, "seed=6").nodes["rounds[1].step"].seed != seeds["rounds[1].step"]
    assert expanded(loop, "seed=5", "n=9").nodes["rounds[2].step"].seed == seeds["rounds[2].step"]


def test_substitution_keeps_types(tmp_path: Path) -> None:
    path = tmp_path / "g.yaml"
    path.write_text(
        'params: {f: 1e-3, l: [1, "${f}"], s: "a-${f}", t: true}\n'
        'nodes: {x: {type: toy.const, a: "${f}", b: "${l}", c: "${s}/${t}", d: "$${f}", e: "@@x"}}\n'
    )
    fields = expanded(path).nodes["x"].fields
    assert fields["a"].value == 0.001
    assert fields["b"].value == [1, 0.001]
    assert fields["c"].value == "a-0.001/true"
    assert fields["d"].value == "${f}"
    assert fields["e"].value == "@x"


def test_set_overrides(loop: Path) -> None:
    graph = expanded(
        loop, "by=1e-2", "one.value=1e-3", "rounds.leap.amount=8", "rounds[3].step.amount=4", "rounds.repeat=4"
    )
    assert graph.nodes["one"].fields["value"].value == 0.001
    assert graph.nodes["rounds[1].step"].fields["amount"].value == 0.01
    assert [graph.nodes[f"rounds[{i}].leap"].fields["amount"].value for i in (1, 2, 3, 4)] == [8] * 4
    assert graph.nodes["rounds[3].step"].fields["amount"].value == 4
    assert graph.nodes["rounds[4].step"].where.line > 0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("m=3", "no parameter 'm'"),
        ("on.value=3", "one.value"),
        ("rounds.stepp.amount=1", "rounds.step.amount"),
        ("value", "cannot read --set"),
        ("rounds[9].step.amount=1", "no node 'rounds[9].step'"),
    ],
)
def test_wrong_set(loop: Path, text: str, words: str) -> None:
    with pytest.raises(GraphErrors) as caught:
        expanded(loop, text)
    assert words in str(caught.value)


def test_extends_patches_and_replaces(loop: Path, tmp_path: Path) -> None:
    child = tmp_path / "sub" / "child.yaml"
    child.parent.mkdir()
    child.write_text(
        """
extends: ../loop.yaml
params: {n: 2}
nodes:
  one: {value: 7}
  rounds: {nodes: {step: {amount: 5}, leap: {at: {1: {amount: 6}}}}}
  last: {type: toy.add, a: "@rounds.state"}
  extra: {type: toy.metrics, number: "@last.number"}
"""
    )
    graph = expanded(child)
    assert graph.name == "child"
    assert graph.nodes["one"].type == "toy.const"
    assert graph.nodes["one"].fields["value"].value == 7
    assert graph.nodes["rounds[2].step"].fields["amount"].value == 5
    assert graph.nodes["rounds[1].leap"].fields["amount"].value == 6
    assert "number" not in graph.nodes["last"].fields
    assert list(graph.nodes)[-2:] == ["last", "extra"]
    child.write_text("extends: ../loop.yaml\nnodes: {last: null}\n")
    assert "last" not in expanded(child).nodes


def test_null_removes_inherited_rounds(loop: Path, tmp_path: Path) -> None:
    child = tmp_path / "child.yaml"

    def leaps(entry: str) -> list[tuple[str, object]]:
        child.write_text(f"extends: loop.yaml\nnodes: {{rounds: {{nodes: {{leap: {entry}}}}}}}\n")
        nodes = expanded(child).nodes
        leap = [nodes[f"rounds[{number}].leap"] for number in (1, 2, 3)]
        return [(node.type, node.fields["amount"].value) for node in leap]

    assert leaps("{}") == [("toy.step", 70), ("toy.leap", 2), ("toy.step", 3)]
    assert leaps("{at: null}") == [("toy.step", 1), ("toy.leap", 2), ("toy.step", 3)]
    assert leaps("{at: {1: null, 3: {amount: 9}}}") == [("toy.step", 1), ("toy.leap", 2), ("toy.step", 9)]
    assert leaps("{every: null}") == [("toy.step", 70), ("toy.step", 2), ("toy.step", 3)]
    with pytest.raises(GraphErrors, match="cannot remove 2: the base has no such entry"):
        leaps("{at: {2: null}}")
    child.write_text("extends: loop.yaml\nnodes: {rounds: {nodes: {step: {at: null}}}}\n")
    with pytest.raises(GraphErrors, match="cannot remove 'at'"):
        expanded(child)


def test_extends_faults_are_all_reported(loop: Path, tmp_path: Path) -> None:
    child = tmp_path / "child.yaml"
    child.write_text("extends: loop.yaml\nnodes: {on: {value: 7}, gone: null, rounds: {nodes: {stp: {amount: 1}}}}\n")
    with pytest.raises(GraphErrors) as caught:
        expanded(child)
    text = str(caught.value)
    assert "'on' has no type" in text
    assert "nearest: one" in text
    assert "cannot remove 'gone'" in text
    assert "nearest: step" in text


def test_extends_cycle(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("extends: b.yaml\n")
    (tmp_path / "b.yaml").write_text("extends: a.yaml\n")
    with pytest.raises(GraphErrors, match="extend each other"):
        expanded(tmp_path / "a.yaml")


def test_parameter_cycle(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text('params: {a: "${b}", b: "${a}"}\nnodes: {x: {type: toy.const}}\n')
    with pytest.raises(GraphErrors, match="refer to each other"):
        expanded(tmp_path / "a.yaml")


def test_paths_start_where_they_were_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    base = tmp_path / "base" / "base.yaml"
    base.parent.mkdir()
    base.write_text(
        'params: {where: d, file: f.txt}\nnodes:\n  a: {type: toy.file, path: "${where}/x.txt"}\n'
        '  b: {type: toy.file, path: y.txt}\n  c: {type: toy.file, path: "sub/${file}"}\n'
    )
    child = tmp_path / "child" / "child.yaml"
    child.parent.mkdir()
    child.write_text("extends: ../base/base.yaml\nparams: {where: e}\n")
    fields = {name: spec.fields["path"] for name, spec in expanded(child).nodes.items()}
    assert fields["a"].base == child.parent
    assert fields["b"].base == base.parent
    assert fields["c"].base == base.parent
    monkeypatch.chdir(tmp_path)
    fields = {name: spec.fields["path"] for name, spec in expanded(child, "where=z", "b.path=q").nodes.items()}
    assert fields["a"].base == fields["b"].base == tmp_path
