"""YAML 1.2 into plain values that remember their lines.

Only mappings, lists, strings, numbers, booleans and null come out; any other tag is refused, so that a graph file
cannot run code. Duplicate keys are refused. Size, depth and the number of values are bounded, so that no file, and no
alias that multiplies itself, can take more than a few seconds.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import itertools
import math
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeGuard

from exmesh_graph.files import sha256_file
from exmesh_graph.graph.declare.packs import current
from exmesh_graph.graph.problems import Where, fail, nearest
from exmesh_graph.graph.sealed import Memo

MAX_DEPTH = 64
SHORT, MOST = 4096, 8  # shorter texts are always parsed; so many parsed ones are kept
_TAG = "tag:yaml.org,2002:"
_HINTS = {
    "'@'": 'links are quoted: "@node.port"',
    "'\\t'": "indent with blanks, not with tabs",
    "flow mapping": 'in { } and [ ], names with brackets are quoted: {set: "rounds[1].refine.steps", to: 5}',
    "mapping values": "a line above may lack its colon, its quotes or its closing bracket",
}


@dataclass(frozen=True)
class Limits:
    """How large graph files may be and grow, those of strangers too. `EXMESH_LIMITS="nodes=100000 rounds=20000"` raises
    them for files that you trust. `kib` of one file, `values` in it; `rounds` of a block; `blocks` counts all rounds
    and sub-graphs.
    """

    kib: int = 256
    values: int = 100_000
    rounds: int = 1000
    nodes: int = 5000
    blocks: int = 10_000

    @classmethod
    def here(cls) -> Limits:
        """Those of this process. Raises GraphErrors for what `EXMESH_LIMITS` cannot mean."""
        given = os.environ.get("EXMESH_LIMITS", "")
        words = re.findall(r"(\w+)=(\d+)", given)
        if len(words) != len(given.split()) or {name for name, _ in words} - vars(cls()).keys():
            expected = " ".join(f"{name}=NUMBER" for name in vars(cls()))
            fail("limits", Where(None), f"cannot read EXMESH_LIMITS={given!r}", expected=expected)
        return cls(**{name: int(number) for name, number in words})


def raising(name: str) -> str:
    """How a limit is raised."""
    return f"for a file that you trust: EXMESH_LIMITS={name}=NUMBER"


class Map(dict[Any, Any]):
    """A mapping that knows where it, and each of its keys, was written."""

    def __init__(self, where: Where) -> None:
        super().__init__()
        self.where = where
        self.lines: dict[Any, Where] = {}

    def put(self, key: Any, value: Any, where: Where) -> None:
        """Set `key`, remembering where it was written."""
        self[key] = value
        self.lines[key] = where

    def inner(self, key: Any, where: Where) -> Map:
        """The mapping under `key`, made at `where` if there is none."""
        value = self.get(key)
        if not isinstance(value, Map):
            value = Map(where)
            self.put(key, value, where)
        return value

    def copy(self) -> Map:
        """A shallow copy with the same places."""
        other = Map(self.where)
        other.update(self)
        other.lines = dict(self.lines)
        return other


def copied(value: Any, place: Callable[[Where], Where] = lambda where: where) -> Any:
    """A deep copy of plain values, each at `place` of where it stood."""
    if not isinstance(value, Map):
        return [copied(item, place) for item in value] if isinstance(value, list) else value
    other = Map(place(value.where))
    for key, item in value.items():
        other.put(key, copied(item, place), place(value.lines[key]))
    return other


def every(value: Any) -> Iterator[Any]:
    """A value and all that its mappings and lists hold, however deep."""
    todo = [value]
    while todo:
        yield (item := todo.pop())
        todo += item.values() if isinstance(item, dict) else item if isinstance(item, list | tuple) else ()


class Reader:
    """How a session reads texts: by the parser, or out of a memo of what it made of them before.

    Parsing takes 0.2 ms a line, reading the result back a tenth. A tree is that of exactly this text and this parser.
    """

    def __init__(self) -> None:
        self.memo: Memo | None = None

    def read(self, text: str, file: Path | None) -> Any:
        """The plain value of one YAML document."""
        if self.memo is None or len(text) < SHORT:
            return parse_yaml(text, file)
        known = self.memo.known
        key = hashlib.sha256(f"{_parser()}\n{text}".encode("utf-8", "surrogatepass")).hexdigest()
        if key in known:
            return _unpacked(known[key], file)
        value = parse_yaml(text, file)
        with contextlib.suppress(ValueError):
            packed = _packed(value)
            for old in list(known)[: max(0, len(known) - MOST + 1)]:
                del known[old]
            self.memo.put(key, packed)
        return value


@functools.cache
def _parser() -> str:
    return f"{sha256_file(Path(__file__))} {current().library_version('ruamel.yaml')}"


def _packed(value: Any) -> Any:
    """Plain JSON for a tree: {"map": [line, key, its line, item, ...]} for a mapping. ValueError where it cannot be."""
    if isinstance(value, Map):
        items = [(key, value.lines[key].line, _packed(item)) for key, item in value.items()]
        return {"map": [value.where.line, *itertools.chain.from_iterable(items)]}
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{value} is not JSON")
    return [_packed(item) for item in value] if isinstance(value, list) else value


def _unpacked(value: Any, file: Path | None) -> Any:
    if isinstance(value, dict):
        flat = value["map"]
        result = Map(Where(file, flat[0]))
        for index in range(1, len(flat), 3):
            result.put(flat[index], _unpacked(flat[index + 2], file), Where(file, flat[index + 1]))
        return result
    return [_unpacked(item, file) for item in value] if isinstance(value, list) else value


def load_yaml(path: Path) -> Map:
    """Read the graph file `path`. Raises GraphErrors for anything that is not one plain YAML 1.2 mapping."""
    where = Where(path, 1)
    try:
        with path.open("rb") as file:
            raw = file.read(1024 * (most := Limits.here().kib) + 1)
        if len(raw) > 1024 * most:
            fail("file", where, f"a graph file holds at most {most} KiB", fix=f"split it, or {raising('kib')}")
        text = raw.decode("utf-8")
    except FileNotFoundError:
        fail("file", where, "no such graph file", nearest=files_like(path), fix=f"folder: {path.absolute().parent}")
    except (OSError, UnicodeDecodeError) as error:
        fail("file", where, f"cannot read the graph file: {error}", fix="name a text file in UTF-8")
    value = current().part(Reader).read(text, path)
    if not isinstance(value, Map):
        fail("yaml", where, "a graph file is a mapping", expected="name:, nodes:, ...")
    return value


def files_like(path: Path) -> list[str]:
    """Names of graph files beside a path that does not exist, the most similar ones."""
    with contextlib.suppress(OSError):
        names = [other.name for other in itertools.islice(path.parent.glob("*.yaml"), 200) if other.is_file()]
        return nearest(path.name, names)
    return []


def is_whole(value: Any, least: int, most: float = math.inf) -> TypeGuard[int]:
    """Whether a value is a whole number within limits; true and false are none."""
    return isinstance(value, int) and not isinstance(value, bool) and least <= value <= most


def parse_yaml(text: str, file: Path | None) -> Any:
    """The plain value of one YAML document."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError

    directive = re.match(r"(?:\s*(?:#[^\n]*)?\n)*%", text)
    if directive:
        line = text.count("\n", 0, directive.end()) + 1
        fail("yaml", Where(file, line), "a graph file is YAML 1.2 and has no directives", fix="remove the line")
    loader = YAML(typ="safe", pure=True)
    try:
        root = loader.compose(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else 1
        words = str(error.problem or error.context)
        fix = next((hint for sign, hint in _HINTS.items() if sign in f"{words} {error.context}"), "")
        fail("yaml", Where(file, line), f"not YAML: {words}", fix=fix)
    except YAMLError as error:
        fail("yaml", Where(file, 1), f"not YAML: {error}")
    except RecursionError:
        fail("yaml", Where(file, loader.reader.line + 1), f"values nest deeper than {MAX_DEPTH} levels")
    return None if root is None else _Builder(file, loader.constructor).build(root)


_CONTROL = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]"
)  # the last turn the writing round


