"""What values on wires hold: marks by which a change of them is noticed, and what a copy read back has lost."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import cached_property
from inspect import getattr_static
from types import FunctionType
from typing import Any

from exmesh_graph.files import walk_files
from exmesh_graph.types.artifact import Artifact
from exmesh_graph.types.pictures import Pictures
from exmesh_graph.types.results import Files

_SAMPLES = 4096
_BLOCK = 4096  # bytes
_SEEN = "what came before"


def mark_of(value: Artifact) -> int:
    """A fingerprint at memory speed, to notice what is changed in place, behind numpy's back as well.

    All bytes of the arrays count, and all plain values in dicts, lists, sets and fields. Of the files of an artifact of
    type Files it sees inodes, sizes and times.
    """
    stamps: list[Any] = []
    if isinstance(value, Files):
        with contextlib.suppress(OSError):
            for name, path in walk_files(value.root):
                status = path.stat()
                stamps.append((name, status.st_ino, status.st_size, status.st_mtime_ns))
    return hash((*stamps, *(_summed(item) if _is_array(item) else item for item in _contents(value))))


def losses(value: Artifact, again: Artifact) -> tuple[list[str], bool]:
    """What a value holds and a copy read back from its files does not: arrays and their bytes, plain values.

    And whether the two are alike in all: also in order, kinds of containers and numbers, and how arrays lie in memory.
    """
    pairs = [[*map(_told, _contents(item))] for item in (value, again)]
    ours, theirs = (Counter(loosely for loosely, _ in told) for told in pairs)
    return [text.split("\n")[0] for text in (ours - theirs) if text], pairs[0] == pairs[1]


def _told(item: Any) -> tuple[str, str]:
    """A part of a value in words that are equal for equal contents, lists and tuples not told apart; and strictly."""
    if _is_array(item):
        text = f"{item.dtype} {list(item.shape)}\n{hashlib.sha256(item.tobytes()).hexdigest()}"
        return text, f"{text} {item.strides} {type(item)}"
    told = isinstance(item, str) and item != _SEEN
    return re.sub(r"np\.\w+\((.*)\)", r"\1", item) if told else "", str(item)


def arrays_of(value: Any) -> list[Any]:
    """All arrays that a value holds."""
    return [item for item in _contents(value) if _is_array(item)]


def _contents(value: Any) -> Iterator[Any]:
    """Arrays as they are, plain values as something that can be hashed, in the order in which they lie.

    Of objects that are no dataclasses what copies of them are made of counts (pictures that are read when they are
    asked for: nothing); of an artifact that is none its attributes do.
    """
    todo: list[Any] = [value]
    seen: dict[int, Any] = {}  # an artifact may hold itself
    while todo:
        item = todo.pop()
        if (
            item is None
            or isinstance(item, str | bytes | bool | int | float | complex)
            or _is_numpys(item, array=False)
        ):
            yield repr(item)  # 1, 1.0 and True differ; nan is nan
        elif isinstance(item, set | frozenset):
            yield tuple(sorted(map(repr, item)))
        elif id(item) in seen:
            yield _SEEN
        elif _is_array(item):
            yield item
        else:
            seen[id(item)] = item
            inside = _inside(item, item is value)
            yield type(item).__qualname__, len(inside)
            todo += reversed(inside)


def _inside(item: Any, top: bool) -> list[Any]:
    """What an object of Python holds, without what it caches."""
    if hasattr(item, "detach") and hasattr(item, "data_ptr"):
        return [item.detach().cpu().numpy()]
    if _is_numpys(item):  # of objects
        return list(item.tolist())
    if isinstance(item, list | tuple):
        return list(item)
    if isinstance(item, Mapping):
        return [part for pair in item.items() for part in pair]
    fields = dataclasses.fields(item) if dataclasses.is_dataclass(item) and not isinstance(item, type) else ()
    if fields or (top and hasattr(item, "__dict__")):
        held, kind = {f.name: getattr(item, f.name) for f in fields} | getattr(item, "__dict__", {}), type(item)
        return [{n: v for n, v in held.items() if not isinstance(getattr_static(kind, n, None), cached_property)}]
    if isinstance(item, Pictures):
        return []
    if isinstance(item, memoryview):
        return [item.tobytes()]
    if isinstance(item, FunctionType):
        return [*(cell.cell_contents for cell in item.__closure__ or ()), *(item.__defaults__ or ())]
    with contextlib.suppress(Exception):  # what cannot be copied has nothing that could be told
        made = item.__reduce_ex__(4)
        return [made] if isinstance(made, str) else [list(p) if isinstance(p, Iterator) else p for p in made[1:]]
    return []


def _is_array(item: Any) -> bool:
    return _is_numpys(item) and not item.dtype.hasobject


def _is_numpys(item: Any, array: bool = True) -> bool:
    """An array of numpy, or one of its numbers; told by what they offer, since this room does without numpy."""
    return hasattr(item, "__array_interface__") and hasattr(item, "__setitem__") is array


def _summed(array: Any) -> bytes:
    """Sums over blocks of 4 KiB and across them, the bytes of the last part block, and some elements as they are."""
    flat = array.reshape(-1)
    flat = flat if flat.flags.c_contiguous else flat.copy()
    data = flat.view("u1")
    whole = data.size // _BLOCK * _BLOCK
    blocks = data[:whole].view("u8").reshape(-1, _BLOCK // 8)
    sums = blocks.sum(axis=1).tobytes() + blocks.sum(axis=0).tobytes()
    return bytes(sums + data[whole:].tobytes() + flat[:: max(1, flat.size // _SAMPLES)].tobytes())
