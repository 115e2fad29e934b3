"""Artifacts of the store that were looked at lately, and single arrays of large ones without the rest."""

from __future__ import annotations

import re
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

from exmesh_graph.errors import ExmeshError, StoreError
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.declare.ports import artifact_types
from exmesh_graph.types import ArrayArtifact, Artifact
from exmesh_graph.types.pictures import Pictures

_DIGEST = re.compile(r"[0-9a-f]{8,128}\Z")
_KEPT_BYTES = 768 << 20
_MADE_BYTES = 256 << 20


def is_digest(text: str) -> bool:
    """Whether a text can name an artifact."""
    return bool(_DIGEST.match(text))


class NoArtifact(ExmeshError):
    """An artifact that is not in the store."""

    code = "unknown"


class Shelf:
    """Reads artifacts of a store, checked, and keeps the last of them; and what was made of them, likewise."""

    def __init__(self, store: Callable[[], Store]) -> None:
        self._open = store
        self._values: OrderedDict[str, tuple[int, Artifact]] = OrderedDict()
        self._made: OrderedDict[Hashable, bytes] = OrderedDict()
        self._lock = threading.Lock()
        self._gates: WeakValueDictionary[Hashable, threading.Lock] = WeakValueDictionary()
        # Of heavy work at once: the runs need the machine, too. What is made may read a value, but not the other way.
        self._making, self._reading = threading.BoundedSemaphore(2), threading.BoundedSemaphore(2)
        self._store: Store | None = None

    @property
    def store(self) -> Store:
        if self._store is None:
            self._store = self._open()
        return self._store

    def kind(self, digest: str) -> type[Artifact]:
        """The wire type of an artifact. Raises NoArtifact."""
        name = self.store.type_of(digest) if is_digest(digest) else None
        kind = None if name is None else artifact_types().get(name)
        if kind is None:
            why = "is not in the store" if name is None else f"is of the type {name}, which no node pack defines"
            raise NoArtifact(f"the artifact {digest[:16]!r} {why}", fix="run the graph again: it is made anew")
        return kind

    def value(self, digest: str) -> Artifact:
        """An artifact, its bytes checked when it was read. Raises NoArtifact, StoreError."""
        kind = self.kind(digest)
        with self._gate(digest):  # pages ask for several looks at one thing at once
            with self._lock:
                if digest in self._values:
                    self._values.move_to_end(digest)
                    return self._values[digest][1]
            with self._reading:
                value = self._read(kind, digest)
            with self._lock:
                self._values[digest] = self.size(digest), value
                while len(self._values) > 1 and sum(size for size, _ in self._values.values()) > _KEPT_BYTES:
                    self._values.popitem(last=False)
            return value

    def outline(self, digest: str) -> tuple[Mapping[str, tuple[int, ...]], Mapping[str, Any]]:
        """The shapes of an artifact's arrays and its other fields: without its arrays where these need not be read."""
        if getattr(self.kind(digest), "save", None) is ArrayArtifact.save:
            arrays = self.arrays(digest)
            return arrays.shapes(), arrays.meta()
        fields = vars(self.value(digest))
        return {name: value.shape for name, value in fields.items() if hasattr(value, "shape")}, fields

    def size(self, digest: str) -> int:
        """Bytes of its files."""
        folder = self.store.data(digest)
        return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())

    def made(self, key: Hashable, make: Callable[[], bytes]) -> bytes:
        """What `make` gives, made once for each key and kept for a while."""
        with self._gate(("made", key)):
            with self._lock:
                if key in self._made:
                    self._made.move_to_end(key)
                    return self._made[key]
            with self._making:
                data = make()
            with self._lock:
                self._made[key] = data
                while len(self._made) > 1 and sum(map(len, self._made.values())) > _MADE_BYTES:
                    self._made.popitem(last=False)
            return data

    def arrays(self, digest: str) -> Arrays:
        """The arrays of an artifact that consists of such, each read when it is asked for. Raises NoArtifact."""
        if not is_digest(digest) or not self.store.holds(digest):
            raise NoArtifact(f"the artifact {digest[:16]!r} is not whole", fix="run the graph again")
        return Arrays(self.store.data(digest))

    def _gate(self, key: Hashable) -> threading.Lock:
        """What whoever wants the same thing waits at, so that it is read or made once."""
        with self._lock:
            return self._gates.setdefault(key, threading.Lock())

    def _read(self, kind: type[Artifact], digest: str) -> Artifact:
        """An artifact; its bytes are checked while they are read, and nothing is given before that is done."""
        with ThreadPoolExecutor(1) as beside:
            checking = beside.submit(self.store.sound, digest)
            try:
                value, fault = kind.load(self.store.data(digest)), None
            except Exception as error:  # of the libraries that read it
                value, fault = None, error
            sound = checking.result()
        if sound and value is not None:
            return value
        reason = f"{kind.type_name} cannot be read: {fault}"
        if sound:
            self.store.quarantine(self.store.data(digest).parent, reason)
        raise StoreError(self.store.notes[-1] if self.store.notes else reason, where=str(self.store.root),
                         fix="run the graph again: what is missing is made anew")  # fmt: skip


class Arrays:
    """`arrays.safetensors` of an artifact: shapes, single rows, whole arrays. Files are complete, bytes not checked:
    a look at one of a thousand pictures must not read all of them.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def meta(self) -> dict[str, Any]:
        import json

        return dict(json.loads((self.folder / "meta.json").read_text(encoding="utf-8")))

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """{name: shape} of all arrays."""
        from safetensors import safe_open

        with safe_open(self.folder / "arrays.safetensors", "numpy") as file:
            found = {name: tuple(file.get_slice(name).get_shape()) for name in file.keys()}  # noqa: SIM118
        for name in ("images", "alpha"):
            if (self.folder / name).is_dir():
                found[name] = tuple(Pictures.load(self.folder / name).shape)
        return found

    def row(self, name: str, index: int) -> Any:
        """One row of an array; IndexError where there is none."""
        from safetensors import safe_open

        if (self.folder / name).is_dir():
            return Pictures.load(self.folder / name)[index]
        with safe_open(self.folder / "arrays.safetensors", "numpy") as file:
            part = file.get_slice(name)
            if not 0 <= index < part.get_shape()[0]:
                raise IndexError(index)
            return part[index]

    def whole(self, name: str) -> Any:
        from safetensors import safe_open

        with safe_open(self.folder / "arrays.safetensors", "numpy") as file:
            return file.get_tensor(name)
