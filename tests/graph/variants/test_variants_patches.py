"""The eight patch operations: what each does to the unrolled graph, and when each is refused."""

from __future__ import annotations

from typing import Any

import pytest
from patched_graphs import Patched, Refusal, value, wires

# --- set


def test_set_changes_one_parameter(patched: Patched) -> None:
    plain, changed = patched(), patched("{set: a.value, to: 3}")
    assert value(changed, "a", "value") == 3
    assert value(changed, "b", "value") == value(plain, "b", "value") == 5
    assert wires(changed) == wires(plain)


def test_set_holds_in_every_round_whatever_a_round_had(patched: Patched) -> None:
    graph = patched("{set: rounds.step.amount, to: 7}", "{set: rounds.repeat, to: 3}")
    assert [value(graph, f"rounds[{r}].step", "amount") for r in (1, 3)] == [7, 7]
    assert graph.nodes["rounds[2].step"].definition.type == "toy.leap"


def test_set_of_one_round(patched: Patched) -> None:
    graph = patched("{set: 'rounds[2].hop.amount', to: 7}")
    assert [value(graph, f"rounds[{r}].hop", "amount") for r in (1, 2)] == [10, 7]


def test_set_reaches_a_parameter_that_only_one_rounds_type_has(patched: Patched) -> None:
    assert value(patched("{set: rounds.step.factor, to: 9}"), "rounds[2].step", "factor") == 9


def test_set_of_graph_parameters_seed_and_several_at_once(patched: Patched) -> None:
    graph = patched("{set: {five: 6, n: 1, seed: 4, a.value: 8}}")
    assert value(graph, "b", "value") == 6
    assert value(graph, "a", "value") == 8
    assert graph.nodes["a"].seed == 4
    assert "rounds[2].hop" not in graph.nodes


def test_the_command_line_wins_over_a_patch(patched: Patched) -> None:
    graph = patched("{set: a.value, to: 3}", "{set: five, to: 6}", sets=("a.value=4", "five=7"))
    assert (value(graph, "a", "value"), value(graph, "b", "value")) == (4, 7)


@pytest.mark.parametrize(
    ("patch", "what", "near"),
    [
        ("{set: a.valu, to: 3}", "toy.const has no parameter 'valu'", "a.value"),
        ("{set: aa.value, to: 3}", "there is no node 'aa'", "a"),
        ("{set: hop.amount, to: 3}", "there is no node 'hop'", "rounds.hop"),
        ("{set: fiv, to: 3}", "the graph has no parameter 'fiv'", "five"),
        ("{set: rounds.count, to: 3}", "the block rounds has no parameter 'count'", "rounds.repeat"),
    ],
)
def test_set_is_refused_with_the_nearest_names(refusal: Refusal, patch: str, what: str, near: str) -> None:
    problem = refusal(patch)
    assert what in problem.what
    assert near in problem.nearest
    assert problem.where.line == 20  # the line of the patch


def test_set_tells_ports_and_whole_nodes_apart(refusal: Refusal) -> None:
    assert 'connect: start.a, to: "@node.port"' in refusal("{set: start.a, to: 3}").fix
    assert "set: a.PARAMETER" in refusal("{set: a, to: 3}").fix
    assert "to:" in refusal("{set: a.value}").what
    assert "rounds has no round 7" in refusal("{set: 'rounds[7].hop.amount', to: 3}").what


def test_a_bad_value_is_told_at_the_line_of_the_patch(refusal: Refusal) -> None:
    problem = refusal("{set: a.value, to: 3}", "{set: a.value, to: 5000}")
    assert problem.code == "parameter"
    assert problem.where.line == 21
    assert problem.what.startswith("variant v: a: value")


# --- connect, disconnect


def test_connect_rewires_one_port_in_all_rounds_or_one(patched: Patched) -> None:
    assert wires(patched('{connect: start.b, to: "@a.number"}'))["start.b"] == "a.number"
    graph = patched('{connect: rounds.hop.state, to: "@carry.state"}')
    assert wires(graph)["rounds[1].hop.state"] == "start.number"
    assert wires(graph)["rounds[2].hop.state"] == "rounds[1].hop.state"
    graph = patched('{connect: "rounds[2].hop.state", to: "@carry.state"}')
    assert wires(graph)["rounds[1].hop.state"] == "rounds[1].step.state"
    assert wires(graph)["rounds[2].hop.state"] == "rounds[1].hop.state"


