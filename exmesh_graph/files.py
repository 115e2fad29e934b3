"""Careful file operations: digests, durable writes, locks, folders of one's own, sizes, files that grow."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import os
import shutil
import stat
import time
from collections.abc import Iterator
from pathlib import Path

from exmesh_graph.errors import StoreError

_DENIED = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO, errno.EEXIST)
_BLOCK = 1 << 20  # bytes


def sha256_file(path: Path) -> str:
    """sha256 of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sync(path: Path) -> None:
    """Force a file to the disk. (Folders are not: a lost rename is only a miss.)"""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_durably(path: Path, text: str, work: Path) -> None:
    """Replace `path` by `text` in one step: written below `work` (same file system), synced, renamed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with own_folder(work) as folder:
        draft = folder / path.name
        draft.write_text(text, encoding="utf-8")
        sync(draft)
        os.replace(draft, path)


@contextlib.contextmanager
def writing(what: str, place: Path, option: str) -> Iterator[None]:
    """Say which folder is full or read-only, and the option that names another."""
    try:
        yield
    except Exception as error:
        denied = isinstance(error, OSError) and error.errno in _DENIED  # safetensors has an error of its own
        if not denied and type(error).__name__ != "SafetensorError":
            raise
        reason = getattr(error, "strerror", None) or str(error)
        fix = f"make room there or allow writing, or take another folder with {option}; then run the same again"
        raise StoreError(f"{what} cannot be written: {reason}", where=str(place), fix=fix) from error


def walk_files(folder: Path) -> list[tuple[str, Path]]:
    """(relative name with /, path) of all files below `folder`, sorted by name."""
    return [(name, folder / name) for name in sorted(sizes(folder))]


def copy_files(source: Path, target: Path) -> None:
    """Copy the files below a folder into another; not by copytree, which hides the reason of a failure."""
    target.mkdir(parents=True, exist_ok=True)
    for name, path in walk_files(source):
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, target / name)


def sizes(folder: str | Path, prefix: str = "") -> dict[str, int]:
    """{relative name with /: bytes} of everything below `folder` that is not a folder; links are not followed."""
    listed = {}
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                listed.update(sizes(entry.path, f"{prefix}{entry.name}/"))
            else:
                listed[prefix + entry.name] = entry.stat(follow_symlinks=False).st_size
    return listed


def allocated(path: str | Path, status: os.stat_result | None = None) -> int:
    """The bytes that a file, or a folder with all in it, takes on the disk."""
    status = status or os.stat(path, follow_symlinks=False)
    size = 512 * status.st_blocks
    if stat.S_ISDIR(status.st_mode):
        with os.scandir(path) as entries:
            for entry in entries:
                own = entry.stat(follow_symlinks=False)
                size += allocated(entry.path, own) if stat.S_ISDIR(own.st_mode) else 512 * own.st_blocks
    return size


class Tail:
    """The whole lines that a growing file has gained since the last look; one without an end comes in pieces."""

    def __init__(self, path: Path) -> None:
        self.path, self.place, self.rest = path, 0, b""

    def lines(self) -> Iterator[str]:
        with contextlib.suppress(FileNotFoundError), self.path.open("rb") as file:
            if os.fstat(file.fileno()).st_size < self.place:  # another file by now
                self.place, self.rest = 0, b""
            file.seek(self.place)
            while data := file.read(_BLOCK):
                self.place += len(data)
                *whole, self.rest = (self.rest + data).split(b"\n")
                if len(self.rest) > _BLOCK:
                    whole, self.rest = [*whole, self.rest], b""
                yield from (line.decode(errors="replace") for line in whole)


@contextlib.contextmanager
def own_folder(parent: Path) -> Iterator[Path]:
    """A fresh folder below `parent`, locked while this process lives, and removed in the end."""
    handle = None
    while handle is None:  # taken only if a sweep came between making and locking the folder
        folder = parent / f"{os.getpid()}-{time.time_ns()}"
        folder.mkdir(parents=True)
        with contextlib.suppress(FileNotFoundError):
            handle = lock(folder / "lock")
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(handle)


def sweep_abandoned(parent: Path) -> None:
    """Remove the folders of `own_folder` whose process is gone (its lock died with it)."""
    for entry in parent.iterdir() if parent.is_dir() else ():
        with contextlib.suppress(OSError):
            age = time.time() - entry.stat().st_mtime
            if age < 5 and not (entry / "lock").exists():
                continue  # being made right now
            handle = lock(entry / "lock")
            if handle is not None:
                shutil.rmtree(entry, ignore_errors=True)
                os.close(handle)


def lock(path: Path, make: bool = True) -> int | None:
    """A handle of the file, locked until it is closed or the process ends; None where another one holds the lock.

    Raises OSError where the file is not there and not to be made, or where there are no locks.
    """
    handle = os.open(path, os.O_RDWR | (os.O_CREAT if make else 0), 0o644)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.path.samestat(os.stat(path), os.fstat(handle)):  # else removed between open and lock
            return handle
    except (BlockingIOError, FileNotFoundError):
        pass
    except OSError:
        os.close(handle)
        raise
    os.close(handle)
    return None


def unlock(path: Path, handle: int) -> None:
    """Remove a file that `lock` locked, and let go of it."""
    with contextlib.suppress(OSError):
        path.unlink()
    os.close(handle)


def is_locked(path: Path) -> bool:
    """Whether a living process holds the lock of a file."""
    with contextlib.suppress(OSError):
        handle = lock(path, make=False)
        if handle is None:
            return True
        os.close(handle)
    return False
