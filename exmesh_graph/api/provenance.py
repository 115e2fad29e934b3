"""Where a run comes from: commits of the project and of this package, libraries, machine, command.

Recorded with the run and never part of a key: what changes a result is keyed, what might explain one is told here. Who
ran it is told only where `EXMESH_AUTHOR` says so.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
from collections.abc import Iterator, Mapping
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import exmesh_graph
from exmesh_graph.report.collect import library_versions
from exmesh_graph.resources import machine_facts

if TYPE_CHECKING:
    from exmesh_graph.graph.language.check import Checked

_PATIENCE = 5.0  # seconds for git
_GPUS = Path("/proc/driver/nvidia/gpus")


def provenance(graph: Checked, command: str) -> dict[str, Any]:
    """{project, exmesh_graph: {version?, commit?, dirty?}, libraries, machine, gpus, by, command} as plain JSON.

    project: the repository that the graph's file lies in; libraries: those that carry the work, and those that the
    graph's nodes declare.
    """
    declared = {name for bound in graph.nodes.values() for one in bound.definitions() for name in one.libraries}
    home = Path(exmesh_graph.__file__).parent
    own = {} if "site-packages" in home.parts else commit_of(home)
    return {
        "project": commit_of(graph.file.parent),
        "exmesh_graph": {"version": machine_facts()["exmesh_graph"], **own},
        "libraries": {**library_versions(), **{name: _version(name) for name in sorted(declared)}},
        "machine": machine_facts(),
        "gpus": [_model(path) for path in sorted(_GPUS.glob("*/information"))],
        "by": os.environ.get("EXMESH_AUTHOR", ""),
        "command": command,
    }


def public(told: Mapping[str, Any]) -> dict[str, Any]:
    """What may leave the machine beside an asset, and in it: no folder's name, since those name people and machines."""
    words = [_last_of(word) for word in shlex.split(str(told["command"]))]
    return {**told, "command": shlex.join(words)}


def sign_assets(folder: Path, record: Mapping[str, Any]) -> None:
    """Write where a run comes from beside what it publishes, and into the USD files among it."""
    facts = public(record["provenance"])
    (folder / "provenance.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    for path in record["published"].values():
        home = folder / path if (folder / path).is_dir() else (folder / path).parent
        if any(home.glob("*.usda")):
            from exmesh_graph.export.stamp import stamp_usd

            machine = {"processor": str(facts["machine"]["processor"]), "gpus": ", ".join(facts["gpus"])}
            own = {name: facts[name] for name in ("project", "libraries", "command")}
            stamp_usd(home, {**own, "software": facts["exmesh_graph"], "machine": machine, "run": record["id"]})


def _last_of(word: str) -> str:
    """`--store=/home/anna/store` -> `--store=store`: of a path, its last name."""
    head, sign, path = word.rpartition("=")
    return f"{head}{sign}{Path(path).name}" if path.startswith(("/", "~", "..")) else word


def commit_of(folder: Path) -> dict[str, Any]:
    """{commit, dirty} of the git repository that a folder lies in, tracked files counted; {} outside one."""
    if not any((home / ".git").exists() for home in (folder, *folder.parents)):
        return {}
    head = _git(folder, "rev-parse", "HEAD")
    changed = _git(folder, "status", "--porcelain", "--untracked-files=no")
    return {} if head is None else {"commit": head, "dirty": None if changed is None else bool(changed)}


def differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[str]:
    """What differs between two runs' provenance, a sentence each; the command is left out."""
    before, after = dict(_flat(old)), dict(_flat(new))
    for name in dict.fromkeys([*before, *after]):
        if before.get(name) != after.get(name):
            yield f"{name}: {before.get(name, 'nothing')} -> {after.get(name, 'nothing')}"


def _flat(told: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for label in ("project", "exmesh_graph"):
        one = told.get(label) or {}
        if one.get("commit"):
            yield f"{label} commit", str(one["commit"])[:12] + (" (with changes)" if one.get("dirty") else "")
    for name, value in {**(told.get("machine") or {}), **(told.get("libraries") or {})}.items():
        yield str(name), str(value)
    yield "gpus", ", ".join(told.get("gpus") or ()) or "none"


def _git(folder: Path, *words: str) -> str | None:
    """What git says; None where it cannot."""
    environment = {**os.environ, "GIT_OPTIONAL_LOCKS": "0"}
    try:
        done = subprocess.run(["git", "-C", str(folder), *words], capture_output=True, text=True, check=False,
                              timeout=_PATIENCE, env=environment)  # fmt: skip
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "not installed"


def _model(path: Path) -> str:
    """`NVIDIA H100` out of what the driver tells of a device."""
    lines = (line.partition(":") for line in path.read_text(encoding="utf-8", errors="replace").splitlines())
    return next((value.strip() for name, _, value in lines if name.strip() == "Model"), "unknown")
