"""What a file declares as variants, matrix and repeats, row by row."""

from __future__ import annotations

from typing import Any

import pytest

from exmesh_graph.graph.problems import GraphErrors
from exmesh_graph.graph.variants.checked import CheckedVariant, check_variant, check_variants
from exmesh_graph.graph.variants.declared import MAX_VARIANTS


def rows(bench: Any, text: str, *sets: str, only: list[str] | None = None) -> list[CheckedVariant]:
    return check_variants(bench.write(text), sets, bench.packs, only)


def refused(bench: Any, text: str, **options: Any) -> Any:
    with pytest.raises(GraphErrors) as caught:
        rows(bench, text, **options)
    return caught.value.problems


def test_a_plain_graph_has_its_base_only(bench: Any, base: str) -> None:
    (row,) = rows(bench, base)
    assert (row.name, row.checked.variant, row.checked.name) == ("base", "", "toy")


def test_variants_extend_each_other_in_order(bench: Any, base: str) -> None:
    text = (
        base
        + """
variants:
  both: {extends: [three, off], doc: Two changes., patches: [{set: b.value, to: 9}]}
  three: [{set: a.value, to: 3}, {set: b.value, to: 8}]
  off: [{bypass: rounds.hop}]
"""
    )
    listed = {row.name: row for row in rows(bench, text)}
    assert list(listed) == ["base", "both", "three", "off"]
    both = listed["both"].checked
    assert [both.nodes[name].params.model_dump()["value"] for name in "ab"] == [3, 9]
    assert "rounds[1].hop" not in both.nodes
    assert listed["both"].doc == "Two changes."
    assert listed["off"].settings == {"variant": "off"}
    assert listed["off"].checked.name == "toy-off"
    assert listed["off"].checked.resolved()["variant"] == "off"


def test_a_child_file_adds_changes_and_removes_variants(bench: Any, base: str) -> None:
    bench.write(base + "variants: {x: [{set: a.value, to: 3}], y: [{bypass: rounds.hop}]}", "base.yaml")
    listed = {
        row.name: row for row in rows(bench, "extends: base.yaml\nvariants: {x: [{set: a.value, to: 4}], y: null}")
    }
    assert list(listed) == ["base", "x"]
    assert listed["x"].checked.nodes["a"].params.model_dump()["value"] == 4


MATRIX = """
variants: {off: [{bypass: rounds.hop}], alone: [{set: a.value, to: 3}]}
matrix:
  variant: [base, "off"]
  n: [1, 3]
  start: {sum: [], left: [{disconnect: start.b}]}
  exclude: [{variant: "off", start: left}]
  include: [{variant: "off", n: 4, start: left}]
"""


def test_a_matrix_combines_variants_parameters_and_patch_lists(bench: Any, base: str) -> None:
    listed = {row.name: row for row in rows(bench, base + MATRIX)}
    assert list(listed) == [
        "base", "alone", "n=1,start=sum", "n=1,start=left", "n=3,start=sum", "n=3,start=left",
        "off,n=1,start=sum", "off,n=3,start=sum", "off,n=4,start=left",
    ]  # fmt: skip
    row = listed["off,n=4,start=left"]
    assert row.settings == {"variant": "off", "n": 4, "start": "left"}
    assert "b" not in row.checked.nodes["start"].inputs
    assert "rounds[4].step" in row.checked.nodes
    assert "rounds[1].hop" not in row.checked.nodes


def test_an_include_may_name_what_no_axis_has(bench: Any, base: str) -> None:
    text = "variants: {off: []}\nmatrix: {n: [1], include: [{n: 2}, {variant: 'off', a.value: 4}, {five: 6, n: 1}]}"
    listed = {row.name: row.checked for row in rows(bench, base + text)}
    assert list(listed) == ["base", "n=1", "n=2", "off,a.value=4", "five=6,n=1"]
    assert listed["off,a.value=4"].nodes["a"].params.model_dump()["value"] == 4


def test_repeats_count_seeds_up(bench: Any, base: str) -> None:
    listed = rows(bench, base + "seed: 5\nrepeats: 3\nvariants: {x: [{set: a.value, to: 3}]}")
    assert [(row.name, row.repeat, row.seed) for row in listed] == [
        (name, number, 4 + number) for name in ("base", "x") for number in (1, 2, 3)
    ]
    assert [row.checked.nodes["a"].seed for row in listed[:3]] == [5, 6, 7]
    assert [row.seed for row in rows(bench, base + "repeats: 2", "seed=9")] == [9, 10]


def test_repeats_of_single_nodes_leave_the_others_alone(bench: Any, base: str) -> None:
    listed = rows(bench, base + "repeats: {count: 2, of: [end, rounds.hop]}")
    assert [row.checked.nodes["a"].seed for row in listed] == [0, 0]
    assert [row.checked.nodes["end"].seed for row in listed] == [0, 1]
    assert listed[0].checked.nodes["rounds[1].hop"].seed != listed[1].checked.nodes["rounds[1].hop"].seed
    assert listed[0].checked.nodes["rounds[1].step"].seed == listed[1].checked.nodes["rounds[1].step"].seed


def test_a_variant_without_the_node_of_the_repeats_is_the_same_in_all(bench: Any, base: str) -> None:
    listed = rows(bench, base + "repeats: {count: 2, of: [rounds.hop]}\nvariants: {off: [{bypass: rounds.hop}]}")
    assert [row.name for row in listed] == ["base", "base", "off", "off"]
    assert listed[2].checked.resolved() == listed[3].checked.resolved()


