"""Pictures too many for memory: kept as codes in files, and decoded one at a time.

A stack of pictures that would take more than `LARGE` bytes as floats is kept as one `.npy` file for each picture: the
8- or 16-bit codes of its source where these determine its values, half or single floats where not. A picture is read
and decoded when it is asked for, into memory of its own, and nothing of it stays. What a code means stands in a table
beside the files (256 or 65 536 floats), so the values are, bit for bit, those that a loader computed from the codes.

Files are read, not mapped: pages of a mapped file count as memory of the process, and a file that is cut short while
it is mapped ends the process.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextvars import ContextVar
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from exmesh_graph.errors import DataError

if TYPE_CHECKING:
    import numpy as np

LARGE = 2 << 30
"""Bytes of float32 pictures and masks from which on a set is kept in files. It decides where values lie, not which."""
_home: ContextVar[Path | None] = ContextVar("exmesh_pictures", default=None)


def too_large(count: int, height: int, width: int) -> bool:
    """Whether `count` pictures and masks of this size go into files."""
    return 16 * count * height * width > LARGE


@contextlib.contextmanager
def kept_in(folder: Path) -> Iterator[None]:
    """Let `PictureFiles` of this block lie in `folder`, which must outlive them."""
    token = _home.set(folder)  # not in the key: where files lie
    try:
        yield
    finally:
        _home.reset(token)


class Pictures:
    """N pictures of one size in files: `stack[i]` decodes one, float32 [H, W, 3] or [H, W], an array of its own.

    `stack[[3, 1]]` and `stack[2:5]` are stacks again, `for picture in stack` decodes one after the other, and
    `np.asarray(stack)` all of them: N H W 4 bytes for each channel. Nothing is cached and nothing can be written.
    """

    def __init__(self, files: Sequence[Path], shape: tuple[int, ...], owner: Any = None) -> None:
        """files: one for each picture, tables beside them; shape: (H, W) or (H, W, 3); owner: kept, as it owns them"""
        self.files, self._owner = tuple(files), owner
        self.shape = (len(self.files), *shape)
        self.ndim = len(self.shape)

    @property
    def dtype(self) -> np.dtype:
        import numpy as np

        return np.dtype(np.float32)

    def __len__(self) -> int:
        return len(self.files)

    def __iter__(self) -> Iterator[np.ndarray]:
        return (self[k] for k in range(len(self)))

    def __getitem__(self, index: Any) -> Any:
        import numpy as np

        if isinstance(index, int | np.integer):
            codes = self.codes(int(index))
            values = decoded(codes, self.table(int(index), codes.dtype) if codes.dtype.kind == "u" else None)
            return values if values.shape == self.shape[1:] else np.broadcast_to(values, self.shape[1:])
        if isinstance(index, slice):
            chosen = self.files[index]
        elif isinstance(index, list | np.ndarray):
            places = np.arange(len(self))[np.asarray(index, None if len(index) else int)]
            chosen = tuple(self.files[int(k)] for k in places)
        else:
            raise IndexError("pictures in files are taken one at a time: pictures[i][rows, columns]")
        return Pictures(chosen, self.shape[1:], self._owner)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        import numpy as np

        if copy is False:
            raise ValueError("pictures in files have no array in memory")
        whole = np.empty(self.shape, np.float32)
        for k, picture in enumerate(self):
            whole[k] = picture
        return whole if dtype is None else whole.astype(dtype, copy=False)

    def codes(self, index: int) -> np.ndarray:
        """A picture as its file holds it, to be made sense of by `table`; [1, 1] where it is the same all over."""
        import numpy as np

        path = self.files[index]
        try:
            return np.load(path, allow_pickle=False)
        except (OSError, ValueError) as error:
            raise DataError(
                f"a picture cannot be read back ({error})", where=str(path), expected="the file that the loader wrote",
                fix="run again; if the store was damaged, `exmesh store verify` finds what is",
            ) from error  # fmt: skip

    def table(self, index: int, dtype: np.dtype) -> np.ndarray:
        """float32, the value of each code of an integer type in a picture."""
        return _table(self.files[index].with_name(f"table{dtype.itemsize}.npy"))

    def joined(self, other: Pictures) -> Pictures:
        """These pictures and then the others, of the same size and kind."""
        if self.shape[1:] != other.shape[1:]:
            raise ValueError(f"pictures of {self.shape[1:]} and {other.shape[1:]} make no stack")
        return Pictures((*self.files, *other.files), self.shape[1:], (self._owner, other._owner))

    def save(self, folder: Path) -> None:
        """Write the stack into a new `folder`: its files are linked where that is possible, else copied."""
        folder.mkdir()
        tables: dict[str, Path] = {}
        for number, file in enumerate(self.files):
            _link(file, folder / f"{number:05d}.npy")
            for table in file.parent.glob("table*.npy"):
                tables.setdefault(table.name, table)
        for name, table in sorted(tables.items()):
            _link(table, folder / name)
        (folder / "stack.json").write_text(json.dumps({"shape": list(self.shape)}) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, folder: Path) -> Self:
        """The stack that `save` wrote."""
        count, *shape = json.loads((folder / "stack.json").read_text(encoding="utf-8"))["shape"]
        found = sum(1 for _ in folder.glob("[0-9]*.npy"))
        if count != found:
            raise DataError(f"the stack tells of {count} pictures and holds {found}", where=str(folder))
        return cls([folder / f"{number:05d}.npy" for number in range(count)], tuple(shape))


@lru_cache(64)
def _table(path: Path) -> np.ndarray:
    import numpy as np

    return np.load(path, allow_pickle=False)


def decoded(codes: np.ndarray, table: np.ndarray | None) -> np.ndarray:
    """float32 values of codes [H, W, C]: the table's, and of four channels three, times the fourth as coverage."""
    import numpy as np

    if table is None:
        return codes.astype(np.float32, copy=False)
    if codes.ndim == 2 or codes.shape[2] < 4:
        return np.take(table, codes)
    coverage = codes[..., 3].astype(np.float32) / np.float32(np.iinfo(codes.dtype).max)
    values = np.take(table, codes[..., :3])
    values *= coverage[..., None]
    return values


