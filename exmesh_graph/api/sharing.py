"""A run sent to the store that machines share, and brought from there: its results, and the folder that shows them.

runs/<id>.json    sealed {id, graph, state, started, keys, folder: the digest of an object that holds the run's folder}
"""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from exmesh_graph.api.opening import Folder, open_store
from exmesh_graph.api.results import read_run
from exmesh_graph.errors import ExmeshError, StoreError
from exmesh_graph.files import copy_files, writing
from exmesh_graph.graph.cache.remote import hidden
from exmesh_graph.graph.run.rundir import is_alive
from exmesh_graph.graph.sealed import seal_text, unseal
from exmesh_graph.types import Files

if TYPE_CHECKING:
    from exmesh_graph.graph.cache.remote import Remote
    from exmesh_graph.graph.cache.store import Store

_ID, _DIGEST = re.compile(r"[A-Za-z0-9][\w.-]*\Z"), re.compile(r"[0-9a-f]{64}\Z")


class Moved(NamedTuple):
    """A run that was sent or brought: how many of its results were there; names of nodes whose results were not."""

    run: str
    folder: Path
    results: int
    missing: tuple[str, ...]


def push(run: str = "latest", *, shared: str | None = None, store: Folder = None, runs: Folder = "runs") -> Moved:
    """Send a run (its folder or id): the results of its nodes, what is there is not sent again, and its folder.

    Raises ExmeshError where the run goes on, or the shared store cannot be written.
    """
    folder = _folder_of(run, runs)
    record = read_run(folder)
    if is_alive(folder):
        raise ExmeshError(f"the run {record['id']} goes on", where=str(folder), fix="send it when it has ended")
    opened, remote = _tiers(record.get("store") if store is None else store, shared)
    keys = {row["name"]: row["key"] for row in record["nodes"] if row.get("key")}
    shown = _shown(record)
    missing = [name for name, key in keys.items()
               if opened.look_up(key) is None or not all(map(opened.holds, shown.get(name, ())))]  # fmt: skip
    with _reported(remote):
        if _is_taken(remote, record):
            what = f"another run of this id is in the shared store: {record['id']}"
            raise ExmeshError(what, where=hidden(remote.url), fix="run it again: its name is made of the time")
        for name, key in keys.items():
            if name not in missing:
                remote.send(key)
                for digest in shown.get(name, ()):  # a node that is not repeatable may have another result by now
                    remote.send_object(digest)
        with opened.attempt() as attempt:
            stored = opened.put(Files(folder, "run.json"), attempt)
        remote.send_object(stored.digest)
        facts = {name: record.get(name) for name in ("id", "graph", "state", "started")}
        note = seal_text({**facts, "keys": sorted(set(keys.values())), "folder": stored.digest})
        with opened.attempt() as work:
            (work / "note.json").write_text(note, encoding="utf-8")
            remote.send_file(work / "note.json", f"runs/{record['id']}.json")
    return Moved(str(record["id"]), folder, len(keys) - len(missing), tuple(missing))


def pull(run: str, *, shared: str | None = None, store: Folder = None, runs: Folder = "runs") -> Moved:
    """Bring a run by its id: its results into the store, its folder below `runs`, every byte checked.

    Raises ExmeshError where there is no such run, or a folder of its name already.
    """
    opened, remote = _tiers(store, shared)
    target = Path(runs or "runs") / run
    if not _ID.match(run) or target.exists():
        what = "there is a folder of this name already" if target.exists() else f"{run!r} is no id of a run"
        raise ExmeshError(what, where=str(target), fix="exmesh pull lists the runs of the shared store")
    with _reported(remote):
        told = _note(remote, run)
        lost = [key for key in told["keys"] if opened.look_up(key) is None and remote.bring(key) is None]
        if not opened.holds(told["folder"]) and not remote.bring_object(told["folder"]):
            raise StoreError(f"the folder of the run {run} is broken there", where=remote.url, fix="push it again")
    files = opened.load(Files, told["folder"])
    assert isinstance(files, Files)
    with writing("the run folder", target, "--runs"):
        copy_files(files.root, target)
    record = {**read_run(target), "store": str(opened.root)}
    (target / "run.json").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    opened.note_runs(target.parent)
    keyed = [row for row in record["nodes"] if row.get("key")]
    shown = _shown(record)
    with _reported(remote):  # what it shows is its own, also where this store has another result of the same key
        gone = {name for name, digests in shown.items()
                if not all(opened.holds(digest) or remote.bring_object(digest) for digest in digests)}  # fmt: skip
    names = [row["name"] for row in keyed if row["key"] in lost or row["name"] in gone]
    left = {row["key"] for row in keyed if row["name"] in gone} - {*lost}
    return Moved(run, target, len(told["keys"]) - len(lost) - len(left), tuple(names))


def shared_runs(shared: str | None = None, store: Folder = None) -> Iterator[dict[str, Any]]:
    """{id, graph, state, started} of each run in the shared store, by id."""
    _, remote = _tiers(store, shared)
    with _reported(remote):
        for name in remote.names("runs"):
            yield _note(remote, name.removesuffix(".json"))


def _shown(record: Mapping[str, Any]) -> dict[str, list[str]]:
    """{node: the digests of its outputs} as a run's record tells them."""
    rows = {str(row["name"]): row.get("outputs") or {} for row in record["nodes"]}
    return {
        name: [str(one["digest"]) for one in outputs.values() if _DIGEST.match(str(one["digest"]))]
        for name, outputs in rows.items()
    }


def _is_taken(remote: Remote, record: Mapping[str, Any]) -> bool:
    """Whether the shared store has another run of this one's id; a note of it that is broken is none."""
    with contextlib.suppress(ExmeshError):
        return bool(_note(remote, str(record["id"]))["started"] != record["started"])
    return False


def _note(remote: Remote, run: str) -> dict[str, Any]:
    try:
        told = unseal(remote.read(f"runs/{run}.json"))
        if told["id"] != run or not _DIGEST.match(told["folder"]):
            raise ValueError("it is that of another run")
        return told
    except (ValueError, KeyError, TypeError) as error:
        known = ", ".join(sorted(name.removesuffix(".json") for name in remote.names("runs"))[-5:])
        raise ExmeshError(f"there is no run {run} in the shared store ({error})", where=remote.url, expected=known,
                          fix=f"exmesh push {run}, where it was made") from error  # fmt: skip


def _folder_of(run: str, runs: Folder) -> Path:
    folder = Path(run) if (Path(run) / "run.json").is_file() else Path(runs or "runs") / run
    return folder.resolve()


def _tiers(store: Any, shared: str | None) -> tuple[Store, Remote]:
    opened = open_store(store, shared)
    if opened.remote is None:
        raise ExmeshError("no shared store is named", fix="--shared URL, or $EXMESH_SHARED")
    return opened, opened.remote


@contextlib.contextmanager
def _reported(remote: Remote) -> Iterator[None]:
    """Errors of the shared store's file system as ours."""
    try:
        yield
    except ExmeshError:
        raise
    except Exception as error:
        what = hidden(f"the shared store cannot be used: {type(error).__name__}: {error}")
        raise StoreError(what, where=hidden(remote.url), fix="exmesh doctor --shared URL tries it") from error
