"""What must hold for any graph and any edits: a cached result is the result, keys tell apart all that matters."""

from __future__ import annotations

import dataclasses
import math
import random
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, assume, given, settings
from hypothesis import strategies as st

from exmesh_graph import files
from exmesh_graph.graph.cache.keys import canonical, key_of, preimage_of
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.declare.node import NodeDef
from exmesh_graph.graph.run.rundir import RunFolder
from exmesh_graph.graph.run.runner import Runner
from exmesh_graph.report.reasons import explained as plan

FEW = settings(
    max_examples=12,
    phases=[Phase.explicit, Phase.generate],
    deadline=None,
    suppress_health_check=list(HealthCheck),
    derandomize=True,
)
MANY = settings(
    max_examples=300, phases=[Phase.explicit, Phase.generate], deadline=None, suppress_health_check=list(HealthCheck)
)
Nodes = dict[str, dict[str, Any]]
"""{name: {type, its parameters, its links}} as in a graph file, every node after those it reads."""


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """These tests are not about power cuts."""
    monkeypatch.setattr(files, "sync", lambda path: None)


def output(node: dict[str, Any]) -> str:
    return "state" if node["type"] in ("toy.step", "toy.leap") else "number"


def link(nodes: Nodes, name: str) -> str:
    return f"@{name}.{output(nodes[name])}"


def links(node: dict[str, Any]) -> dict[str, str]:
    """{port: node} of a node's links."""
    return {k: v[1:].partition(".")[0] for k, v in node.items() if isinstance(v, str) and v.startswith("@")}


@st.composite
def new_node(draw: st.DrawFn, nodes: Nodes) -> dict[str, Any]:
    """A node that may read any of `nodes`."""
    if not nodes or draw(st.integers(0, 4)) == 0:
        return {"type": "toy.const", "value": draw(st.integers(-4, 4))}
    above = st.sampled_from(sorted(nodes)).map(lambda name: link(nodes, name))
    kind = draw(st.sampled_from(["add", "subtract", "sign", "seeded", "step", "leap"]))
    if kind in ("add", "subtract"):
        return {"type": f"toy.{kind}", "a": draw(above), "b": draw(above)}
    if kind == "step":
        return {"type": "toy.step", "state": draw(above), "amount": draw(st.integers(-3, 3))}
    if kind == "leap":
        return {"type": "toy.leap", "state": draw(above), "factor": draw(st.integers(-2, 2))}
    return {"type": f"toy.{kind}", "number": draw(above)}


@st.composite
def graphs(draw: st.DrawFn, most: int = 7) -> Nodes:
    nodes: Nodes = {}
    for index in range(draw(st.integers(1, most))):
        nodes[f"n{index}"] = draw(new_node(nodes))
    return nodes


def earlier(nodes: Nodes, name: str) -> Nodes:
    names = list(nodes)
    return {n: nodes[n] for n in names[: names.index(name)]}


@st.composite
def edited(draw: st.DrawFn, nodes: Nodes) -> Nodes:
    """The graph after one edit: a parameter, a wire, another node in place of one, a swap, or a removal."""
    nodes = {name: dict(node) for name, node in nodes.items()}
    name = draw(st.sampled_from(list(nodes)))
    node, above = nodes[name], earlier(nodes, name)
    kind = draw(st.sampled_from(["parameter", "wire", "swap", "replace", "remove", "add"]))
    if kind == "parameter":
        for field in [f for f in ("value", "amount", "factor") if f in node]:
            node[field] = draw(st.integers(-4, 4))
    elif kind == "wire" and links(node):
        node[draw(st.sampled_from(sorted(links(node))))] = link(nodes, draw(st.sampled_from(sorted(above))))
    elif kind == "swap" and {"a", "b"} <= node.keys():
        node["a"], node["b"] = node["b"], node["a"]
    elif kind == "replace":
        new = draw(new_node(above))
        assume(output(new) == output(node))
        nodes[name] = new
    elif kind == "remove" and len(nodes) > 1:
        users = [n for n in nodes if name in links(nodes[n]).values()]
        del nodes[name]
        for user in users:
            nodes[user] = draw(new_node(earlier(nodes, user)))
            assume(output(nodes[user]) == ("state" if nodes[user]["type"] in ("toy.step", "toy.leap") else "number"))
        fix_outputs(nodes)
    else:
        nodes[f"x{len(nodes)}_{draw(st.integers(0, 999))}"] = draw(new_node(nodes))
    return nodes


