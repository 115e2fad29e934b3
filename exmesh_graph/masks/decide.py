"""What `mask.auto` decides, as rows for the report."""

from __future__ import annotations

from typing import Any

from exmesh_graph.masks.agreement import Agreement
from exmesh_graph.masks.standing import Standing, said

Row = dict[str, Any]
_ON = (
    "The views go on without masks, as they came. Where an object stands apart all the same, give masks (mask.files, "
    "or masks/ beside the pictures), or take more pictures, 10 to 15 degrees apart, that show all of it"
)


def given_row(masked: int, views: int) -> Row:
    """The views have masks: all of them, or some."""
    lack = "" if masked == views else f", {views - masked} lack theirs"
    return {"name": "masks", "value": "given", "reason": f"The views have masks{lack}: none are looked for."}


def off_row() -> Row:
    """The search was switched off."""
    return {"name": "masks", "value": "none", "reason": "`find` is false: the views go on without masks."}


def none_row(fault: str, evidence: dict[str, float]) -> Row:
    """No masks were found that hold; `fault` says why, without a full stop."""
    return {"name": "masks", "value": "none", "reason": f"No object was told apart: {fault}. {_ON}.",
            "evidence": evidence}  # fmt: skip


def found_row(agreement: Agreement, left_out: int) -> Row:
    """Masks were found that have a common shape."""
    figures = agreement.figures
    reason = (
        f"The masks of {figures['seen']:.0%} of the views and their common shape overlap by {figures['overlap']:.0%} "
        f"(median); {figures['contradicted']:.0%} are contradicted, and mended by the others."
    )
    if left_out:
        reason += f" {left_out} views do not show the object and are left out."
    return {"name": "masks", "value": "found", "reason": reason, "evidence": figures}


def table_row(found: Standing) -> Row:
    """What was done with the plane that the object stands on, and what the fused surface was made of."""
    if found.table is None:
        value, why = "none", "No plane was found that the object stands on and the cameras look down on"
    else:
        value = "removed" if found.removed else "kept"
        why = f"{1 - found.table.under:.0%} of the plane below the object lie beside it"
    return {"name": "table", "value": value, "reason": f"{why}. Of the surface: {said(found.shares)}.",
            "evidence": {**found.shares, "apart": found.apart}}  # fmt: skip


def nothing_row(fault: str) -> Row:
    """Nothing is left beside table and lumps; `fault` says so, without a full stop."""
    return {"name": "table", "value": "kept", "reason": f"The surface stays as it is: {fault}."}
