"""The example of docs/wire_types.md runs as it stands: a type, its refusals, a node on it, its codec."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "wire_types.md"


def test_the_page_runs(tmp_path):
    """In a process of its own: its node would stay in the registry of this one."""
    text = PAGE.read_text(encoding="utf-8")
    script = tmp_path / "page.py"
    script.write_text("\n".join(re.findall(r"^```python\n(.*?)^```$", text, re.S | re.M)), encoding="utf-8")
    done = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Strokes.widths: is float32 [3]" in done.stdout
    assert "P = 4 as in points" in done.stdout
