"""Choices of a graph parameter that set other parameters."""

from __future__ import annotations

from typing import Any

import pytest

from exmesh_graph.graph.variants.checked import check_variant

GRAPH = """
params:
  budget:
    type: str
    default: none
    choices:
      none: {}
      small: {value: 1, rounds: 2}
      large: {value: 7, label: "is ${name}"}
  value: {type: float, default: 4, ge: 0, le: 9}
  rounds: {type: int, default: 3, ge: 0}
  name: {type: str, default: big}
  label: {type: str, default: plain}
nodes:
  x: {type: toy.const, value: "${value}", label: "${label}"}
  block:
    repeat: "${rounds}"
    nodes: {y: {type: toy.const, value: "${value}"}}
"""
SHORT = "params: {pick: {default: a, choices: CHOICES}, size: {type: int, default: 3}}\nnodes: {x: {type: toy.const}}"


def only(problems: list[Any]) -> Any:
    assert len(problems) == 1, "\n".join(map(str, problems))
    return problems[0]


def test_a_choice_sets_the_defaults_of_others(bench: Any) -> None:
    graph = bench.check(GRAPH)
    assert graph.params == {"budget": "none", "value": 4, "rounds": 3, "name": "big", "label": "plain"}
    assert len(graph.nodes) == 4
    graph = bench.check(GRAPH, "budget=small")
    assert graph.params == {"budget": "small", "value": 1, "rounds": 2, "name": "big", "label": "plain"}
    assert len(graph.nodes) == 3
    assert graph.nodes["x"].params.value == 1


def test_what_is_set_by_itself_counts_more(bench: Any) -> None:
    for sets in (["budget=small", "value=5"], ["value=5", "budget=small"]):
        assert bench.check(GRAPH, *sets).params["value"] == 5
    assert bench.check(GRAPH, "budget=small", "value=5").params["rounds"] == 2


def test_a_setting_may_refer_to_parameters(bench: Any) -> None:
    assert bench.check(GRAPH, "budget=large").params["label"] == "is big"
    assert bench.check(GRAPH, "budget=large", "name=small").params["label"] == "is small"


def test_a_choice_may_choose(bench: Any) -> None:
    haste = "params:\n  haste: {type: str, default: none, choices: {none: {}, much: {budget: small}}}\n"
    more = GRAPH.replace("params:\n", haste, 1)
    assert bench.check(more).params["rounds"] == 3
    assert bench.check(more, "haste=much").params["rounds"] == 2
    assert bench.check(more, "haste=much", "budget=large").params["value"] == 7


def test_equal_nodes_have_equal_parameters_whoever_sets_them(bench: Any) -> None:
    chosen, by_hand = bench.check(GRAPH, "budget=small"), bench.check(GRAPH, "value=1", "rounds=2")
    assert chosen.resolved()["nodes"] == by_hand.resolved()["nodes"]


def test_a_choice_gives_what_must_be_given(bench: Any) -> None:
    text = "params: {pick: {default: a, choices: {a: {v: 3}, b: {}}}, v: {type: float}}\n"
    text += "nodes: {x: {type: toy.const, value: '${v}'}}"
    assert bench.check(text).params["v"] == 3
    assert "v must be given" in bench.problems(text, "pick=b")[0].what
    assert bench.check(text, "pick=b", "v=4").params["v"] == 4


@pytest.mark.parametrize(
    ("choices", "words"),
    [
        ("{a: {siez: 4}}", [":1: [param]", "the choice a of pick sets 'siez'", "nearest: size", "declare siez under"]),
        ("{a: {}, b: {size: many}}", ["size cannot be 'many'", "expected: int"]),
        ("{a: 3}", ["the choice a is no mapping of parameters", "{small: {faces: 500}, ...}"]),
        ("{}", ["a list of values, or maps them to what they set"]),
        ("{b: {size: 4}}", ["pick cannot be 'a'", "one of b"]),
        ("{a: {size: '${pcik}'}}", ["${pcik} is not a parameter here", "nearest: pick"]),
    ],
)
def test_wrong_choices(bench: Any, choices: str, words: list[str]) -> None:
    told = str(bench.problems(SHORT.replace("CHOICES", choices))[0])
    for word in words:
        assert word in told


def test_an_unknown_value_names_the_nearest(bench: Any) -> None:
    problem = only(bench.problems(GRAPH, "budget=smal"))
    assert "one of none, small, large" in problem.expected
    assert problem.nearest == ("small",)


