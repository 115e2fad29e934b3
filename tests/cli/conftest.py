"""The `exmesh` command in this process, which is much quicker than a new one."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from exmesh_graph.cli import main

TOY = Path(__file__).parent.parent / "graph" / "toy"


class Done(NamedTuple):
    stdout: str
    stderr: str


@pytest.fixture
def exmesh(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Iterator[Callable[..., Done]]:
    """`exmesh(*words, code=0)` in the folder `tmp_path`, with the toy node pack beside the built-in one."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(TOY))
    monkeypatch.setenv("COLUMNS", "100")
    handler = signal.getsignal(signal.SIGTERM)

    def call(*words: str, code: int = 0) -> Done:
        monkeypatch.setattr(sys, "argv", ["exmesh", *words])
        capsys.readouterr()
        with pytest.raises(SystemExit) as end:
            main()
        shown = capsys.readouterr()
        assert (end.value.code or 0) == code, shown.out + shown.err
        assert "Traceback" not in shown.out + shown.err
        return Done(shown.out, shown.err)

    yield call
    signal.signal(signal.SIGTERM, handler)