def fix_outputs(nodes: Nodes) -> None:
    """Let every link name the port that its node now has."""
    for node in nodes.values():
        for port, above in links(node).items():
            node[port] = link(nodes, above)


def values(nodes: Nodes, *, edited_code: bool) -> dict[str, float]:
    """The numbers that a graph must give, computed directly; `seeded` runs with seed 1."""
    found: dict[str, float] = {}
    for name, node in nodes.items():
        x = {port: found[above] for port, above in links(node).items()}
        kind = node["type"].removeprefix("toy.")
        if kind == "const":
            found[name] = node["value"]
        elif kind in ("add", "subtract"):
            found[name] = x["a"] + x["b"] if kind == "add" and not edited_code else x["a"] - x["b"]
        elif kind == "sign":
            found[name] = 1.0 if x["number"] >= 0 else -1.0
        elif kind == "seeded":
            found[name] = x["number"] + 1
        else:
            found[name] = x["state"] + node["amount"] if kind == "step" else x["state"] * node["factor"]
    return found


def text_of(nodes: Nodes, dice: random.Random | None = None) -> str:
    """The graph file; with `dice`, its keys in random order and its scalars in random spelling."""
    names, fields = list(nodes), {name: list(node) for name, node in nodes.items()}
    if dice is not None:
        dice.shuffle(names)
        for keys in fields.values():
            dice.shuffle(keys)

    def spelled(value: Any) -> str:
        if isinstance(value, str):
            return f'"{value}"' if dice is None or dice.random() < 0.5 else f"'{value}'"
        return str(value) if dice is None else dice.choice([str(value), f"{value}.0", f"{value}e0"])

    def lines(name: str) -> str:
        pairs = [f"{key}: {spelled(nodes[name][key])}" for key in fields[name]]
        if dice is not None and dice.random() < 0.5:
            return f"  {name}:\n" + "".join(f"    {pair}\n" for pair in pairs)
        return f"  {name}: {{{', '.join(pairs)}}}\n"

    blocks = ["seed: 1\n", "nodes:\n" + "".join(map(lines, names))]
    return "".join(reversed(blocks) if dice is not None and dice.random() < 0.5 else blocks)


def run_in(bench: Any, text: str, store: Path) -> dict[str, Any]:
    """{node: row} of a run in a store of its own."""
    graph = bench.check(text)
    folder = RunFolder(bench.root / "runs", graph.name)
    try:
        record = Runner(graph, Store(store), folder, lambda event: None).run()
    finally:
        folder.close()
    return {row["name"]: row for row in record["nodes"]}


def check_edits(bench: Any, tmp: Path, data: st.DataObject) -> None:
    """After each of some random edits, a run in the old store gives what a run in an empty one gives."""
    nodes, code = data.draw(graphs()), False
    original = bench.packs.types["toy.add"]
    try:
        for step in range(data.draw(st.integers(2, 4))):
            if step:
                nodes = data.draw(edited(nodes))
                code ^= data.draw(st.integers(0, 3)) == 0
            bumped = dataclasses.replace(original, version=data.draw(st.sampled_from(["1", "1", "2"])))
            function = bench.packs.types["toy.subtract"].function if code else original.function
            define(bench, dataclasses.replace(bumped, function=function))
            check_one(bench, nodes, code, tmp / "cached", tmp / f"fresh{step}")
    finally:
        define(bench, original)


def define(bench: Any, definition: NodeDef) -> None:
    """Let a node type mean something else from now on."""
    bench.packs.types[definition.type] = definition


def check_one(bench: Any, nodes: Nodes, code: bool, used: Path, empty: Path) -> None:
    text = text_of(nodes)
    cached, fresh = run_in(bench, text, used), run_in(bench, text, empty)
    assert {name: row["key"] for name, row in cached.items()} == {name: row["key"] for name, row in fresh.items()}
    assert {name: row["outputs"] for name, row in cached.items()} == {n: row["outputs"] for n, row in fresh.items()}
    for name, value in values(nodes, edited_code=code).items():
        (stored,) = cached[name]["outputs"].values()
        loaded: Any = Store(used).load(sys.modules["toy_pack.nodes"].Number, stored["digest"])
        assert loaded.value == value, name
    assert {row["state"] for row in run_in(bench, text, used).values()} == {"hit"}


@pytest.mark.thorough
@pytest.mark.reliability("random graphs after random edits of values, wires, nodes and code",
                         "cached results equal those of an empty store and direct evaluation")  # fmt: skip
