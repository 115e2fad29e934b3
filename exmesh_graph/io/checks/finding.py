"""What a check says, and what becomes of it: an error, or notes for the run's page."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from exmesh_graph.errors import DataError
from exmesh_graph.io.normalise import some
from exmesh_graph.io.settings import Checks


@dataclass(frozen=True)
class Finding:
    """One fault of cameras or pictures.

    check  its short name, for tables
    what   what is seen, in figures
    views  names of the views concerned; empty: all
    cause  the probable cause
    cure   what to do
    grave  whether a result would be worthless
    explained  whether the cause was tried and found to explain everything
    """

    check: str
    what: str
    cause: str
    cure: str
    views: tuple[str, ...] = ()
    grave: bool = True
    explained: bool = False

    def __str__(self) -> str:
        where = f" ({some(self.views)})" if self.views else ""
        return f"{self.what}{where}; probable cause: {self.cause}; cure: {self.cure}"


def settle(findings: Iterable[Finding], level: Checks) -> list[str]:
    """Notes for the user; at level "error" the grave ones are raised as one DataError, the first of them in full."""
    found = list(findings)
    grave = [finding for finding in found if finding.grave] if level == "error" else []
    if grave:
        first, *others = grave
        raise DataError(
            f"{first.what}; probable cause: {first.cause}" + "".join(f"\n  also: {other}" for other in others),
            where=f"views {some(first.views)}" if first.views else "all views",
            expected="cameras and masks that belong to these pictures",
            fix=f"{first.cure}; `checks: warn` on the loader goes on regardless",
        )
    return [str(finding) for finding in found]
