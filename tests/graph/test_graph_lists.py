"""Many into one and one into many: list inputs, lists that nodes make, a node for each element, and gathering them."""

from __future__ import annotations

from typing import Any

import pytest

from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.run.backends.local import Local
from exmesh_graph.graph.run.runner import NodeFailed
from exmesh_graph.report.reasons import explained as plan

STATIC = """
nodes:
  one: {type: toy.const, value: 1}
  two: {type: toy.const, value: 2}
  rounds:
    repeat: 3
    carry: {state: "@two.number"}
    nodes: {step: {type: toy.step, state: "@carry.state"}}
    next: {state: "@step.state"}
  all: {type: toy.gather, numbers: ["@one.number", "@two.number"]}
  carried: {type: toy.gather, numbers: "@rounds[*].state", more: ["@one.number", "@rounds[*].step.state"]}
run: all
"""
MAPPED = """
nodes:
  size: {type: toy.const, value: 4}
  cut: {type: toy.cut, number: "@size.number"}
  up: {type: toy.shift, each: number, number: "@cut.parts", by: 1}
  more: {type: toy.add, each: [a, b], a: "@up.number", b: "@cut.parts"}
  all: {type: toy.gather, numbers: "@up.number"}
  both: {type: toy.gather, numbers: ["@size.number", "@more.number", "@cut.count"]}
outputs: {all: "@all.number", both: "@both.number", up: "@up.number"}
"""


def test_a_list_input_takes_several_links_in_order(bench: Any) -> None:
    record = bench.run(STATIC)
    assert bench.value(record, "all") == 119  # 1, 2, and -1 where the other list was left out: ((1 * 10) + 2) * 10 - 1
    assert bench.value(record, "carried") == 3451345
    swapped = bench.run(STATIC.replace('["@one.number", "@two.number"]', '["@two.number", "@one.number"]'))
    assert bench.value(swapped, "all") == 209
    assert record["resolved"]["nodes"]["all"]["inputs"] == {"numbers[1]": "@one.number", "numbers[2]": "@two.number"}


def test_the_key_binds_each_place_to_a_digest(bench: Any) -> None:
    steps = {step.name: step for step in plan(bench.check(STATIC), bench.store)}
    bench.run(STATIC)
    steps = {step.name: step for step in plan(bench.check(STATIC), bench.store)}
    inputs = steps["all"].preimage["inputs"]
    assert list(inputs) == ["numbers[1]", "numbers[2]"]
    assert all(step.state == "hit" for step in steps.values())


def test_each_element_is_a_node_of_its_own(bench: Any, states: Any) -> None:
    record = bench.run(MAPPED)
    assert bench.value(record, "all") == 23449  # 2, 3, 4, 5, and -1 where the other list was left out
    done = states(record)
    assert [name for name in done if name.startswith("up")] == ["up[1]", "up[2]", "up[3]", "up[4]", "up"]
    keys = {row["name"]: row["key"] for row in record["nodes"]}
    assert len({keys[f"up[{n}]"] for n in (1, 2, 3, 4)}) == 4
    assert keys["up"] is None
    # (4, then n + n + 1 for n = 1..4, then 4) as digits, and -1 for the list left out
    assert bench.value(record, "both") == ((((((4 * 10 + 3) * 10 + 5) * 10 + 7) * 10 + 9) * 10 + 4) * 10) - 1
    assert sorted(record["published"]) == ["all", "both", "up-1", "up-2", "up-3", "up-4"]
    assert set(states(bench.run(MAPPED)).values()) == {"hit"}


def test_an_element_has_the_key_of_the_node_written_out(bench: Any) -> None:
    record = bench.run(MAPPED)
    text = """
nodes:
  two: {type: toy.const, value: 2}
  up: {type: toy.shift, number: "@two.number", by: 1}
"""
    other = bench.run(text)
    keys = {row["name"]: row["key"] for row in record["nodes"]}
    assert other["nodes"][-1]["key"] == keys["up[2]"]
    assert other["nodes"][-1]["state"] == "hit"


def test_only_new_elements_run(bench: Any, states: Any) -> None:
    bench.run(MAPPED)
    done = states(bench.run(MAPPED, "size.value=6"))
    assert [done[f"up[{n}]"] for n in range(1, 7)] == ["hit"] * 4 + ["done"] * 2
    assert done["up"] == "done"
    fewer = states(bench.run(MAPPED, "size.value=2"))
    assert "up[3]" not in fewer
    assert fewer["up"] == "hit"