@FEW
@given(data=st.data())
def test_cached_results_equal_fresh_ones(
    bench: Any, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    check_edits(bench, tmp_path_factory.mktemp("stores"), data)


@pytest.mark.slow
@MANY
@given(data=st.data())
def test_cached_results_equal_fresh_ones_many(
    bench: Any, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    check_edits(bench, tmp_path_factory.mktemp("stores"), data)


@pytest.mark.thorough
@pytest.mark.reliability("a node's inputs swapped", "the key changes, always")
@settings(max_examples=80, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    inputs=st.dictionaries(
        st.sampled_from("abcdef"), st.tuples(st.just("Number"), st.sampled_from("01234567")), min_size=2
    ),
    data=st.data(),
)
def test_swapped_inputs_change_the_key(bench: Any, inputs: dict[str, tuple[str, str]], data: st.DataObject) -> None:
    bound = bench.check("nodes: {x: {type: toy.const}}").nodes["x"]
    a, b = data.draw(st.permutations(sorted(inputs)))[:2]
    assume(inputs[a] != inputs[b])
    swapped = inputs | {a: inputs[b], b: inputs[a]}

    def key(pairs: dict[str, tuple[str, str]]) -> str:
        return key_of(preimage_of(bound, "c" * 64, {}, pairs))

    assert key(inputs) != key(swapped)
    assert key(inputs) == key(dict(reversed(inputs.items())))


@pytest.mark.thorough
@pytest.mark.reliability("two inputs of any node of a random graph swapped",
                         "it is a hit only where both inputs have the same bytes")  # fmt: skip
@FEW
@given(data=st.data())
def test_swaps_in_graphs(bench: Any, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    nodes = data.draw(graphs())
    both = [name for name, node in nodes.items() if {"a", "b"} <= node.keys()]
    assume(both)
    store = tmp_path_factory.mktemp("store")
    rows = run_in(bench, text_of(nodes), store)
    name = data.draw(st.sampled_from(both))
    swapped = {n: dict(node) for n, node in nodes.items()}
    swapped[name] = nodes[name] | {"a": nodes[name]["b"], "b": nodes[name]["a"]}
    digests = [next(iter(rows[above]["outputs"].values())) for above in links(nodes[name]).values()]
    steps = {step.name: step for step in plan(bench.check(text_of(swapped)), Store(store))}
    assert (steps[name].key == rows[name]["key"]) == (digests[0] == digests[1])


@pytest.mark.thorough
@pytest.mark.reliability("keys of a graph file in any order, values in any spelling", "every key stays the same")
@FEW
@given(nodes=graphs(), seed=st.integers(0, 2**32))
def test_yaml_order_and_spelling_never_matter(
    bench: Any, tmp_path_factory: pytest.TempPathFactory, nodes: Nodes, seed: int
) -> None:
    store = tmp_path_factory.mktemp("store")
    rows = run_in(bench, text_of(nodes), store)
    for text in (text_of(nodes, random.Random(seed)), text_of(nodes, random.Random(seed + 1))):
        steps = plan(bench.check(text), Store(store))
        assert {step.name: (step.state, step.key) for step in steps} == {n: ("hit", r["key"]) for n, r in rows.items()}


SCALARS = st.one_of(st.none(), st.booleans(), st.integers(), st.floats(allow_nan=False), st.text(max_size=5))
VALUES = st.recursive(
    SCALARS,
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3) | st.just("~float"), inner, max_size=3)
    ),
    max_leaves=8,
)


def same(a: Any, b: Any) -> bool:
    """Equality that tells 1 from 1.0 from True and 0.0 from -0.0."""
    if type(a) is not type(b):
        return False
    if isinstance(a, float):
        return a == b and math.copysign(1, a) == math.copysign(1, b)
    if isinstance(a, list):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    return bool(a == b)


@pytest.mark.reliability("any two different parameter values", "different texts under the key, equal ones the same")
@settings(max_examples=120, deadline=None)
@given(a=VALUES, b=VALUES)
def test_canonical_text_is_one_to_one(a: Any, b: Any) -> None:
    assert (canonical(a) == canonical(b)) == same(a, b)


@pytest.mark.parametrize(
    ("a", "b"),
    [(1, 1.0), (1, True), (0, False), (0.0, -0.0), ("1", 1), ([[]], []), ({"~float": "0x1p+0"}, 1.0), ({"": None}, {})],
)
def test_canonical_text_of_near_misses(a: Any, b: Any) -> None:
    assert canonical(a) != canonical(b)
