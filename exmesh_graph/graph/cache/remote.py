"""A second tier behind the store: records and objects in a folder that machines share, reached by fsspec.

The same layout as the local store. What is missing locally is fetched, and every byte is verified before it becomes
visible; results are pushed in the background once they are recorded. Nothing half-sent is ever believed: an object's
note follows its files and the record follows its objects, readers verify all of it, and where the file system can
rename (a mounted folder), files appear whole. The first failure turns the tier off for this process, with one note.
"""

from __future__ import annotations

import contextlib
import re
import uuid
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, TypeVar

from exmesh_graph import files
from exmesh_graph.errors import MissingLibraryError, StoreError
from exmesh_graph.graph import sealed
from exmesh_graph.graph.cache.keys import Action, sound_action

if TYPE_CHECKING:
    from exmesh_graph.graph.cache.store import Store

T = TypeVar("T")
_SECRET = re.compile(r"//[^/@\s]*@")


class Remote:
    """The shared tier of a local store. `url` is a folder or an fsspec URL (s3://bucket/path, memory://name, ...)."""

    def __init__(self, url: str, store: Store) -> None:
        try:
            import fsspec
        except ImportError:
            fix = "pip install 'exmesh-graph[shared]'"
            raise MissingLibraryError("a shared store needs the library fsspec", fix=fix) from None
        self.url, self.store, self.down = url, store, False
        try:
            self.fs, self.root = fsspec.core.url_to_fs(url)
        except (ImportError, ValueError) as error:
            raise StoreError(f"the shared store cannot be opened: {error}", where=url) from error
        self.renames = "file" in (self.fs.protocol if isinstance(self.fs.protocol, tuple) else (self.fs.protocol,))
        self.broken: set[str] = set()
        self.pool: ThreadPoolExecutor | None = None

    def peek(self, key: str) -> Action | None:
        """The sound record of `key` there, without its objects."""
        return self._guarded(lambda: sound_action(key, self._record(key)))

    def fetch(self, key: str) -> Action | None:
        """Bring a record and its objects into the local store; None where any of it is missing or in doubt."""
        return self._guarded(lambda: self._fetch(key))

    def push(self, key: str) -> None:
        """Send a recorded result, in the background."""
        if not self.down:
            self.pool = self.pool or ThreadPoolExecutor(1, "shared store")
            self.pool.submit(self._guarded, lambda: self._push(key))

    def close(self) -> None:
        """Wait for what is being sent."""
        if self.pool is not None:
            self.pool.shutdown()
            self.pool = None

    def _guarded(self, work: Callable[[], T]) -> T | None:
        if self.down:
            return None
        try:
            return work()
        except StoreError:  # of the local store
            raise
        except Exception as error:  # every file system has errors of its own
            if not self.down:
                self.down = True
                note = f"{self.url} cannot be used; going on without it ({type(error).__name__}: {error})"
                self.store.notes.append("the shared store " + _SECRET.sub("//***@", note))
            return None

    def _fetch(self, key: str) -> Action | None:
        text = self._record(key)
        action = sound_action(key, text)
        if action is None:
            return None
        missing = [digest for digest in action.digests if not self.store.holds(digest)]
        with self.store.attempt() as attempt:
            if not all(self._fetch_object(digest, attempt / digest) for digest in missing):
                return None
            return self.store.take_in(action, text, {digest: attempt / digest for digest in missing})

    def _fetch_object(self, digest: str, draft: Path) -> bool:
        """Bring an object to a work folder, its bytes checked there."""
        place = f"objects/{digest[:2]}/{digest}"
        with contextlib.suppress(ValueError, KeyError, TypeError, FileNotFoundError):
            note = self._read(f"{place}/artifact.json")
            for name in sealed.unseal(note)["files"]:
                if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
                    raise ValueError("it names files outside itself")
                target = draft / "data" / name
                target.parent.mkdir(parents=True, exist_ok=True)
                self.fs.get_file(f"{self.root}/{place}/data/{name}", str(target))
            (draft / "artifact.json").write_text(note, encoding="utf-8")
        if self.store.doubt(digest, draft) is None:
            return True
        self.broken.add(digest)  # sent anew when it has been made again
        return False

    def _push(self, key: str) -> None:
        action = self.store.look_up(key)
        for digest in action.digests if action is not None else ():
            place = f"objects/{digest[:2]}/{digest}"
            if digest in self.broken or not self.fs.exists(f"{self.root}/{place}/artifact.json"):
                home = self.store.data(digest)
                for name, path in files.walk_files(home):
                    self._send(path, f"{place}/data/{name}")
                self._send(home.parent / "artifact.json", f"{place}/artifact.json")
                self.broken.discard(digest)
        if action is not None:
            name = f"actions/{key[:2]}/{key}.json"
            self._send(self.store.root / name, name)

    def _send(self, path: Path, name: str) -> None:
        target = f"{self.root}/{name}"
        self.fs.makedirs(target.rpartition("/")[0], exist_ok=True)
        if not self.renames:
            self.fs.put_file(str(path), target)
            return
        draft = f"{self.root}/drafts/{uuid.uuid4().hex}"
        self.fs.makedirs(f"{self.root}/drafts", exist_ok=True)
        try:
            self.fs.put_file(str(path), draft)
            Path(draft).replace(target)
        except BaseException:
            with contextlib.suppress(OSError):
                Path(draft).unlink()
            raise

    def _record(self, key: str) -> str:
        return self._read(f"actions/{key[:2]}/{key}.json")

    def _read(self, name: str) -> str:
        try:
            data: Any = self.fs.cat_file(f"{self.root}/{name}")
        except FileNotFoundError:
            return ""
        return bytes(data).decode("utf-8", "replace")
