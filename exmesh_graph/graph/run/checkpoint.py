"""Checkpoints of a running node, bound to its key, so that a changed parameter can never resume the wrong state.

    checkpoints/<key>/<step>-<n>/   arrays.safetensors, meta.json, checkpoint.json (sealed: key, step, digests)

A checkpoint is written in work/, synced and renamed into place; every byte is hashed again when it is read. Any doubt
means the one before it, or none: the node then starts from the beginning.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from exmesh_graph import files
from exmesh_graph.graph import sealed
from exmesh_graph.graph.run.hermetic import draw_on, drawn
from exmesh_graph.types.state import load_states, save_state

FORMAT = 3


class Checkpoints:
    """The checkpoints of one key; the `keep` latest stay."""

    def __init__(self, root: Path, key: str, keep: int = 2) -> None:
        self.key, self.keep, self.work = key, keep, root / "work"
        self.root = root
        self.folder = root / "checkpoints" / key
        self.notes: list[str] = []

    def save(self, step: int, state: Mapping[str, Any]) -> None:
        """Keep `state` as of `step` (see `save_state` for what it may hold). Raises StoreError on a full disk."""
        with files.writing("the checkpoint", self.root, "--store"), files.own_folder(self.work) as home:
            draft = home / "checkpoint"
            draft.mkdir()
            save_state(draft, state, drawn())
            written = files.walk_files(draft)
            table = {name: files.sha256_file(path) for name, path in written}
            record = {"format": FORMAT, "key": self.key, "step": step, "files": table}
            (draft / "checkpoint.json").write_text(sealed.seal_text(record), encoding="utf-8")
            for path in draft.iterdir():
                files.sync(path)
            self.folder.mkdir(parents=True, exist_ok=True)
            os.rename(draft, self.folder / f"{step:012d}-{time.time_ns()}")
        for old in self.steps()[self.keep :]:
            self._remove(old)

    def load(self) -> tuple[int, dict[str, Any]] | None:
        """(step, state) of the latest sound checkpoint, None when there is none. Doubtful ones are removed."""
        for folder in self.steps():
            try:
                step = checked_step(folder, self.key)
                found, generators = load_states(folder)
                draw_on(generators)
                return step, found
            except Exception as error:
                self.notes.append(f"checkpoint {folder.name} of {self.key[:10]} is not used: {error}")
                self._remove(folder)
        return None

    def clear(self) -> None:
        """Remove all of them: the result is recorded."""
        self._remove(self.folder)

    def _remove(self, path: Path) -> None:
        """Out of sight in one step: a half removed checkpoint would look like a broken one."""
        with contextlib.suppress(OSError), files.own_folder(self.work) as home:
            os.rename(path, home / "gone")

    def steps(self) -> list[Path]:
        """Their folders, latest step first."""
        with contextlib.suppress(OSError):
            return sorted(self.folder.iterdir(), reverse=True)
        return []


def checked_step(folder: Path, key: str) -> int:
    """The step of a checkpoint whose bytes are all as they were written. Raises ValueError or OSError otherwise."""
    record = sealed.unseal((folder / "checkpoint.json").read_text(encoding="utf-8"))
    if record["key"] != key or record["format"] != FORMAT:
        raise ValueError("it belongs to another key")
    for name, digest in record["files"].items():
        if files.sha256_file(folder / name) != digest:
            raise ValueError(f"{name} has other bytes than were stored")
    return int(record["step"])
