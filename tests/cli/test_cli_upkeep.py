"""pin, gc and verify as their users meet them."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.graph.cache import fingerprint as fp
from exmesh_graph.graph.cache.keys import digest_of
from exmesh_graph.graph.declare.packs import current
from exmesh_graph.graph.sealed import seal_text

Exmesh = Callable[..., Any]
GRAPH = 'nodes: {a: {type: toy.const}, s: {type: toy.sign, number: "@a.number"}}\noutputs: {s: "@s.number"}\n'


@pytest.fixture
def helper(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str, str], None]]:
    """`helper(old, new)` edits a copy of the helper module of `toy.sign`, seen by the next command."""
    copy, real = tmp_path / "helpers.py", fp.source_file
    shutil.copy(Path(__file__).parent.parent / "graph" / "toy" / "toy_pack" / "helpers.py", copy)
    monkeypatch.setattr(fp, "source_file", lambda name: copy if name == "toy_pack.helpers" else real(name))

    def forget() -> None:
        current().parts.pop(fp.Sources, None)

    def edit(old: str, new: str) -> None:
        text = copy.read_text()
        assert old in text
        copy.write_text(text.replace(old, new))
        forget()

    forget()
    yield edit
    forget()


@pytest.mark.thorough
def test_changed_code_is_never_a_hit(exmesh: Exmesh, tmp_path: Path, helper: Callable[[str, str], None]) -> None:
    """Also in a store that holds what the removed command `accept` wrote: old results count for new code."""
    (tmp_path / "g.yaml").write_text(GRAPH)
    exmesh("run", "g.yaml")
    old = fp.fingerprint(current().types["toy.sign"]).digest
    helper("1.0 if value", "2.0 if value")
    new = fp.fingerprint(current().types["toy.sign"]).digest
    assert old != new
    change = {"type": "toy.sign", "new": new, "old": old, "parts": [], "who": "me", "when": 0.0}
    (tmp_path / ".exmesh" / "accepted").mkdir()
    name = digest_of(["toy.sign", new, old])[:12]
    (tmp_path / ".exmesh" / "accepted" / f"{name}.json").write_text(seal_text(change))
    assert "1 hit, 1 to run" in exmesh("plan", "g.yaml").stdout
    assert "code changed: toy_pack.helpers" in exmesh("why", "s", "g.yaml").stdout
    exmesh("verify")


@pytest.mark.thorough
def test_pin_gc_verify(exmesh: Exmesh, tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_text(GRAPH)
    exmesh("run", "g.yaml")
    exmesh("run", "g.yaml", "--set", "a.value=5")
    first, second = sorted(path for path in (tmp_path / "runs").iterdir() if not path.is_symlink())
    assert exmesh("gc").stdout.startswith("nothing would be removed (with --delete), 0 B;")
    assert "pinned: best  run" in exmesh("pin", first.name, "--name", "best").stdout
    key = exmesh("why", "a", "g.yaml").stdout.split("key ")[1].split()[0]
    exmesh("pin", key[:8], "--name", "one")
    assert [line.split()[0] for line in exmesh("pin").stdout.splitlines()] == ["best", "one"]
    assert "needs a name" in exmesh("pin", key[:8], code=1).stderr
    assert "is no run folder" in exmesh("pin", "nothing", "--name", "x", code=1).stderr
    shutil.rmtree(first)
    shutil.rmtree(second)
    (tmp_path / "runs" / "latest").unlink()
    assert exmesh("gc").stdout.startswith("nothing")
    for path in [*(tmp_path / ".exmesh").glob("actions/*/*"), *(tmp_path / ".exmesh").glob("objects/*/*")]:
        os.utime(path, (1e9, 1e9))
    shown = exmesh("gc", "--age", "0s").stdout
    assert "result" in shown
    assert "2 results, 1 object would be removed" in shown
    assert "2 pinned results" in shown
    assert exmesh("verify").stdout.startswith("2 objects and 4 actions read, 0 moved")
    assert "2 results, 1 object removed" in exmesh("gc", "--delete").stdout
    assert "2 hit, 0 to run" in exmesh("plan", "g.yaml").stdout
    assert "removed: best" in exmesh("unpin", "best").stdout
    assert "needed by 0 runs" in exmesh("gc", "--delete", "--budget", "1B").stdout
    assert "is no size" in exmesh("gc", "--budget", "much", code=1).stderr
    assert "no store here" in exmesh("gc", "--store", "elsewhere", code=1).stderr


@pytest.mark.thorough
def test_doctor(exmesh: Exmesh, monkeypatch: pytest.MonkeyPatch) -> None:
    from exmesh_graph.api import doctor

    monkeypatch.setattr(doctor, "_gpu", lambda: doctor.Finding("fail", "torch", "cannot be imported", "pip install"))
    shown = exmesh("doctor", code=1).stdout
    assert "ok    store, rename" in shown
    assert "fail  torch: cannot be imported\n      fix: pip install\n" in shown
    assert "1 to mend" in shown
