"""Packing a USD layer and its files into a `.usdz` with bytes that depend on the contents alone, and judging one."""

from __future__ import annotations

import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from exmesh_graph.export.usd.rules import Problem

_ALIGNMENT = 64  # bytes; usdz specification, "Layout"
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the earliest time a zip archive can hold
_PADDING_ID = 0x1986  # the header id that OpenUSD gives its own padding
_HEADER_SIZE = 30  # a local file header without name and extra field


def write_usdz(path: Path, members: list[tuple[str, Path]]) -> None:
    """Write the (name in the package, file) pairs in order; the first one is the package's root layer.

    Stored, not compressed, and every file's data starts at a multiple of 64 bytes, so that readers can map it.
    """
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name, file in members:
            info = zipfile.ZipInfo(name, _EPOCH)
            info.create_system = 3
            info.external_attr = 0o644 << 16
            info.extra = _padding(archive.fp.tell() + _HEADER_SIZE + len(name.encode()))  # type: ignore[union-attr]
            archive.writestr(info, file.read_bytes())


def package_rules(path: Path) -> Iterator[Problem]:
    """package: a .usdz is a stored zip whose first member is a USD layer, all data at multiples of 64 bytes."""
    if path.suffix.lower() != ".usdz" or not path.is_file():
        return
    try:
        archive = zipfile.ZipFile(path)
    except zipfile.BadZipFile as error:
        yield Problem("package", path.name, f"not a whole zip archive ({error})")
        return
    with archive, path.open("rb") as file:
        members = archive.infolist()
        if not members or Path(members[0].filename).suffix not in (".usda", ".usdc", ".usd"):
            yield Problem("package", path.name, "the first member is not a USD layer")
        for member in members:
            if member.header_offset < 0:
                yield Problem("package", path.name, "the archive's beginning is missing")
            elif member.compress_type != zipfile.ZIP_STORED:
                yield Problem("package", f"{path.name}[{member.filename}]", "the member is compressed")
            elif _data_offset(file, member) % _ALIGNMENT:
                what = f"the member's data does not start at a multiple of {_ALIGNMENT} bytes"
                yield Problem("package", f"{path.name}[{member.filename}]", what)


def _data_offset(file: BinaryIO, member: zipfile.ZipInfo) -> int:
    """Where in the opened package the data of `member` starts."""
    file.seek(member.header_offset + 26)
    name, extra = struct.unpack("<HH", file.read(4))
    return member.header_offset + _HEADER_SIZE + name + extra


def _padding(offset: int) -> bytes:
    """A zip extra field that moves data from `offset` to the next multiple of 64; its head alone takes 4 bytes."""
    missing = -offset % _ALIGNMENT
    if missing == 0:
        return b""
    if missing < 4:
        missing += _ALIGNMENT
    return struct.pack("<HH", _PADDING_ID, missing - 4) + bytes(missing - 4)
