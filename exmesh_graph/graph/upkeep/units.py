"""Sizes and times as people write them."""

from __future__ import annotations

import re

from pydantic import ByteSize, TypeAdapter, ValidationError

from exmesh_graph.errors import ExmeshError

_SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0, "w": 7 * 86400.0}


def to_bytes(text: str) -> int:
    """`5GB` -> 5000000000; kB, MB, GB, TB are decimal, KiB to TiB binary."""
    try:
        return TypeAdapter(ByteSize).validate_python(text.strip())
    except ValidationError:
        expected = "a number with B, kB, MB, GB, TB, MiB or GiB"
        raise ExmeshError(f"{text!r} is no size", expected=expected) from None


def to_seconds(text: str) -> float:
    """`30d` -> 2592000.0; s, min, h, d or w."""
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([a-z]+)\s*", text)
    if match is None or match[2] not in _SECONDS:
        raise ExmeshError(f"{text!r} is no span of time", expected="a number with s, min, h, d or w")
    return float(match[1]) * _SECONDS[match[2]]


def shown_bytes(size: int) -> str:
    """`12.3 MB`."""
    return ByteSize(size).human_readable(decimal=True, separator=" ").replace("K", "k")
