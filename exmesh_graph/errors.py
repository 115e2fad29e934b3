"""The project's exceptions: every message says what is wrong, where, what was expected and how to mend it.

ExmeshError              base; carries `what`, `where`, `expected`, `fix`
├── DataError            input files: images, masks, cameras, depth maps, meshes
├── GeometryError        a mesh, atlas or topology operation that cannot be carried out
├── NumericsError        a NaN, Inf or divergence, with the step and term that produced it
├── GraphError           a graph file or its wiring (`GraphErrors` holds all of them at once)
├── StoreError           the artifact store
├── LimitError           a node past the time, memory or disk that it was given
├── PassingError         a cause that may be gone when the same is tried again
└── MissingLibraryError  an optional or system library that is not there
"""

from __future__ import annotations

import errno
import subprocess


class ExmeshError(Exception):
    """Base of all errors a user can mend.

    `what` is one sentence; `where` names file, node, port or view; `expected` and `fix` may be empty.
    """

    code = "error"

    def __init__(self, what: str, *, where: str = "", expected: str = "", fix: str = "") -> None:
        self.what, self.where, self.expected, self.fix = what, where, expected, fix
        super().__init__(what, where, expected, fix)

    def __str__(self) -> str:
        lines = [f"{self.where}: {self.what}" if self.where else self.what]
        if self.expected:
            lines.append(f"  expected: {self.expected}")
        if self.fix:
            lines.append(f"  fix: {self.fix}")
        return "\n".join(lines)


class DataError(ExmeshError):
    """Input data that cannot be used."""

    code = "data"


class GeometryError(ExmeshError):
    """A mesh, atlas or topology operation that cannot be carried out."""

    code = "geometry"


class NumericsError(ExmeshError):
    """A value that is not finite, or an optimisation that diverged."""

    code = "numerics"


class GraphError(ExmeshError):
    """A graph file, or the wiring in it, that cannot run."""

    code = "graph"


class StoreError(ExmeshError):
    """The artifact store cannot be read or written."""

    code = "store"


class MissingLibraryError(ExmeshError):
    """A library that a node needs is not installed; `fix` names the package."""

    code = "missing-library"


class LimitError(ExmeshError):
    """A node took more time, memory or disk than its limits say."""

    code = "limit"


class PassingError(ExmeshError):
    """A cause that may pass: a node raises it to be tried again, as often as its limits allow."""

    code = "passing"


_PASSING = (PassingError, MemoryError, ConnectionError, TimeoutError, BlockingIOError, InterruptedError,
            subprocess.TimeoutExpired)  # fmt: skip
_PASSING_NUMBERS = {
    errno.EAGAIN, errno.EBUSY, errno.EDQUOT, errno.EHOSTDOWN, errno.EHOSTUNREACH, errno.EIO, errno.EMFILE,
    errno.ENETDOWN, errno.ENETRESET, errno.ENETUNREACH, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM, errno.ENOSPC,
    errno.ESTALE,
}  # fmt: skip


def may_pass(error: BaseException) -> bool:
    """Whether the cause of an error may be gone later: a busy or full device, a network, memory that others hold."""
    seen: BaseException | None = error
    while seen is not None:
        if isinstance(seen, _PASSING) or type(seen).__name__ == "OutOfMemoryError":  # torch's, which is not imported
            return True
        if isinstance(seen, OSError) and seen.errno in _PASSING_NUMBERS:
            return True
        seen = seen.__cause__
    return False
