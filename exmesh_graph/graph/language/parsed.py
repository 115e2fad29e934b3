"""Graph files that were parsed before, by their text: parsing takes 0.2 ms a line, reading the result back a tenth."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from exmesh_graph.graph.declare.packs import library_version
from exmesh_graph.graph.files import Memo
from exmesh_graph.graph.language.yamlfile import Map
from exmesh_graph.graph.problems import Where

SHORT, MOST = 4096, 8  # shorter texts are parsed; so many parsed ones are kept


def remembered(memo: Memo, parse: Callable[[str, Path | None], Any]) -> Callable[[str, Path | None], Any]:
    """`parse`, but for a text whose tree is in the memo. The tree is that of exactly this text and this parser."""

    def read(text: str, file: Path | None) -> Any:
        if len(text) < SHORT:
            return parse(text, file)
        key = hashlib.sha256(f"{_reader()}\n{text}".encode("utf-8", "surrogatepass")).hexdigest()
        if key not in memo.known:
            value = parse(text, file)
            with contextlib.suppress(ValueError):
                packed = _packed(value)
                for old in list(memo.known)[: max(0, len(memo.known) - MOST + 1)]:
                    del memo.known[old]
                memo.put(key, packed)
            return value
        return _unpacked(memo.known[key], file)

    return read


@functools.cache
def _reader() -> str:
    here = Path(__file__)
    texts = [path.read_bytes() for path in (here, here.with_name("yamlfile.py"))]
    return f"{hashlib.sha256(b''.join(texts)).hexdigest()} {library_version('ruamel.yaml')}"


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