def test_connect_reaches_carried_values_and_outputs(patched: Patched) -> None:
    graph = patched(
        '{connect: rounds.next.state, to: "@step.state"}',
        '{connect: rounds.carry.state, to: "@a.number"}',
        '{connect: outputs.end, to: "@start.number"}',
        '{connect: outputs.more, to: "@a.number"}',
    )
    assert wires(graph)["end.a"] == "rounds[2].step.state"
    assert wires(graph)["rounds[1].step.state"] == "a.number"
    assert {name: str(link) for name, link in graph.outputs.items()} == {"end": "@start.number", "more": "@a.number"}


@pytest.mark.parametrize(
    ("patch", "what", "near"),
    [
        ('{connect: start.c, to: "@a.number"}', "toy.add has no input port 'c'", "start.a"),
        ('{connect: start.b, to: "@aa.number"}', "there is no node 'aa'", "@a.number"),
        ('{connect: start.b, to: "@a.numbr"}', "toy.const has no output 'numbr'", "@a.number"),
        ("{connect: start.b, to: 5}", "5 is not a link", None),
    ],
)
def test_connect_is_refused(refusal: Refusal, patch: str, what: str, near: str | None) -> None:
    problem = refusal(patch)
    assert what in problem.what
    assert near is None or near in problem.nearest


def test_connect_of_a_wrong_type_names_both_ends(refusal: Refusal) -> None:
    problem = refusal("{add: {name: m, type: toy.metrics, number: '@a.number'}}", '{connect: end.b, to: "@m.metrics"}')
    assert (problem.code, problem.where.line) == ("wrong-type", 21)
    assert "m.metrics" in problem.wire


def test_connect_of_a_parameter_points_to_set(refusal: Refusal) -> None:
    assert "set: a.value" in refusal('{connect: a.value, to: "@b.number"}').fix


def test_disconnect_takes_optional_inputs_and_outputs_away(patched: Patched) -> None:
    graph = patched("{disconnect: start.b}", "{disconnect: outputs.end}")
    assert "start.b" not in wires(graph)
    assert graph.outputs == {}


def test_disconnect_is_refused(refusal: Refusal) -> None:
    assert "must be connected" in refusal("{disconnect: start.a}").what
    assert "not connected" in refusal("{disconnect: start.b}", "{disconnect: start.b}").what
    assert "outputs.end" in refusal("{disconnect: outputs.and}").nearest


# --- replace


def test_replace_keeps_ports_and_parameters_of_the_same_name(patched: Patched) -> None:
    graph = patched("{replace: rounds.hop, type: toy.leap, factor: 4}")
    assert [graph.nodes[f"rounds[{r}].hop"].definition.type for r in (1, 2)] == ["toy.leap", "toy.leap"]
    assert value(graph, "rounds[1].hop", "factor") == 4
    assert wires(graph) == wires(patched())


def test_replace_renames_ports_on_both_sides(patched: Patched) -> None:
    graph = patched("{replace: rounds.hop, type: toy.add, ports: {state: number}, a: '@step.state'}")
    assert wires(graph)["end.a"] == "rounds[2].hop.number"
    graph = patched("{replace: start, type: toy.step, ports: {a: state, number: state}}")
    assert wires(graph)["start.state"] == "a.number"
    assert "start.b" not in wires(graph)
    assert wires(graph)["rounds[1].step.state"] == "start.state"


def test_replace_drops_what_single_rounds_had_and_can_act_in_one_round(patched: Patched) -> None:
    graph = patched("{replace: rounds.step, type: toy.step}")
    assert [value(graph, f"rounds[{r}].step", "amount") for r in (1, 2)] == [1, 1]
    graph = patched("{replace: 'rounds[1].hop', type: toy.leap, factor: 3}")
    assert [graph.nodes[f"rounds[{r}].hop"].definition.type for r in (1, 2)] == ["toy.leap", "toy.step"]


