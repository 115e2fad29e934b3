"""The key: golden values, what must change it and what must not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from exmesh_graph.errors import GraphError
from exmesh_graph.graph.cache.keys import artifact_digest, canonical, digest_of, key_of, preimage_of
from exmesh_graph.graph.declare.packs import current

INPUTS = {"a": ("Number", "1" * 64), "b": ("Number", "2" * 64)}


def key(bench: Any, text: str, node: str = "x", inputs: Any = None, **more: Any) -> str:
    bound = bench.check(text).nodes[node]
    return key_of(preimage_of(bound, more.get("code", "c" * 64), more.get("sources", {}), inputs or {}))


CONST = "nodes: {x: {type: toy.const, value: 0.1, label: ä, threads: 2}}"


def test_golden_key(bench: Any) -> None:
    bound = bench.check(CONST).nodes["x"]
    preimage = preimage_of(bound, "c" * 64, {"f": "d" * 64}, INPUTS)
    text = canonical(["x", 1, 0.1, None, True, {"b": -0.0, "a": "ä"}])
    assert text == ('["x",1,{"~float":"0x1.999999999999ap-4"},null,true,{"a":"\\u00e4","b":{"~float":"-0x0.0p+0"}}]')
    assert preimage == {
        "epoch": 1,
        "type": "toy.const",
        "version": "1",
        "code": "c" * 64,
        "params": {"label": "ä", "value": {"~float": "0x1.999999999999ap-4"}},
        "seed": 0,
        "libraries": {},
        "sources": {"f": "d" * 64},
        "inputs": {"a": ["Number", "1" * 64], "b": ["Number", "2" * 64]},
    }
    assert key_of(preimage) == "1f2b5bc9d96ab66c887a42e3ddc9309f9a3c041a519461241e6d801a14325c80"


def test_golden_artifact_digest() -> None:
    table = {"b.txt": [2, "2" * 64], "a/c.txt": [1, "1" * 64]}
    assert artifact_digest("Number", table) == "9a53632541117bf882c30b9b1aafcaa21d65de87eb29373f74c44f4350b479e6"
    assert artifact_digest("Number", dict(reversed(table.items()))) == artifact_digest("Number", table)
    assert artifact_digest("Whole", table) != artifact_digest("Number", table)


def test_swapped_inputs_change_the_key(bench: Any) -> None:
    text = 'nodes: {o: {type: toy.const}, x: {type: toy.subtract, a: "@o.number", b: "@o.number"}}'
    swapped = {"a": INPUTS["b"], "b": INPUTS["a"]}
    assert key(bench, text, inputs=INPUTS) != key(bench, text, inputs=swapped)
    assert key(bench, text, inputs=INPUTS) == key(bench, text, inputs=dict(reversed(INPUTS.items())))


def test_order_in_the_file_does_not_matter(bench: Any) -> None:
    other = "nodes: {x: {threads: 2, label: ä, value: 0.1, type: toy.const}}"
    assert key(bench, CONST) == key(bench, other)


def test_tuning_name_and_spelling_do_not_matter(bench: Any) -> None:
    assert key(bench, CONST) == key(bench, CONST.replace("threads: 2", "threads: 7"))
    assert key(bench, CONST) == key(bench, CONST.replace("0.1", "1e-1"))
    assert key(bench, CONST) == key(bench, CONST.replace("x:", "y:"), "y")
    assert key(bench, "nodes: {x: {type: toy.const, value: 1}}") == key(bench, "nodes: {x: {type: toy.const}}")


@pytest.mark.parametrize(
    ("old", "new"), [("0.1", "0.10000000000000002"), ("label: ä", "label: a"), ("nodes", "seed: 1\nnodes")]
)
def test_what_changes_the_key(bench: Any, old: str, new: str) -> None:
    assert key(bench, CONST) != key(bench, CONST.replace(old, new))


def test_code_and_sources_change_the_key(bench: Any) -> None:
    assert key(bench, CONST) != key(bench, CONST, code="d" * 64)
    assert key(bench, CONST) != key(bench, CONST, sources={"f": "d" * 64})


def test_versions_of_declared_libraries_change_the_key(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    bound = bench.check(CONST).nodes["x"]
    plain, declared = bound, replace(bound, definition=replace(bound.definition, libraries=("numpy",)))
    keys = {key_of(preimage_of(one, "c", {}, {})) for one in (plain, declared)}
    assert len(keys) == 2
    monkeypatch.setitem(current().versions, "numpy", "0.0.1")
    assert key_of(preimage_of(plain, "c", {}, {})) in keys
    assert key_of(preimage_of(declared, "c", {}, {})) not in keys


def test_paths_stay_out(bench: Any) -> None:
    bench.write("1", "a.txt")
    bench.write("1", "b.txt")
    text = "nodes: {x: {type: toy.file, path: a.txt}}"
    source = {"number": "d" * 64}
    assert key(bench, text, sources=source) == key(bench, text.replace("a.txt", "b.txt"), sources=source)
    bound = bench.check(text).nodes["x"]
    assert str(bench.root) not in canonical(preimage_of(bound, "c", source, {}))


json_like = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=8,
)


def _tagged(value: Any) -> Any:
    """Equality that tells 1 from 1.0 from True, and 0.0 from -0.0."""
    if isinstance(value, list):
        return ("list", tuple(_tagged(v) for v in value))
    if isinstance(value, dict):
        return ("dict", tuple(sorted((k, repr(_tagged(v))) for k, v in value.items())))
    return (type(value).__name__, repr(value))


@given(json_like, json_like)
@example(0.1, 0.1 + 1e-12)
@example({"~float": (1.0).hex()}, 1.0)
@example([["a"], "b"], ["a", ["b"]])
def test_canonical_is_injective(a: Any, b: Any) -> None:
    assert (canonical(a) == canonical(b)) == (_tagged(a) == _tagged(b))


@pytest.mark.parametrize("value", [{"~float": (1.0).hex()}, {"~float": 1.0}, (1.0).hex()])
def test_floats_cannot_be_imitated(value: Any) -> None:
    assert digest_of(value) != digest_of(1.0)


@pytest.mark.parametrize("value", [Path("x"), {1, 2}, b"x", object(), {1: 2}])
def test_unknown_types_are_refused(value: Any) -> None:
    with pytest.raises(GraphError, match="cannot be part of a key"):
        canonical(value)
