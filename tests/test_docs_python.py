"""The blocks of docs/python.md run as they stand, in their order, in an empty folder.

A block under a comment `<!-- runs: no -->` is shown only.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import torch

PAGE = Path(__file__).parent.parent / "docs" / "python.md"
FENCE = re.compile(r"(<!-- runs: no -->\n+)?^```python\n(.*?)^```$", re.S | re.M)


def blocks() -> list[tuple[int, str]]:
    """(line, code) of every block that is to run."""
    text = PAGE.read_text(encoding="utf-8")
    return [(text[: found.start(2)].count("\n"), found[2]) for found in FENCE.finditer(text) if not found[1]]


def test_every_block_is_found() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert len(blocks()) == text.count("```python") - text.count("<!-- runs: no -->") > 5


@pytest.mark.thorough
def test_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    names: dict[str, Any] = {"__name__": "docs_python"}
    try:
        for line, code in blocks():
            exec(compile("\n" * line + code, str(PAGE), "exec"), names)  # so that a traceback names the page's line
    finally:
        torch.set_num_threads(threads)
    said = capsys.readouterr().out
    assert "the mesh has no faces" in said
    assert (tmp_path / "ball_usd" / "asset.usdz").is_file()


def test_blocks_are_short() -> None:
    """The promise of the page: each step in a few lines."""
    for line, code in blocks():
        statements = [
            row for row in code.splitlines() if row and not row.startswith(("from ", "import ", " ", ")", "#"))
        ]
        assert len(statements) <= 10, f"line {line}: {len(statements)} statements"