def test_replace_is_refused(refusal: Refusal) -> None:
    assert "toy.leap" in refusal("{replace: rounds.hop, type: toy.lep}").nearest
    problem = refusal("{replace: start, type: toy.metrics, ports: {a: number}}")
    assert "no output 'number', which rounds.carry.state" in problem.what
    assert "ports: {number: metrics}" in problem.fix
    assert "old node has no port 'x'" in refusal("{replace: start, type: toy.step, ports: {x: state}}").what
    assert "has no port 'x'" in refusal("{replace: start, type: toy.step, ports: {a: x}}").what
    assert "type:" in refusal("{replace: start}").what
    assert "repeat block" in refusal("{replace: rounds, type: toy.step}").what


# --- insert


def test_insert_on_the_wire_into_a_port(patched: Patched) -> None:
    graph = patched("{insert: {name: mid, type: toy.step, amount: 4}, on: rounds.hop.state}")
    assert wires(graph)["rounds[2].mid.state"] == "rounds[2].step.state"
    assert wires(graph)["rounds[2].hop.state"] == "rounds[2].mid.state"
    assert wires(graph)["end.b"] == "rounds[1].step.state"


def test_insert_behind_an_output_takes_all_its_users_along(patched: Patched) -> None:
    graph = patched("{insert: {name: mid, type: toy.step}, on: '@rounds.step.state'}")
    assert wires(graph)["rounds[2].hop.state"] == "rounds[2].mid.state"
    assert wires(graph)["end.b"] == "rounds[1].mid.state"
    graph = patched("{insert: {name: mid, type: toy.sign}, on: '@rounds.state'}")
    assert (wires(graph)["mid.number"], wires(graph)["end.a"]) == ("rounds[2].hop.state", "mid.number")
    assert wires(patched("{insert: {name: mid, type: toy.sign}, on: outputs.end}"))["mid.number"] == "end.number"
    graph = patched("{insert: {name: mid, type: toy.sign}, on: rounds.next.state}")
    assert (wires(graph)["rounds[1].mid.number"], wires(graph)["end.a"]) == (
        "rounds[1].hop.state",
        "rounds[2].mid.number",
    )
    graph = patched("{insert: {name: mid, type: toy.sign}, on: rounds.carry.state}")
    assert (wires(graph)["mid.number"], wires(graph)["rounds[1].step.state"]) == ("start.number", "mid.number")


def test_insert_asks_which_port_where_several_fit(patched: Patched, refusal: Refusal) -> None:
    problem = refusal("{insert: {name: mid, type: toy.subtract}, on: start.a}")
    assert "toy.subtract has 2 inputs" in problem.what
    assert "in: NAME" in problem.expected
    graph = patched("{insert: {name: mid, type: toy.subtract, b: '@b.number'}, on: start.a}")
    assert (wires(graph)["mid.a"], wires(graph)["start.a"]) == ("a.number", "mid.number")
    graph = patched("{insert: {name: mid, type: toy.split}, on: start.a, out: test}")
    assert wires(graph)["start.a"] == "mid.test"


def test_insert_is_refused(refusal: Refusal) -> None:
    assert "there is a node 'b' already" in refusal("{insert: {name: b, type: toy.sign}, on: start.a}").what
    assert "would hide 'a'" in refusal("{insert: {name: a, type: toy.step}, on: rounds.hop.state}").what
    assert "would hide 'rounds.hop'" in refusal("{insert: {name: hop, type: toy.sign}, on: start.a}").what
    assert "nothing uses" in refusal("{insert: {name: m, type: toy.sign}, on: '@shown.metrics'}").what
    assert "not connected" in refusal("{disconnect: start.b}", "{insert: {name: m, type: toy.sign}, on: start.b}").what
    assert "insert needs" in refusal("{insert: {type: toy.sign}, on: start.a}").what


# --- bypass


def test_bypass_joins_both_sides_in_every_round(patched: Patched) -> None:
    graph = patched("{bypass: rounds.hop}")
    assert wires(graph)["rounds[2].step.state"] == "rounds[1].step.state"
    assert wires(graph)["end.a"] == "rounds[2].step.state"
    assert "rounds[1].hop" not in graph.nodes


def test_bypass_needs_to_know_the_way(refusal: Refusal, patched: Patched) -> None:
    problem = refusal("{bypass: start}")
    assert "2 ways: a, b are all Number" in problem.what
    assert problem.fix == "{bypass: start, via: a}"
    assert wires(patched("{bypass: start, via: b}"))["rounds[1].step.state"] == "b.number"
    assert wires(patched("{disconnect: start.b}", "{bypass: start}"))["rounds[1].step.state"] == "a.number"
    assert "no connected input 'c'" in refusal("{bypass: start, via: c}").what


