"""Names that users give to runs, kept beside the store: a run's folder and record stay as they are."""

from __future__ import annotations

import contextlib
import json
import threading
from pathlib import Path

from exmesh_graph.studio.runner import write

LONGEST = 120
MOST = 2000


class Labels:
    """{run: label} in a file."""

    def __init__(self, file: Path) -> None:
        self.file, self._lock = file, threading.Lock()

    def all(self) -> dict[str, str]:
        with contextlib.suppress(OSError, ValueError, AttributeError):
            told = json.loads(self.file.read_text(encoding="utf-8"))
            return {str(run): str(label)[:LONGEST] for run, label in told.items()}
        return {}

    def put(self, run: str, label: str) -> None:
        """Name a run; an empty label takes the name away."""
        with self._lock:
            known = self.all()
            known.pop(run, None)
            if label.strip():
                known[run] = "".join(c for c in label if c.isprintable()).strip()[:LONGEST]
            self.file.parent.mkdir(parents=True, exist_ok=True)
            write(self.file, dict(list(known.items())[-MOST:]))
