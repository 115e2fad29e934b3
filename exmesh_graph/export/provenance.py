"""What an asset says of where it comes from: plain numbers and text, as `customData` holds them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any


def provenance_of(key: str, metrics: Mapping[str, Any]) -> dict[str, Any]:
    """The key of the node that writes the asset, and the finite numbers of `metrics` by dotted name, as identifiers."""
    numbers = {re.sub(r"\W", "_", name): value for name, value in sorted(_numbers("", metrics))}
    return {"key": key, **({"metrics": numbers} if numbers else {})}


def _numbers(prefix: str, values: Mapping[str, Any]) -> list[tuple[str, int | float]]:
    found: list[tuple[str, int | float]] = []
    for name, value in values.items():
        if isinstance(value, Mapping):
            found += _numbers(f"{prefix}{name}.", value)
        elif isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
            found.append((f"{prefix}{name}", value))
    return found
