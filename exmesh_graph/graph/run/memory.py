"""Artifacts that a process keeps between jobs, and marks by which a change of them is noticed."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import re
from collections import Counter, OrderedDict
from collections.abc import Iterator, Mapping
from functools import cached_property
from inspect import getattr_static
from typing import Any

from exmesh_graph.files import walk_files
from exmesh_graph.types import Artifact, Files

_SAMPLES = 4096
_BLOCK = 4096  # bytes


class Memory:
    """Artifacts by digest, the least recently used dropped beyond `budget` bytes (of their arrays; None: no limit).

    Each has a mark of its bytes: what was changed in place since it was put in, by whichever means, is not given out.
    """

    def __init__(self, budget: int | None = None) -> None:
        self.budget = budget
        self.values: OrderedDict[str, tuple[Artifact, int, int]] = OrderedDict()
        self.bytes = 0

    def get(self, digest: str) -> tuple[Artifact, int] | None:
        """A value and its mark."""
        if digest not in self.values:
            return None
        value, mark, _ = self.values[digest]
        if mark_of(value) != mark:
            self.forget(digest)
            return None
        self.values.move_to_end(digest)
        return value, mark

    def put(self, digest: str, value: Artifact) -> int:
        """Keep a value; its arrays become read-only, since others will read them. Returns its mark."""
        self.forget(digest)
        size, mark = sum(int(array.nbytes) for array in _arrays(value)), mark_of(value)
        self.values[digest] = frozen(value), mark, size
        self.bytes += size
        while self.budget is not None and self.bytes > self.budget:
            self.forget(next(iter(self.values)))
        return mark

    def forget(self, digest: str) -> None:
        if digest in self.values:
            self.bytes -= self.values.pop(digest)[2]


def frozen(value: Any) -> Any:
    """Make the arrays of a dataclass read-only, so that no node changes what another will read."""
    for array in _arrays(value):
        array.flags.writeable = False
    return value


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


def losses(value: Artifact, again: Artifact) -> list[str]:
    """What a value holds and a copy read back from its files does not: arrays and their bytes, plain values."""
    ours, theirs = (Counter(map(_told, _contents(item))) for item in (value, again))
    return [text.split("\n")[0] for text in (ours - theirs) if text]


def _told(item: Any) -> str:
    """A part of a value in words that are equal for equal contents; lists and tuples are not told apart."""
    if _is_array(item):
        return f"{item.dtype} {list(item.shape)}\n{hashlib.sha256(item.tobytes()).hexdigest()}"
    return re.sub(r"np\.\w+\((.*)\)", r"\1", item) if isinstance(item, str) else ""


def _arrays(value: Any) -> list[Any]:
    return [item for item in _contents(value) if _is_array(item)]


def _contents(value: Any) -> Iterator[Any]:
    """Arrays as they are, plain values as something that can be hashed, in the order in which they lie.

    Of objects that are no dataclasses the type counts (pictures that are read when they are asked for, say); of an
    artifact that is none its attributes do.
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
            yield "seen"
        elif _is_array(item):
            yield item
        else:
            seen[id(item)] = item
            inside = _inside(item, item is value)
            yield type(item).__qualname__, len(inside)
            todo += reversed(inside)


def _inside(item: Any, top: bool) -> list[Any]:
    """What an object of Python holds; of no dataclass only where it is the artifact itself, without what it caches."""
    if hasattr(item, "detach") and hasattr(item, "data_ptr"):
        return [item.detach().cpu().numpy()]
    if _is_numpys(item):  # of objects
        return list(item.tolist())
    if isinstance(item, list | tuple):
        return list(item)
    if isinstance(item, Mapping):
        return [part for pair in item.items() for part in pair]
    if dataclasses.is_dataclass(item) and not isinstance(item, type):
        return [getattr(item, field.name) for field in dataclasses.fields(item) if field.compare]
    if not top or not hasattr(item, "__dict__"):
        return []
    kept = {n: v for n, v in vars(item).items() if not isinstance(getattr_static(type(item), n, None), cached_property)}
    return [kept]


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
