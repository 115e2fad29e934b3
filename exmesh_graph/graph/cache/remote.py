"""A second tier behind the store: records and objects in a folder that machines share, reached by fsspec.

The same layout as the local store. What is missing locally is fetched, and every byte is verified before it becomes
visible; results are pushed in the background once they are recorded. Nothing half-sent is ever believed: an object's
note follows its files and the record follows its objects, readers verify all of it, and where the file system can
rename (a mounted folder), files appear whole. The first failure turns the tier off for this process, with one note; one
that may only be read, such as a mirror on a web server, goes on serving. Nothing larger, and nothing slower, than
`EXMESH_SHARED_LIMITS` allows is taken.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import multiprocessing
import os
import re
import uuid
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.pool import ThreadPool
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
_REFUSED = (errno.EROFS, errno.EACCES, errno.EPERM, 401, 403, 405, 501)  # of a system, of a web server
_BLOCK = 1 << 20  # bytes
LIMITS = {"gb": 32.0, "seconds": 900.0}  # of an object, of each file


class Remote:
    """The shared tier of a local store. `url` is a folder or an fsspec URL (s3://bucket/path, memory://name, ...)."""

    def __init__(self, url: str, store: Store) -> None:
        try:
            import fsspec
        except ImportError:
            fix = "pip install 'exmesh-graph[shared]'"
            raise MissingLibraryError("a shared store needs the library fsspec", fix=fix) from None
        self.url, self.store, self.down, self.sends = url, store, False, True
        self.limits = _limits(os.environ.get("EXMESH_SHARED_LIMITS", ""))
        try:
            self.fs, self.root = fsspec.core.url_to_fs(url)
        except (ImportError, ValueError) as error:
            raise StoreError(f"the shared store cannot be opened: {error}", where=url) from error
        self.renames = "file" in (self.fs.protocol if isinstance(self.fs.protocol, tuple) else (self.fs.protocol,))
        self.broken: set[str] = set()
        self.pool: ThreadPoolExecutor | None = None
        self.calls = ThreadPool(2)  # of daemon threads, for the run and for what is sent beside it

    def peek(self, key: str) -> Action | None:
        """The sound record of `key` there, without its objects."""
        return self._guarded(lambda: sound_action(key, self._record(key)))

    def fetch(self, key: str) -> Action | None:
        """Bring a record and its objects into the local store; None where any of it is missing or in doubt."""
        return self._guarded(lambda: self.bring(key))

    def push(self, key: str) -> None:
        """Send a recorded result, in the background."""
        if not self.down and self.sends:
            self.pool = self.pool or ThreadPoolExecutor(1, "shared store")
            self.pool.submit(self._guarded, lambda: self.send(key))

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
            refused = {getattr(error, "errno", 0), getattr(error, "status", 0)} & {*_REFUSED}
            if refused or isinstance(error, PermissionError | NotImplementedError):
                fate, told, self.sends = "written; its results are used, none are sent", not self.sends, False
            else:
                fate, told, self.down = "used; going on without it", self.down, True
            if not told:
                note = f"the shared store {self.url} cannot be {fate} ({type(error).__name__}: {error})"
                self.store.notes.append(hidden(note))
            return None

    def bring(self, key: str) -> Action | None:
        """As `fetch`, but raises what the file system raises."""
        text = self._record(key)
        action = sound_action(key, text)
        if action is None:
            return None
        missing = [digest for digest in action.digests if not self.store.holds(digest)]
        with self.store.attempt() as attempt:
            if not all(self._fetch_object(digest, attempt / digest) for digest in missing):
                return None
            return self.store.take_in(action, text, {digest: attempt / digest for digest in missing})

    def bring_object(self, digest: str) -> bool:
        """Bring an object that no record names."""
        with self.store.attempt() as attempt:
            found = self._fetch_object(digest, attempt / digest)
            if found:
                self.store.take_in(None, "", {digest: attempt / digest})
        return found

    def names(self, folder: str) -> list[str]:
        """The names of the files in a folder there, sorted."""
        with contextlib.suppress(FileNotFoundError):
            listed = self._in_time(lambda: self.fs.ls(f"{self.root}/{folder}", detail=False))
            return sorted(str(name).rstrip("/").rpartition("/")[2] for name in listed)
        return []

    def _fetch_object(self, digest: str, draft: Path) -> bool:
        """Bring an object to a work folder, its bytes checked there."""
        place = f"objects/{digest[:2]}/{digest}"
        with contextlib.suppress(ValueError, KeyError, TypeError, FileNotFoundError):
            note = self.read(f"{place}/artifact.json")
            table = sealed.unseal(note)["files"]
            if (size := sum(size for size, _ in table.values())) > self.limits["gb"] * 1e9:
                what = (
                    f"{size / 1e9:.1f} GB are more than {self.limits['gb']:g}; EXMESH_SHARED_LIMITS=gb=NUMBER takes it"
                )
                self.store.notes.append(f"the object {digest[:12]} of the shared store is left there: {what}")
                return False
            for name, (size, _) in table.items():
                if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
                    raise ValueError("it names files outside itself")
                target = draft / "data" / name
                target.parent.mkdir(parents=True, exist_ok=True)
                self._in_time(functools.partial(self._bring, f"{place}/data/{name}", target, size))
            (draft / "artifact.json").write_text(note, encoding="utf-8")
        if self.store.doubt(digest, draft) is None:
            return True
        self.broken.add(digest)  # sent anew when it has been made again
        return False

    def _bring(self, name: str, target: Path, size: int) -> None:
        """A file, as far as its object's note says that it goes, and a byte more where it goes further."""
        with self.fs.open(f"{self.root}/{name}", "rb") as source, target.open("wb") as file:
            while file.tell() <= size and (data := source.read(min(_BLOCK, size + 1 - file.tell()))):
                file.write(data)

    def send(self, key: str) -> None:
        """Send a result; what is there is not sent again. Raises what the file system raises."""
        action = self.store.look_up(key)
        for digest in action.digests if action is not None else ():
            self.send_object(digest)
        if action is not None:
            name = f"actions/{key[:2]}/{key}.json"
            self.send_file(self.store.root / name, name)

    def send_object(self, digest: str) -> None:
        """Send an object, its note last."""
        place = f"objects/{digest[:2]}/{digest}"
        if digest in self.broken or not self._in_time(lambda: self.fs.exists(f"{self.root}/{place}/artifact.json")):
            home = self.store.data(digest)
            for name, path in files.walk_files(home):
                self.send_file(path, f"{place}/data/{name}")
            self.send_file(home.parent / "artifact.json", f"{place}/artifact.json")
            self.broken.discard(digest)

    def send_file(self, path: Path, name: str) -> None:
        """Send a file under a name."""
        self._in_time(lambda: self._put(path, name))

    def _put(self, path: Path, name: str) -> None:
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
        return self.read(f"actions/{key[:2]}/{key}.json")

    def read(self, name: str) -> str:
        """The text of a record or note; nothing where there is none."""
        try:
            data: Any = self._in_time(lambda: self.fs.cat_file(f"{self.root}/{name}"))
        except FileNotFoundError:
            return ""
        return bytes(data).decode("utf-8", "replace")

    def _in_time(self, work: Callable[[], T]) -> T:
        """What `work` gives. Raises TimeoutError where it takes too long: the thread of a call that hangs is left."""
        try:
            return self.calls.apply_async(work).get(self.limits["seconds"])
        except multiprocessing.TimeoutError:
            raise TimeoutError(f"no answer within {self.limits['seconds']:g} s") from None


def hidden(text: str) -> str:
    """A text without the names and passwords in its addresses."""
    return _SECRET.sub("//***@", text)


def _limits(text: str) -> dict[str, float]:
    """`EXMESH_SHARED_LIMITS="gb=4 seconds=60"` over LIMITS. Raises StoreError."""
    words = re.findall(r"(gb|seconds)=(\d+\.?\d*)(?:\s|$)", text)
    if len(words) != len(text.split()):
        raise StoreError(f"cannot read EXMESH_SHARED_LIMITS={text!r}", expected="gb=NUMBER seconds=NUMBER")
    return LIMITS | {name: float(number) for name, number in words}