class PictureFiles:
    """Where a loader puts pictures, from any thread; `stack` gives them back as Pictures."""

    def __init__(self, shape: tuple[int, ...], tables: Mapping[str, np.ndarray]) -> None:
        """tables  {dtype of the codes: float32 value of each code}"""
        import numpy as np

        home = _home.get()
        self._owner = None if home is not None else _own_folder()
        self.folder = Path(tempfile.mkdtemp(dir=home)) if self._owner is None else Path(self._owner.name)
        _check_space(self.folder, int(np.prod(shape)))
        self.shape, self.tables = shape, {np.dtype(kind): table for kind, table in tables.items()}
        for kind, table in self.tables.items():
            np.save(self.folder / f"table{kind.itemsize}.npy", table)

    def put(self, number: int, values: np.ndarray, codes: np.ndarray | None = None) -> None:
        """Keep picture `number`: as `codes` where these give `values`, bit for bit, else as half or single floats."""
        import numpy as np

        if codes is None or not _same(decoded(codes, self.tables[codes.dtype]), values):
            halves = _halves(values)
            codes = values if halves is None else halves
        if codes.ndim == 2 and (codes == codes[0, 0]).all():
            codes = codes[:1, :1]
        np.save(self.folder / f"{number:05d}.npy", np.ascontiguousarray(codes))

    def stack(self) -> Pictures:
        """The pictures, once all have been put."""
        files = [self.folder / f"{number:05d}.npy" for number in range(self.shape[0])]
        return Pictures(files, self.shape[1:], self._owner)


def integer_codes(values: np.ndarray) -> np.ndarray | None:
    """The 8- or 16-bit codes c of values c / 255 or c / 65535, None where they are not such."""
    import numpy as np

    for kind in (np.uint8, np.uint16):
        top = np.float32(np.iinfo(kind).max)
        codes = np.rint(values * top).astype(kind)
        if _same(codes.astype(np.float32) / top, values):
            return codes
    return None


def _halves(values: np.ndarray) -> np.ndarray | None:
    import numpy as np

    with np.errstate(over="ignore"):
        halves = values.astype(np.float16)
    return halves if _same(halves.astype(np.float32), values) else None


def _same(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether all bits agree: -0 is not 0, and a NaN is itself."""
    import numpy as np

    return first.shape == second.shape and bool(
        np.array_equal(np.ascontiguousarray(first).view(np.uint32), np.ascontiguousarray(second).view(np.uint32))
    )


def _own_folder() -> tempfile.TemporaryDirectory[str]:
    """A folder that goes with the pictures; on a disk rather than in the memory that many machines mount on /tmp."""
    # not in the key: a place for scratch files
    disk = None if "TMPDIR" in os.environ or not os.access("/var/tmp", os.W_OK) else "/var/tmp"
    return tempfile.TemporaryDirectory(prefix="exmesh-pictures-", dir=disk)


def _check_space(folder: Path, size: int) -> None:
    """DataError unless `size` bytes are free: what 8-bit codes take."""
    free = shutil.disk_usage(folder).free  # not in the key: a reason to stop
    if free < size:
        raise DataError(
            f"the pictures are too many for memory, and {free / 2**30:.1f} GiB of disk are free", where=str(folder),
            expected=f"{size / 2**30:.1f} GiB for 8-bit pictures, four times that for reduced or undistorted ones",
            fix="raise the loader's `downscale`, or put the store (or TMPDIR) on a larger disk",
        )  # fmt: skip


def _link(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:  # another file system, or one without links
        shutil.copyfile(source, target)
