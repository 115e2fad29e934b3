"""What the gate says, and what it remembers of pictures."""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.export.usd.read import read_asset_pixels


@dataclass(frozen=True)
class Problem:
    """One finding. `level` is "error", "warning" or "note"; `rule` names the check; `where` the prim, layer or file."""

    level: str
    rule: str
    where: str
    what: str

    def __str__(self) -> str:
        return f"{self.level} {self.rule} at {self.where}: {self.what}"


@dataclass(frozen=True)
class PictureFacts:
    width: int
    height: int
    channels: int
    finite: bool
    lowest: float


@dataclass
class Pictures:
    """Facts of pictures, decoded once each by content: one asset holds the same ones under several names."""

    known: dict[tuple[int, int], PictureFacts] = field(default_factory=dict)

    def facts(self, asset: Any) -> PictureFacts | None:
        """Facts of an Sdf.AssetPath; None when it leads nowhere. DataError for a file that cannot be decoded."""
        path = asset.resolvedPath if asset else ""
        if not path:
            return None
        key = _content_key(path)
        if key not in self.known:
            pixels = read_asset_pixels(path)
            height, width, channels = pixels.shape
            finite = bool(np.isfinite(pixels).all())
            self.known[key] = PictureFacts(width, height, channels, finite, float(pixels.min()))
        return self.known[key]


def _content_key(path: str) -> tuple[int, int]:
    """(CRC-32, bytes) of a file, or of a package's member."""
    if path.endswith("]"):
        package, member = path[:-1].split("[", 1)
        try:
            with zipfile.ZipFile(package) as archive:
                info = archive.getinfo(member)
        except (zipfile.BadZipFile, KeyError) as error:
            raise DataError(f"the package does not give the picture ({error})", where=path) from error
        return info.CRC, info.file_size
    data = Path(path).read_bytes()
    return zlib.crc32(data), len(data)
