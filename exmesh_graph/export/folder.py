"""The folder of an export, which appears under its name only when it is whole, and what it says of its origin."""

from __future__ import annotations

import math
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from exmesh_graph.errors import DataError


@contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """A hidden folder beside `folder` to write into; it is renamed at the end, and removed if anything fails.

    Raises DataError when `folder` exists.
    """
    if folder.exists():
        raise DataError("the target exists", where=str(folder), fix="remove it, or export to another folder")
    folder.parent.mkdir(parents=True, exist_ok=True)
    partial = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        yield partial
        partial.chmod(0o755)
        partial.rename(folder)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise


def provenance_of(key: str, metrics: Mapping[str, Any]) -> dict[str, Any]:
    """What an asset says of where it comes from, as `customData` holds it: the key of the node that writes it, and the
    finite numbers of `metrics` by dotted name, as identifiers.
    """
    numbers = {re.sub(r"\W", "_", name): value for name, value in sorted(_numbers("", metrics))}
    return {"key": key, **({"metrics": numbers} if numbers else {})}


def _numbers(prefix: str, values: Mapping[str, Any]) -> list[tuple[str, int | float]]:
    numbers: list[tuple[str, int | float]] = []
    for name, value in values.items():
        if isinstance(value, Mapping):
            numbers += _numbers(f"{prefix}{name}.", value)
        elif isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
            numbers.append((f"{prefix}{name}", value))
    return numbers
