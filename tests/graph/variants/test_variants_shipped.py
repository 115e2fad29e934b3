"""The shipped ablations: every variant checks, and shares what it should with its base."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.graph.variants.checked import check_variants
from exmesh_graph.graph.variants.compare import merge

ABLATIONS = Path(__file__).parent.parent.parent.parent / "graphs" / "ablations"

SHARED = ABLATIONS.parent.parent.parent / "shared" / "data"
OWN_START = {  # what these share; the coarse mesh is the change
    "sphere_start": {"views"},
    "sphere_remeshed": {"views"},
    "uniform": {"views", "hull"},
    "network_start": {"views"},
    "sweep_start": {"views"},
}


def test_there_are_ablations() -> None:
    assert {path.stem for path in ABLATIONS.glob("*.yaml")} >= {"stage1", "stage2", "schedule"}


@pytest.mark.thorough
@pytest.mark.parametrize("path", sorted(ABLATIONS.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_variant_checks_and_differs_from_the_base(path: Path, packs: Any) -> None:
    if path.stem == "no_masks" and not (SHARED / "dtu_scan24").is_dir():
        pytest.skip(f"DTU scan 24 may not be shipped, and is not at {SHARED}")
    rows = check_variants(path, [], packs)
    merged = merge([(f"{row.name}#{row.repeat}", row.checked) for row in rows])
    base = set(merged.members[0].names.values())
    for row, member in zip(rows[1:], merged.members[1:], strict=True):
        assert set(member.names.values()) != base, f"{row.name} is the base"
        start = OWN_START.get(row.name, {"views", "hull", "coarse", "atlas"} & base | {"views", "atlas"})
        assert start <= set(member.names.values()), f"{row.name} shares no coarse start"


@pytest.mark.thorough
def test_stage_two_shares_all_of_stage_one(packs: Any) -> None:
    rows = check_variants(ABLATIONS / "stage2.yaml", [], packs)
    merged = merge([(f"{row.name}#{row.repeat}", row.checked) for row in rows])
    for row, member in zip(rows, merged.members, strict=True):
        assert row.name == "stage2_only" or member.names["settle"] == "settle", row.name
    assert len(merged.checked.nodes) < 0.15 * sum(len(member.names) for member in merged.members)


def test_the_examples_in_the_docs(tmp_path: Path, packs: Any) -> None:
    text = (ABLATIONS.parent.parent / "docs" / "variants.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```yaml\n(.*?)```", text, flags=re.DOTALL)
    assert len(blocks) == 2
    path = tmp_path / "study.yaml"
    path.write_text("".join(blocks).replace("../quickstart.yaml", str(ABLATIONS.parent / "quickstart.yaml")))
    names = list(dict.fromkeys(row.name for row in check_variants(path, [], packs)))
    combinations = [f"faces={faces},split={split}" for faces in (2000, 8000) for split in ("score", "random")]
    left = [f"direct,faces=2000,split={split}" for split in ("score", "random")]
    assert names == ["base", "no_chroma", "both", *combinations, *left, "faces=500"]
