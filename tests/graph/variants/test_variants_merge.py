"""Many graphs as one: what is shared, and that keys, values and order are those of separate runs."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.language.check import Checked
from exmesh_graph.graph.language.yamlfile import parse_yaml
from exmesh_graph.graph.run.rundir import RunFolder
from exmesh_graph.graph.run.runner import Runner
from exmesh_graph.graph.variants.checked import check_variants
from exmesh_graph.graph.variants.compare import merge
from exmesh_graph.graph.variants.patches import apply_patches

TEXT = """
variants:
  x: [{set: b.value, to: 3}]
  y: [{bypass: rounds.hop}]
  same: [{set: a.value, to: 2}, {set: rounds.hop.amount, to: 10.0}]
"""


def test_equal_nodes_stand_once(bench: Any, base: str) -> None:
    merged = merge([(row.name, row.checked) for row in check_variants(bench.write(base + TEXT), [], bench.packs)])
    names = {member.label: member.names for member in merged.members}
    assert names["same"] == names["base"] == {name: name for name in names["base"]}
    assert names["x"]["a"] == "a"
    assert names["x"]["b"] == "x:b"
    assert names["x"]["end"] == "x:end"
    assert names["y"]["rounds[1].step"] == "rounds[1].step"
    assert names["y"]["rounds[2].step"] == "y:rounds[2].step"
    base_names = set(names["base"].values())
    assert [len(base_names & set(member.names.values())) for member in merged.members] == [9, 1, 4, 9]
    assert len(merged.checked.nodes) == 9 + 8 + 3
    assert merged.checked.outputs == {}


def run(graph: Checked, folder: Any, *, store: str) -> dict[str, Any]:
    runs = RunFolder(folder / "runs", "g")
    try:
        return Runner(graph, Store(folder / store), runs, lambda event: None).run()
    finally:
        runs.close()


PATCHES = [
    "{set: a.value, to: 3}", "{set: b.value, to: 2}", "{set: five, to: 7}", "{set: rounds.hop.amount, to: 2}",
    "{set: 'rounds[2].hop.amount', to: 3}", "{bypass: rounds.hop}", "{disconnect: start.b}", "{set: n, to: 1}",
    "{replace: rounds.hop, type: toy.leap}", "{insert: {name: mid, type: toy.step}, on: rounds.hop.state}",
    '{connect: end.b, to: "@a.number"}', "{set: a.threads, to: 2}", "{set: seed, to: 1}",
    "{add: {name: more, type: toy.sign, number: '@a.number'}}", "{set: rounds.repeat, to: 3}", "{remove: shown}",
]  # fmt: skip


@pytest.mark.thorough
@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(chosen=st.lists(st.sets(st.sampled_from(PATCHES), max_size=2), min_size=1, max_size=4))
def test_keys_in_a_merged_run_are_those_of_separate_runs(
    chosen: list[set[str]], bench: Any, base: str, tmp_path_factory: Any
) -> None:
    """Each variant alone with a store of its own; the merged graph in another: equal keys, equal digests, no extra."""
    folder = tmp_path_factory.mktemp("merge")
    lines = [
        f"  v{i}: [{', '.join(sorted(patches))}]" for i, patches in enumerate(chosen) if _works(patches, bench, base)
    ]
    text = base + "variants:\n" + "\n".join(lines or ["  v: []"])
    rows = check_variants(bench.write(text), [], bench.packs)
    merged = merge([(row.name, row.checked) for row in rows])
    record = run(merged.checked, folder, store="all")
    together = {row["name"]: row for row in record["nodes"]}
    keys = [row["key"] for row in record["nodes"]]
    for row, member in zip(rows, merged.members, strict=True):
        alone = run(row.checked, folder, store=f"alone-{row.name}")
        for node in alone["nodes"]:
            twin = together[member.names[node["name"]]]
            assert (node["key"], node["outputs"]) == (twin["key"], twin["outputs"])
    assert sum(row["state"] == "done" for row in together.values()) == len(set(keys))


def _works(patches: set[str], bench: Any, base: str) -> bool:
    from exmesh_graph.graph.problems import GraphErrors

    try:
        check_variants(bench.write(base + f"variants: {{v: [{', '.join(sorted(patches))}]}}"), [], bench.packs)
    except GraphErrors:
        return False
    return True


# footprint: what a patch makes, changes or removes, and what it needs to be as it is
FOOTPRINTS = {
    "{set: a.value, to: 3}": ({"a.value"}, {"a"}),
    "{set: b.value, to: 2}": ({"b.value"}, {"b"}),
    "{set: five, to: 7}": ({"five"}, set()),
    "{set: rounds.repeat, to: 3}": ({"n"}, set()),
    "{set: rounds.hop.amount, to: 2}": ({"hop.amount"}, {"hop"}),
    "{set: 'rounds[2].hop.amount', to: 3}": ({"hop.amount"}, {"hop"}),
    "{bypass: rounds.hop}": ({"hop", "hop.state", "hop.amount", "next"}, set()),
    "{replace: rounds.hop, type: toy.leap, factor: 3}": ({"hop", "hop.amount"}, set()),
    "{insert: {name: mid, type: toy.step}, on: rounds.hop.state}": ({"hop.state", "mid"}, {"hop"}),
    "{insert: {name: tail, type: toy.sign}, on: '@rounds.state'}": ({"end.a", "tail"}, set()),
    "{disconnect: start.b}": ({"start.b"}, {"start"}),
    "{disconnect: outputs.end}": ({"outputs"}, set()),
    '{connect: end.b, to: "@a.number"}': ({"end.b"}, {"a", "end"}),
    '{connect: start.a, to: "@b.number"}': ({"start.a"}, {"b", "start"}),
    "{remove: shown}": ({"shown"}, set()),
    "{add: {name: more, type: toy.sign, number: '@a.number'}}": ({"more"}, {"a"}),
    "{add: {name: rounds.look, type: toy.metrics, number: '@step.state'}}": ({"look"}, {"step"}),
}


@pytest.mark.thorough
@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(order=st.permutations(sorted(FOOTPRINTS)), size=st.integers(2, 6))
@pytest.mark.reliability("patches of a variant in any order, on different nodes", "the same graph")
def test_patches_with_separate_footprints_commute(order: list[str], size: int, bench: Any, base: str) -> None:
    chosen: list[str] = []
    for text in order:
        makes, needs = FOOTPRINTS[text]
        others = [FOOTPRINTS[other] for other in chosen]
        if len(chosen) < size and all(not (makes & (m | n)) and not (needs & m) for m, n in others):
            chosen.append(text)
    top = parse_yaml(base, None)
    forwards = apply_patches(top, [parse_yaml(text, None) for text in chosen], bench.packs)
    backwards = apply_patches(top, [parse_yaml(text, None) for text in reversed(chosen)], bench.packs)
    assert forwards == backwards
    assert top == parse_yaml(base, None)  # the file itself stays as it was


def test_what_repeated_patches_do(bench: Any, base: str) -> None:
    """Setting, connecting and replacing again changes nothing more; the other five are refused."""
    from exmesh_graph.graph.problems import GraphErrors

    top, again = parse_yaml(base, None), {}
    for text in FOOTPRINTS:
        patch = parse_yaml(text, None)
        once = apply_patches(top, [patch], bench.packs)
        try:
            again[text] = apply_patches(top, [patch, patch], bench.packs) == once
        except GraphErrors:
            again[text] = False
    operations = {text.strip("{").partition(":")[0]: same for text, same in again.items()}
    same = {name for name, value in operations.items() if value}
    assert same == {"set", "connect", "replace"}
    assert len(operations) == 8
