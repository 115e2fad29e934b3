"""Rows of what a node decided, for its log and the report: {name, value, reason, evidence}."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def told(row: Mapping[str, Any]) -> str:
    """A row as a line of the log."""
    return f"{row['name']}: {row['value']}. {row['reason']}"