def test_plan_knows_the_elements_where_the_list_is_there(bench: Any) -> None:
    before = {step.name: step for step in plan(bench.check(MAPPED), bench.store)}
    assert before["up"].reason == "waits for cut"
    bench.run(MAPPED)
    steps = {step.name: step.state for step in plan(bench.check(MAPPED, "up.by=2"), bench.store)}
    assert {steps[f"up[{n}]"] for n in (1, 2, 3, 4)} == {"run"}
    assert steps["up"] == "unknown"
    assert steps["all"] == "unknown"
    assert "more" in steps


def test_an_empty_list(bench: Any, states: Any) -> None:
    text = MAPPED.replace(
        '{type: toy.cut, number: "@size.number"}', '{type: toy.cut, number: "@none.number", parts: 0}'
    )
    text = text.replace("nodes:\n", "nodes:\n  none: {type: toy.const, value: 0}\n", 1)
    record = bench.run(text)
    assert bench.value(record, "all") == -1
    assert states(record)["up"] == "hit"  # nothing had to run
    assert bench.value(record, "both") == 399


@pytest.mark.thorough
def test_workers_make_the_same_bytes(bench: Any) -> None:
    inline = bench.run(MAPPED)
    backend = Local(2)
    bench_store = Store(bench.root / "other")
    from exmesh_graph.graph.run.rundir import RunFolder
    from exmesh_graph.graph.run.runner import Runner

    folder = RunFolder(bench.root / "runs", "again")
    beside = Runner(bench.check(MAPPED), bench_store, folder, bench.events.append, backend=backend).run()
    told = [
        {row["name"]: (row["key"], [out["digest"] for out in row["outputs"].values()]) for row in run["nodes"]}
        for run in (inline, beside)
    ]
    assert told[0] == told[1]


def test_a_failed_element_is_one_failed_node_and_resumes(bench: Any, states: Any) -> None:
    text = MAPPED.replace("toy.shift, each: number", "toy.fail, each: number").replace(", by: 1", ", value: 2")
    with pytest.raises(NodeFailed) as caught:
        bench.run(text, keep_going=True)
    names = [record["node"] for record in caught.value.records]
    assert names == ["up[1]", "up[2]"]
    assert caught.value.records[0]["job"] is not None  # what `exmesh replay` runs
    done = states(bench.run(text, "up.value=0"))
    assert done["up"] == "done"
    assert done["up[4]"] == "done"  # the limit is a parameter


@pytest.mark.parametrize("published", [True, False])
def test_broken_bytes_of_an_element_are_made_again(bench: Any, states: Any, published: bool) -> None:
    text = MAPPED if published else MAPPED.replace(', up: "@up.number"', "")
    record = bench.run(text)
    row = next(row for row in record["nodes"] if row["name"] == "up[3]")
    data = bench.store.data(row["outputs"]["number"]["digest"])
    for path in data.iterdir():
        path.chmod(0o644)
        assert b"p+2" in path.read_bytes()
        path.write_bytes(path.read_bytes().replace(b"p+2", b"p+3"))
    again = bench.run(text, force={"all"})
    assert bench.value(again, "all") == bench.value(record, "all") == 23449
    assert states(again)["up[3]"] == "done"


def test_values_of_a_run_are_tuples(bench: Any) -> None:
    import exmesh_graph as ex

    places: Any = {"store": bench.root / "store", "runs": bench.root / "runs", "workers": 0}
    run = ex.run(bench.write(MAPPED), **places, report=True)
    assert [number.value for number in run["up"].number] == [2, 3, 4, 5]
    assert [number.value for number in run["cut"].parts] == [1, 2, 3, 4]
    assert run["up[2]"].number.value == 3
    assert [number.value for number in run.outputs["up"]] == [2, 3, 4, 5]
    assert [
        step.name for step in ex.plan(bench.root / "graph.yaml", store=places["store"]) if step.state != "hit"
    ] == []
    one = ex.run(bench.root / "graph.yaml", **places, nodes="up[2]", force="up", report=False)
    assert one["up[2]"].info["state"] == "done"


