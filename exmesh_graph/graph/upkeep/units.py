"""Sizes and times as people write them."""

from __future__ import annotations

import re

from exmesh_graph.errors import ExmeshError

_BYTES = {"": 1, "B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12, "KIB": 2**10, "MIB": 2**20,
          "GIB": 2**30, "TIB": 2**40}  # fmt: skip
_SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0, "w": 7 * 86400.0}


def to_bytes(text: str) -> int:
    """`5GB` -> 5000000000; kB, MB, GB, TB are decimal, KiB to TiB binary."""
    number, unit = _split(text)
    if unit.upper() not in _BYTES:
        raise ExmeshError(f"{text!r} is no size", expected="a number with B, kB, MB, GB, TB, MiB or GiB")
    return int(number * _BYTES[unit.upper()])


def to_seconds(text: str) -> float:
    """`30d` -> 2592000.0; s, min, h, d or w."""
    number, unit = _split(text)
    if unit not in _SECONDS:
        raise ExmeshError(f"{text!r} is no span of time", expected="a number with s, min, h, d or w")
    return number * _SECONDS[unit]


def shown_bytes(size: int) -> str:
    """`12.3 MB`."""
    value = float(size)
    for unit in ("B", "kB", "MB", "GB"):
        if value < 1000:
            return f"{value:.0f} {unit}" if unit == "B" else f"{value:.1f} {unit}"
        value /= 1000
    return f"{value:.1f} TB"


def _split(text: str) -> tuple[float, str]:
    match = re.match(r"\s*(\d+(?:\.\d+)?)\s*([A-Za-z]*)\s*\Z", text)
    return (float(match[1]), match[2]) if match else (0.0, "?")