@pytest.mark.parametrize(
    ("params", "cycle"),
    [
        ("{a: {default: x, choices: {x: {a: y}, y: {}}}}", "a -> a"),
        ("{a: {default: x, choices: {x: {b: y}}}, b: {default: y, choices: {y: {a: x}}}}", "a -> b -> a"),
        ("{a: {default: x, choices: {x: {}, y: {b: '${c}'}}}, b: 1, c: '${b}'}", "b -> c -> b"),
    ],
)
def test_cycles(bench: Any, params: str, cycle: str) -> None:
    problem = only(bench.problems(f"params: {params}\nnodes: {{x: {{type: toy.const}}}}"))
    ends = cycle.split(" -> ")[:-1]
    assert any(" -> ".join([*ends[i:], *ends[:i], ends[i]]) in problem.what for i in range(len(ends)))
    assert ":1: [param]" in str(problem)
    assert problem.fix


def test_two_choices_that_set_one_parameter(bench: Any) -> None:
    text = "params:\n  a: {default: x, choices: {x: {v: 1}}}\n  b: {default: y, choices: {y: {v: 2}, z: {}}}\n  v: 3\n"
    text += "nodes: {n: {type: toy.const, value: '${v}'}}"
    problem = only(bench.problems(text))
    assert "v is set twice, by a: x and b: y" in problem.what
    assert ":3: [param]" in str(problem)
    assert bench.check(text, "b=z").params["v"] == 1
    assert bench.check(text, "v=9").params["v"] == 9


def test_a_child_changes_adds_and_removes_choices(bench: Any) -> None:
    bench.write(GRAPH, "base.yaml")
    child = "extends: base.yaml\nparams: {budget: {choices: {small: {value: 2}, tiny: {rounds: 0}, large: null}}}"
    assert bench.check(child).params["budget"] == "none"
    assert bench.check(child, "budget=small").params["value"] == 2
    assert bench.check(child, "budget=small").params["rounds"] == 2
    assert bench.check(child, "budget=tiny").params["rounds"] == 0
    assert "one of none, small, tiny" in only(bench.problems(child, "budget=large")).expected
    chosen = "extends: base.yaml\nparams: {budget: small}"
    assert bench.check(chosen).params["rounds"] == 2
    other = "extends: base.yaml\nparams: {budget: {default: small, choices: {small: {rounds: 1}}}}"
    assert bench.check(other).params["rounds"] == 1


def test_what_a_child_says_of_a_parameter_counts_with_every_choice(bench: Any) -> None:
    bench.write(GRAPH, "base.yaml")
    for order in ("{value: 6, budget: small}", "{budget: small, value: 6}"):
        child = f"extends: base.yaml\nparams: {order}"
        assert bench.check(child).params["value"] == 6
        assert bench.check(child, "budget=large").params["value"] == 6
        assert bench.check(child).params["rounds"] == 2
    for order in (
        "{value: 6, budget: {choices: {small: {value: 5}}}}",
        "{budget: {choices: {small: {value: 5}}}, value: 6}",
    ):
        child = f"extends: base.yaml\nparams: {order}"
        assert [bench.check(child, f"budget={b}").params["value"] for b in ("none", "small", "large")] == [6, 5, 6]


def test_variants_and_sub_graphs_choose(bench: Any) -> None:
    variants = "variants: {quick: [{set: budget, to: small}], both: [{set: {value: 8, budget: small}}]}\n"
    path = bench.write(GRAPH + variants)
    assert check_variant(path, [], bench.packs, "quick").params["value"] == 1
    assert check_variant(path, [], bench.packs, "both").params["value"] == 8
    assert check_variant(path, ["value=3"], bench.packs, "quick").params["value"] == 3
    bench.write("inputs: {}\n" + GRAPH + "outputs: {y: '@x.number'}", "part.yaml")
    user = "nodes: {p: {graph: part.yaml, budget: small}, q: {graph: part.yaml, budget: small, value: 5}}"
    graph = bench.check(user)
    assert [graph.nodes[f"{name}.x"].params.value for name in "pq"] == [1, 5]
    assert [name for name in graph.nodes if "block" in name] == [f"{p}.block[{r}].y" for p in "pq" for r in (1, 2)]


def test_a_parameter_may_choose_the_type_of_a_node(bench: Any) -> None:
    text = """
params: {kind: {type: str, default: toy.sign, choices: [toy.sign, toy.seeded]}}
nodes:
  a: {type: toy.const}
  b: {type: "${kind}", number: "@a.number"}
outputs: {b: "@b.number"}
"""
    assert bench.check(text).nodes["b"].definition.type == "toy.sign"
    assert bench.check(text, "kind=toy.seeded").nodes["b"].definition.type == "toy.seeded"
    told = [str(problem) for problem in bench.problems(text, "kind=toy.add")]
    assert any("cannot be 'toy.add'" in one for one in told)
