"""The memory of parsed graph files: what it gives back is what the parser gives, lines included."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.graph.declare.packs import current
from exmesh_graph.graph.language import yamlfile
from exmesh_graph.graph.language.yamlfile import Map, Reader, load_yaml, parse_yaml
from exmesh_graph.graph.problems import GraphErrors
from exmesh_graph.graph.sealed import Memo

TEXT = """
name: x   # a comment
params: &p {a: 1, b: 2.5, c: null, d: [1, {e: true}, []], f: "1", 7: seven, g: -0.0, h: 1e-3}
nodes:
  one: {type: t,
        value: "@a.b"}
  two: {<<: *p, a: 3}
"""


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(yamlfile, "SHORT", 0)
    yield
    current().part(Reader).memo = None


def told(value: Any) -> Any:
    """A tree with the types, order, files and lines of everything."""
    if isinstance(value, Map):
        return ("map", value.where, [(k, type(k), value.lines[k], told(v)) for k, v in value.items()])
    if isinstance(value, list):
        return [told(item) for item in value]
    return type(value), repr(value)


def refuse(text: str, file: Path | None) -> Any:
    pytest.fail("parsed again")


def reader(memo: Memo) -> Reader:
    made = Reader()
    made.memo = memo
    return made


def memo_in(tmp_path: Path) -> Memo:
    return Memo(tmp_path / "graphs.json", tmp_path / "work")


def test_the_same_tree_with_the_same_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    memo = memo_in(tmp_path)
    first = reader(memo).read(TEXT, Path("a.yaml"))
    memo.save()
    monkeypatch.setattr(yamlfile, "parse_yaml", refuse)
    for name in ("a.yaml", "b.yaml"):
        again = reader(memo_in(tmp_path)).read(TEXT, Path(name))
        assert told(again) == told(parse_yaml(TEXT, Path(name)))
    assert told(first) == told(parse_yaml(TEXT, Path("a.yaml")))


def test_another_text_is_another_tree(tmp_path: Path) -> None:
    memo = memo_in(tmp_path)
    read = reader(memo).read
    read(TEXT, None)
    assert read(TEXT.replace("2.5", "2.6"), None)["params"]["b"] == 2.6
    with pytest.raises(GraphErrors, match="given twice"):
        read(TEXT + "name: y\n", None)
    with pytest.raises(GraphErrors, match="given twice"):
        read(TEXT + "name: y\n", None)


def test_what_json_cannot_hold_is_parsed_again(tmp_path: Path) -> None:
    memo = memo_in(tmp_path)
    for text in ("a: [1, .inf]", "a: {b: .nan}"):
        reader(memo).read(text, None)
    memo.save()
    assert memo.known == {}


def test_few_are_kept_and_spoilt_ones_are_forgotten(tmp_path: Path) -> None:
    memo = memo_in(tmp_path)
    for number in range(yamlfile.MOST + 3):
        reader(memo).read(TEXT + f"# {number}", None)
    assert len(memo.known) == yamlfile.MOST
    memo.save()
    memo.path.write_text(memo.path.read_text().replace("seven", "eight"))
    again = reader(memo_in(tmp_path)).read(TEXT + f"# {number}", None)
    assert again["params"][7] == "seven"


def test_load_yaml_uses_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "g.yaml"
    path.write_text(TEXT)
    memo = memo_in(tmp_path)
    current().part(Reader).memo = memo
    first = load_yaml(path)
    monkeypatch.setattr(yamlfile, "parse_yaml", refuse)
    assert told(load_yaml(path)) == told(first)
