"""Links of the pages at the top of the repository lead to files that are there; the build of the site checks docs/."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("page", sorted(path.name for path in ROOT.glob("*.md")))
def test_links_of_top_pages(page: str) -> None:
    text = re.sub(r"(?s)```.*?```", "", (ROOT / page).read_text(encoding="utf-8"))
    ends = [end.partition("#")[0] for end in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in end]
    assert [end for end in ends if not (ROOT / end).exists()] == []