def test_a_list_is_given_to_a_call_as_one(bench: Any) -> None:
    import exmesh_graph as ex
    from exmesh_graph.errors import GraphError

    numbers = [ex.call("toy.const", value=float(n)).number for n in (3, 4)]
    assert ex.call("toy.gather", numbers=numbers).number.value == 339
    assert ex.call("toy.gather", numbers=numbers, more=numbers[:1]).number.value == 343
    with pytest.raises(GraphError, match="takes a list"):
        ex.call("toy.gather", numbers=numbers[0])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('each: number, number: "@cut.parts"', 'number: "@cut.parts"', "a list, but number takes one"),
        ('number: "@cut.parts", by', 'number: "@cut.count", by', "@cut.count is no list"),
        ("each: number", "each: numbr", "not 'numbr'"),
        ("each: [a, b]", "each: a", "a list, but b takes one"),
        ('toy.gather, numbers: "@up.number"', 'toy.gather, each: numbers, numbers: "@up.number"', "not 'numbers'"),
        ('numbers: "@up.number"', "numbers: 3", "numbers is an input port, not a parameter"),
        ('numbers: "@up.number"', 'numbers: ["@up.number", 3]', "numbers is an input port, not a parameter"),
        ('numbers: "@up.number"', 'numbers: ["@up.nummer"]', "has no output 'nummer'"),
        ('numbers: "@up.number"', 'numbers: "@round[*].x"', "no repeat block 'round'"),
        (", by: 1", ', by: ["@cut.count"]', "by is a parameter, not an input port"),
    ],
)
def test_wrong_lists_are_refused_with_their_line(bench: Any, old: str, new: str, words: str) -> None:
    assert old in MAPPED
    problems = [str(problem) for problem in bench.problems(MAPPED.replace(old, new, 1))]
    assert any(words in told for told in problems), problems
    assert all("graph.yaml:" in told for told in problems)


def test_lists_of_different_lengths_are_told_at_the_run(bench: Any) -> None:
    text = MAPPED.replace('b: "@cut.parts"', 'b: "@other.parts"').replace(
        "  up:", '  other: {type: toy.cut, number: "@cut.count2"}\n  up:'
    )
    text = text.replace("@cut.count2", "@three.number").replace(
        "nodes:\n", "nodes:\n  three: {type: toy.const, value: 3}\n", 1
    )
    with pytest.raises(NodeFailed, match="more: its lists differ in length: a has 4, b has 3"):
        bench.run(text)


def test_an_element_of_another_type_is_refused(bench: Any) -> None:
    with pytest.raises(NodeFailed, match=r"returned float for its output wrong\[1\]"):
        bench.run("nodes: {bad: {type: toy.wrong_list}}")


def test_gc_keeps_and_verify_reads_the_elements(bench: Any) -> None:
    from exmesh_graph.graph.upkeep.collect import delete, survey, verify

    bench.run(MAPPED)
    survey_ = survey(bench.store, [bench.root / "runs"], age=0.0)
    delete(bench.store, survey_)
    assert list(verify(bench.store)) == []
    assert {row["state"] for row in bench.run(MAPPED)["nodes"]} == {"hit"}


def test_patches_see_links_in_lists(bench: Any) -> None:
    from exmesh_graph.graph.problems import GraphErrors
    from exmesh_graph.graph.variants.checked import check_variant

    second = '{type: toy.shift, number: "@one.number"}'
    path = bench.write(
        STATIC.replace("  all:", f"  b: {second}\n  all:")
        + """
variants:
  gone: [{remove: one}]
  past: [{connect: carried.more, to: "@rounds[*].step.state"}, {replace: rounds.step, type: toy.leap}]
  short: [{add: {name: c, type: toy.gather, numbers: ["@b.number", "@one.number"]}}, {bypass: b}]
"""
    )
    with pytest.raises(GraphErrors, match=r"\[patch\]"):  # refused by the patch, before the graph is looked at
        check_variant(path, [], bench.packs, "gone")
    past = check_variant(path, [], bench.packs, "past")
    assert len([port for port in past.nodes["carried"].inputs if port.startswith("more")]) == 3
    short = check_variant(path, [], bench.packs, "short")
    assert {str(link) for link in short.nodes["c"].inputs.values()} == {"@one.number"}


@pytest.mark.thorough
def test_two_readers_of_broken_elements(bench: Any, states: Any) -> None:
    """Both find the bytes broken while neither has a result: the element is made again once, and gathered anew."""
    # shifted so far that no other node has made the same number, whose bytes would then be broken too
    text = MAPPED.replace(', up: "@up.number"', "").replace("by: 1}", "by: 10}")
    record = bench.run(text)
    for row in record["nodes"]:
        if row["name"] in ("up[2]", "up[3]"):
            for path in bench.store.data(row["outputs"]["number"]["digest"]).iterdir():
                sound = path.read_bytes()
                path.chmod(0o644)
                path.write_bytes(sound.replace(b"p+3", b"p+5"))
                assert path.read_bytes() != sound
    backend = Local(2)
    again = bench.run(text, force={"all", "more[2]", "more[3]"}, backend=backend)
    assert bench.value(again, "all") == bench.value(record, "all")
    assert bench.value(again, "both") == bench.value(record, "both")
    assert states(again)["up[2]"] == states(again)["up[3]"] == "done"
    assert states(again)["up[1]"] == "hit"
