"""Judging a `.usdz` package."""

from __future__ import annotations

import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from exmesh_graph.export.packing import ALIGNMENT, HEADER_SIZE
from exmesh_graph.export.usd.rules import Problem


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
            elif _data_offset(file, member) % ALIGNMENT:
                what = f"the member's data does not start at a multiple of {ALIGNMENT} bytes"
                yield Problem("package", f"{path.name}[{member.filename}]", what)


def _data_offset(file: BinaryIO, member: zipfile.ZipInfo) -> int:
    """Where in the opened package the data of `member` starts."""
    file.seek(member.header_offset + 26)
    name, extra = struct.unpack("<HH", file.read(4))
    return member.header_offset + HEADER_SIZE + name + extra
