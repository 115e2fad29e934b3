"""How figures are written for people."""

from __future__ import annotations

from typing import Any


def number(value: Any) -> str:
    """A figure with as many digits as it carries: 5 856, 33.21, 0.0123, yes."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}".replace(",", "\u202f")
    if isinstance(value, float):
        size = abs(value)
        if size >= 1000:
            return f"{value:,.0f}".replace(",", "\u202f")
        if size >= 100:
            return f"{value:.1f}"
        if size >= 1 or size == 0:
            return f"{value:.2f}"
        return f"{value:.3g}"
    return "–" if value is None else str(value)


def seconds(value: float | None) -> str:
    """0.42 s, 12.3 s, 3 min 20 s, 1 h 02 min."""
    if value is None:
        return "–"
    if value < 10:
        return f"{value:.2f} s"
    if value < 60:
        return f"{value:.1f} s"
    whole = round(value)
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def signed(value: float) -> str:
    """+0.31, −12.4, or = for none: a difference."""
    return "=" if value == 0 else ("+" if value > 0 else "−") + number(float(abs(value)))


def size(bytes_: int) -> str:
    """1.2 MB; an en dash for nothing known."""
    if bytes_ <= 0:
        return "–"
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if bytes_ >= factor:
            return f"{bytes_ / factor:.1f} {unit}"
    return f"{bytes_} B"