def test_bypass_is_refused(refusal: Refusal) -> None:
    assert (
        "means something else" in refusal("{bypass: rounds.step}").what
    )  # @rounds[1].step is @carry.state from inside
    assert "no connected input is a Number" in refusal("{bypass: a}").what
    assert "bypassed already" in refusal("{bypass: 'rounds[1].hop'}", "{bypass: 'rounds[1].hop'}").what
    assert "set: rounds.repeat" in refusal("{bypass: rounds}").fix


def test_bypass_of_a_node_that_a_round_names_from_outside(patched: Patched) -> None:
    graph = patched('{connect: end.b, to: "@rounds[1].hop.state"}', "{bypass: rounds.hop}")
    assert wires(graph)["end.b"] == "rounds[1].step.state"


# --- remove, add


def test_remove_takes_what_nothing_needs(patched: Patched) -> None:
    assert "shown" not in patched("{remove: shown}").nodes
    graph = patched("{disconnect: outputs.end}", "{remove: [end, shown, rounds]}")
    assert list(graph.nodes) == ["a", "b", "start"]


def test_remove_is_refused_while_something_links_here(refusal: Refusal) -> None:
    problem = refusal("{remove: end}")
    assert "shown.number" in problem.what
    assert "outputs.end" in problem.what
    assert problem.fix == "{disconnect: outputs.end} first"
    assert "{bypass: rounds.step}" in refusal("{remove: rounds.step}").fix
    assert "there is no node 'shown'" in refusal("{remove: shown}", "{remove: shown}").what


def test_add_makes_a_node_at_the_top_or_in_a_block(patched: Patched) -> None:
    graph = patched("{add: {name: more, type: toy.metrics, number: '@end.number'}}",
                    "{add: {name: rounds.look, type: toy.metrics, number: '@hop.state'}}")  # fmt: skip
    assert wires(graph)["more.number"] == "end.number"
    assert wires(graph)["rounds[2].look.number"] == "rounds[2].hop.state"


def test_add_takes_a_sub_graph_beside_the_patches_file(bench: Any, patched: Patched) -> None:
    inner = "inputs: {number: Number}\nnodes: {twice: {type: toy.add, a: '@inputs.number', b: '@inputs.number'}}\n"
    (bench.write("nodes: {}").parent / "twice.yaml").write_text(inner + "outputs: {number: '@twice.number'}\n")
    graph = patched("{add: {name: more, graph: twice.yaml, number: '@b.number'}}",
                    '{connect: start.a, to: "@more.number"}')  # fmt: skip
    assert wires(graph)["start.a"] == "more.twice.number"
    assert wires(graph)["more.twice.a"] == "b.number"


def test_add_is_refused(refusal: Refusal) -> None:
    assert "there is a node 'a' already" in refusal("{add: {name: a, type: toy.const}}").what
    assert "no repeat block 'round'" in refusal("{add: {name: round.a, type: toy.const}}").what
    assert "would hide 'a'" in refusal("{add: {name: rounds.a, type: toy.const}}").what
    assert "toy.const" in refusal("{add: {name: c, type: toy.cons}}").nearest
    assert "is not a name" in refusal("{add: {name: 1c, type: toy.const}}").what
    assert "needs a name and a node" in refusal("{add: {name: c}}").what


# --- all of them


def test_what_is_no_patch_is_refused(refusal: Refusal) -> None:
    assert "bypass" in refusal("{bypas: rounds.hop}").nearest
    assert "two operations" in refusal("{bypass: rounds.hop, remove: shown}").what
    assert "has no 'too'" in refusal("{bypass: rounds.hop, too: 1}").what
    assert "a mapping" in refusal("bypass").what


def test_patches_act_in_order(patched: Patched, refusal: Refusal) -> None:
    graph = patched("{add: {name: c, type: toy.const}}", '{connect: start.b, to: "@c.number"}', "{remove: b}")
    assert wires(graph)["start.b"] == "c.number"
    assert (
        "there is no node 'c'"
        in refusal('{connect: start.b, to: "@c.number"}', "{add: {name: c, type: toy.const}}").what
    )