class _Builder:
    def __init__(self, file: Path | None, plain: Any) -> None:
        self.file, self.plain = file, plain
        self.count, self.most = 0, Limits.here().values
        self.open: set[int] = set()

    def where(self, node: Any) -> Where:
        return Where(self.file, node.start_mark.line + 1)

    def build(self, node: Any) -> Any:
        self.count += 1
        if self.count > self.most:
            fix = f"remove the nested aliases, or {raising('values')}"
            fail("yaml", self.where(node), f"more than {self.most} values", fix=fix)
        kind = type(node).__name__
        if kind == "ScalarNode":
            return self._scalar(node)
        if id(node) in self.open:
            fail("yaml", self.where(node), "an alias contains itself")
        self.open.add(id(node))
        if len(self.open) > MAX_DEPTH:
            fail("yaml", self.where(node), f"values nest deeper than {MAX_DEPTH} levels")
        value: Any
        if kind == "SequenceNode" and _short(node) == "seq":
            value = [self.build(item) for item in node.value]
        elif kind == "MappingNode" and _short(node) == "map":
            value = self._mapping(node)
        else:
            fail("yaml", self.where(node), f"tag {node.tag!s} is not allowed in a graph file")
        self.open.discard(id(node))
        return value

    def _mapping(self, node: Any) -> Map:
        result = Map(self.where(node))
        merged: list[Map] = []
        for key_node, value_node in node.value:
            where = self.where(key_node)
            if _short(key_node) == "merge":
                value = self.build(value_node)
                merged += value if isinstance(value, list) else [value]
                continue
            key = self.build(key_node)
            if isinstance(key, bool) or not isinstance(key, str | int):
                fail("yaml", where, f"a key must be a name or a whole number, not {key!r}")
            if key in result:
                first = result.lines[key].line
                fail("duplicate-key", where, f"{key!r} is given twice (first in line {first})")
            result.put(key, self.build(value_node), where)
        for base in merged:
            if not isinstance(base, Map):
                fail("yaml", self.where(node), "'<<' takes a mapping or a list of mappings")
            for key, value in base.items():
                if key not in result:
                    result.put(key, value, base.lines[key])
        return result

    def _scalar(self, node: Any) -> Any:
        tag = _short(node)
        read = {"bool": self.plain.construct_yaml_bool, "int": self.plain.construct_yaml_int,
                "float": self.plain.construct_yaml_float}.get(tag)  # fmt: skip
        try:
            value = read and read(node)
        except ValueError:
            fail("yaml", self.where(node), f"cannot read the number {node.value[:40]!r}")
        if isinstance(value, int) and value.bit_length() > 64:
            fail("yaml", self.where(node), f"the number {node.value[:40]!r} needs more than 64 bits")
        if read is not None or tag == "null":
            return value
        if _CONTROL.search(node.value):  # they would reach the terminal of whoever is shown a text
            fail("yaml", self.where(node), f"control characters in the text {node.value[:40]!r}", fix="remove them")
        if tag not in ("str", "timestamp", "value"):
            fail("yaml", self.where(node), f"tag {node.tag!s} is not allowed in a graph file")
        return node.value


def _short(node: Any) -> str:
    tag = str(node.tag)
    return tag[len(_TAG) :] if tag.startswith(_TAG) else tag
