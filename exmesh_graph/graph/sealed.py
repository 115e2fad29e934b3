"""Records that begin with their own checksum, and memos: tables of them that only save work."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from exmesh_graph.files import sha256_file, write_durably

_USED = 600.0  # seconds that a note of use may be old
_RACY = 2_000_000_000  # ns: a file changed this recently may change again without a new time stamp
_SEAL = '{"checksum": "'


def seal_text(record: Mapping[str, Any]) -> str:
    """JSON of `record` in one line, which begins with the sha256 of the rest."""
    body = json.dumps(record, sort_keys=True, allow_nan=False)[1:] + "\n"
    return f'{_SEAL}{hashlib.sha256(body.encode()).hexdigest()}", {body}'


def unseal(text: str) -> dict[str, Any]:
    """What `seal_text` wrote. Raises ValueError when anything in it was changed."""
    start = len(_SEAL) + 64
    body = text[start + 3 :]
    digest = hashlib.sha256(body.encode("utf-8", "surrogatepass")).hexdigest()
    if text[: start + 3] != f'{_SEAL}{digest}", ':
        raise ValueError("the record's checksum does not fit")
    return dict(json.loads("{" + body))


def read_sealed(path: str | Path, *, use: bool = False) -> dict[str, Any]:
    """The sealed record in a file; `use` notes by the file's time that it was used. Raises OSError or ValueError."""
    with open(path, encoding="utf-8") as file:
        record = unseal(file.read())
        if use and time.time() - os.fstat(file.fileno()).st_mtime > _USED:
            with contextlib.suppress(OSError):  # by its handle: also a file that `gc` is moving away shows the use
                os.utime(file.fileno())
        return record


class Memo:
    """A sealed JSON table that only saves work: where it is missing or broken it starts empty, and no text in it is
    believed for anything but the bytes that it is keyed by."""

    def __init__(self, path: Path, work: Path) -> None:
        self.path, self.work = path, work
        self.changed = False

    @functools.cached_property
    def known(self) -> dict[str, Any]:
        with contextlib.suppress(OSError, ValueError):
            return read_sealed(self.path)
        return {}

    def put(self, key: str, value: Any) -> None:
        self.known[key] = value
        self.changed = True

    def save(self) -> None:
        """Keep the table for the next process; a store that cannot be written does without."""
        if self.changed:
            with contextlib.suppress(OSError):
                write_durably(self.path, seal_text(self.known), self.work)
            self.changed = False


class SourceDigests(Memo):
    """Digests of source files, remembered by (device, inode, size, mtime, ctime) so that each is read once."""

    def digest(self, path: Path) -> str:
        """sha256 of the file's present contents."""
        status = path.stat()
        times = f"{status.st_mtime_ns}:{status.st_ctime_ns}"
        key = f"{status.st_dev}:{status.st_ino}:{status.st_size}:{times}"
        if key not in self.known:
            value = sha256_file(path)
            if time.time_ns() - max(status.st_mtime_ns, status.st_ctime_ns) < _RACY:
                return value
            self.put(key, value)
        return str(self.known[key])
