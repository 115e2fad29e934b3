"""Packing a USD layer and its files into a `.usdz` with bytes that depend on the contents alone. Needs no USD."""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path

ALIGNMENT = 64  # bytes; usdz specification, "Layout"
HEADER_SIZE = 30  # a local file header without name and extra field
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the earliest time a zip archive can hold
_PADDING_ID = 0x1986  # the header id that OpenUSD gives its own padding


def write_usdz(path: Path, members: list[tuple[str, Path]]) -> None:
    """Write the (name in the package, file) pairs in order; the first one is the package's root layer.

    Stored, not compressed, and every file's data starts at a multiple of 64 bytes, so that readers can map it.
    """
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name, file in members:
            info = zipfile.ZipInfo(name, _EPOCH)
            info.create_system = 3
            info.external_attr = 0o644 << 16
            info.extra = _padding(archive.fp.tell() + HEADER_SIZE + len(name.encode()))  # type: ignore[union-attr]
            archive.writestr(info, file.read_bytes())


def _padding(offset: int) -> bytes:
    """A zip extra field that moves data from `offset` to the next multiple of 64; its head alone takes 4 bytes."""
    missing = -offset % ALIGNMENT
    if missing == 0:
        return b""
    if missing < 4:
        missing += ALIGNMENT
    return struct.pack("<HH", _PADDING_ID, missing - 4) + bytes(missing - 4)
