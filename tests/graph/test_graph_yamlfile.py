"""Loader pitfalls: what other YAML loaders read wrongly, and what a graph file must not do."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from exmesh_graph.graph.language.yamlfile import Map, load_yaml, parse_yaml
from exmesh_graph.graph.problems import GraphErrors


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 0.001),
        ("1E5", 1e5),
        ("-2.5e+3", -2500.0),
        ("no", "no"),
        ("yes", "yes"),
        ("on", "on"),
        ("12:30", "12:30"),
        ("2026-11-21", "2026-11-21"),
        ("0x1F", 31),
        ("0o17", 15),
        ("010", 10),
        ("true", True),
        ("null", None),
        ("~", None),
        ("''", ""),
        ("-.inf", -math.inf),
        ("[1, 2.0, a]", [1, 2.0, "a"]),
        ("1.0", 1.0),
        ("'1.0'", "1.0"),
        ("1_000", 1000),
    ],
)
def test_scalar(text: str, value: object) -> None:
    found = parse_yaml(text, None)
    assert found == value
    assert type(found) is type(value)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_floats_survive(number: float) -> None:
    assert parse_yaml(repr(number), None) == number


def test_lines_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "g.yaml"
    path.write_text("name: x\nnodes:\n  a: {type: t,\n      value: 3}\n")
    tree = load_yaml(path)
    entry = tree["nodes"]["a"]
    assert isinstance(entry, Map)
    assert tree["nodes"].lines["a"].line == 3
    assert entry.lines["value"].line == 4
    assert str(entry.lines["value"]).endswith("g.yaml:4")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: 1\nb: 2\na: 3", "3: [duplicate-key] 'a' is given twice (first in line 1)"),
        ("a: {x: 1, x: 2}", "'x' is given twice"),
        ("a: !!python/object/apply:os.system [ls]", "is not allowed"),
        ("a: !run ls", "is not allowed"),
        ("a: !!binary aGk=", "is not allowed"),
        ("a: &x [*x]", "contains itself"),
        ("a: [1", "not YAML"),
        ("a: 1\n---\nb: 2", "not YAML"),
        ("true: 1", "a key must be"),
        ("[1, 2]: 3", "a key must be"),
        ("a: *nowhere", "not YAML"),
        ("x: 1\na: @b.c", 'fix: links are quoted: "@node.port"'),
    ],
)
def test_refused(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "g.yaml"
    path.write_text(text)
    with pytest.raises(GraphErrors) as caught:
        load_yaml(path)
    assert words in str(caught.value)
    assert "g.yaml:" in str(caught.value)


def test_alias_bomb_is_bounded(tmp_path: Path) -> None:
    lines = ["l0: &l0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"l{i}: &l{i} [{', '.join([f'*l{i - 1}'] * 10)}]" for i in range(1, 12)]
    path = tmp_path / "bomb.yaml"
    path.write_text("\n".join(lines))
    with pytest.raises(GraphErrors, match="values"):
        load_yaml(path)


def test_merge_keys_do_not_override() -> None:
    value = parse_yaml("base: &b {x: 1, y: 2}\nuse: {<<: *b, y: 3}", None)
    assert value["use"] == {"x": 1, "y": 3}


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(GraphErrors, match="no such graph file"):
        load_yaml(tmp_path / "none.yaml")