def test_only_keeps_the_base_and_what_is_named(bench: Any, base: str) -> None:
    assert [row.name for row in rows(bench, base + MATRIX, only=["alone"])] == ["base", "alone"]
    (problem,) = refused(bench, base + MATRIX, only=["alon"])
    assert problem.nearest[0] == "alone"


def test_one_variant_by_name(bench: Any, base: str) -> None:
    path = bench.write(base + MATRIX)
    graph = check_variant(path, ["a.value=7"], bench.packs, "off,n=1,start=sum")
    assert graph.nodes["a"].params.model_dump()["value"] == 7
    with pytest.raises(GraphErrors, match="no variant 'of'"):
        check_variant(path, [], bench.packs, "of")


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("variants: [x]", "variants: must be a mapping"),
        ("variants: {base: []}", "cannot name a variant: it is the unchanged graph"),
        ("variants: {'a/b': []}", "cannot name a variant"),
        ("variants: {x: {bypass: rounds.hop}}", "a variant has no key 'bypass'"),
        ("variants: {x: bypass}", "must be a list of patches"),
        ("variants: {x: {extends: y}}", "there is no variant 'y'"),
        ("variants: {x: {extends: y}, y: {extends: x}}", "extend each other: x -> y -> x"),
        ("matrix: [1]", "matrix: must be a mapping"),
        ("matrix: {n: []}", "the axis n has no values"),
        ("matrix: {n: [[1]]}", "the axis n holds"),
        ("matrix: {variant: [nothing]}", "there is no variant 'nothing'"),
        ("matrix: {nn: [1]}", "the graph has no parameter 'nn'"),
        ("matrix: {n: [1], exclude: [{n: 2}]}", "the axis n has no 2"),
        ("matrix: {n: [1], exclude: [{m: 2}]}", "the matrix has no axis 'm'"),
        ("matrix: {n: [1, 2], five: [3], exclude: [{n: 1}, {n: 1}]}", "exclude matches no combination"),
        ("matrix: {n: [1], include: [{m: 2}]}", "the graph has no parameter 'm'"),
        ("matrix: {x: {plain: []}, include: [{x: other}]}", "the axis x has no 'other'"),
        ("matrix: {n: [1], include: 3}", "include: is a list of mappings"),
        ("repeats: 0", "repeats is 0"),
        ("repeats: true", "repeats is True"),
        ("repeats: {count: 2, off: a}", "repeats cannot be read"),
        ("repeats: {count: 2, of: [c]}", "there is no node 'c'"),
    ],
)
def test_what_cannot_be_read_is_refused(bench: Any, base: str, text: str, what: str) -> None:
    (problem,) = refused(bench, base + text)
    assert what in problem.what
    assert problem.where.line >= 18


def test_variants_that_cannot_be_read_are_told_at_once_with_their_lines(bench: Any, base: str) -> None:
    text = base + "variants:\n  x: [{sett: 1}, 3]\n  y: {extends: x}\n  z: {extends: q}\n"
    listed = refused(bench, text)
    assert [problem.what.partition(" {")[0] for problem in listed] == [
        "no operation in", "a patch is a mapping, not 3", "there is no variant 'q'"
    ]  # fmt: skip
    first = text.splitlines().index("variants:") + 2
    assert [problem.where.line for problem in listed] == [first, first, first + 2]


def test_the_number_of_variants_is_bounded(bench: Any, base: str) -> None:
    many = ", ".join(str(number) for number in range(30))
    (problem,) = refused(bench, base + f"matrix: {{n: [{many}], five: [{many}], a.value: [{many}]}}")
    assert "more than 2000 combinations" in problem.what
    (problem,) = refused(bench, base + f"matrix: {{n: [{many}], five: [{many}]}}")
    assert f"901 variants are more than {MAX_VARIANTS}" in problem.what
    (problem,) = refused(bench, base + f"repeats: 7\nmatrix: {{n: [{many}]}}")
    assert "31 variants in 7 repeats" in problem.what


def test_variants_cannot_grow_without_bound(bench: Any, base: str) -> None:
    doubled = "\n".join(f"  v{n}: {{extends: [v{n - 1}, v{n - 1}]}}" for n in range(1, 30))
    (problem,) = refused(bench, base + "variants:\n  v0: [{set: a.value, to: 3}]\n" + doubled)
    assert "more than 2000 patches" in problem.what
    chain = "\n".join(f"  v{n}: {{extends: v{n + 1}}}" for n in range(2000))
    problem, *_ = refused(bench, base + "variants:\n  v2000: []\n" + chain)
    assert "more than 50 deep" in problem.what


def test_faults_of_all_variants_come_at_once_and_each_once(bench: Any, base: str) -> None:
    text = (
        base
        + """
variants:
  x: [{set: a.value, to: 5000}]
  y: [{bypass: rounds.hip}]
  z: {extends: x}
"""
    )
    listed = {problem.what.partition(": ")[0]: problem for problem in refused(bench, text)}
    assert list(listed) == ["variant x, z", "variant y"]
    (problem,) = refused(bench, text.replace("value: 2}", "value: 9999}"))[:1]
    assert problem.what.startswith("a: value")  # a fault of the base is told as such, once
