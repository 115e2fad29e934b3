"""The artifact store: content-addressed objects and the records of the actions that made them.

    objects/ab/<digest>/data/...        the artifact's files, read-only
    objects/ab/<digest>/artifact.json   {type, digest, files: {name: [bytes, sha256]}}, written last
    actions/ab/<key>.json               {key, preimage, outputs: {port: {type, digest, bytes}}, ...}, with a checksum
    work/<attempt>/                     everything unfinished;  quarantine/  everything doubtful

Invariants: an object or record is visible only when complete (written in work/, synced, renamed). Any doubt on
reading moves the thing to quarantine and counts as a miss; nothing doubtful is ever served. No pickle.
"""

from __future__ import annotations

import contextlib
import os
import platform
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exmesh_graph import files
from exmesh_graph.errors import StoreError
from exmesh_graph.graph import sealed
from exmesh_graph.graph.cache.keys import FORMAT, Action, Stored, action_of, artifact_digest, digest_of, key_of
from exmesh_graph.types import Artifact

if TYPE_CHECKING:
    from exmesh_graph.graph.cache.remote import Remote

RECENT = 3000


class Store:
    """A store in a folder. Opening it is cheap; the folder is made by the first write.

    `shared` names a second tier (see `remote`): what is missing here is looked for there.
    """

    def __init__(self, root: Path, shared: str | None = None) -> None:
        self.root = root.absolute()
        if self.root.exists() and not self.root.is_dir():
            raise StoreError("the store is not a folder", where=str(self.root), fix="name a folder with --store")
        self.work = self.root / "work"
        self.notes: list[str] = []
        self.below: Path | None = None  # a store that may only be read, see `writable`
        with contextlib.suppress(OSError):
            self.below = Path((self.root / "below").read_text(encoding="utf-8"))
        self.sources = sealed.SourceDigests(self.root / "sources.json", self.work)
        self.code = sealed.Memo(self.root / "code.json", self.work)
        self._records: dict[str, list[Action]] | None = None
        self.remote: Remote | None = None
        if shared:
            from exmesh_graph.graph.cache.remote import Remote

            self.remote = Remote(shared, self)

    @contextlib.contextmanager
    def attempt(self) -> Iterator[Path]:
        """A work folder on the store's file system, removed afterwards."""
        with contextlib.ExitStack() as stack:
            with files.writing("the store", self.root, "--store"):
                folder = stack.enter_context(files.own_folder(self.work))
            yield folder

    def sweep(self) -> None:
        """Remove what killed processes left in work/."""
        files.sweep_abandoned(self.work)

    def note_runs(self, folder: Path) -> None:
        """Note that the runs in a folder use this store: what they show is kept by `gc`."""
        facts = {"host": platform.node(), "path": str(folder.resolve())}
        path = self.root / "roots" / digest_of(facts)[:16]
        if self.folder_of_runs(path) is None:
            with contextlib.suppress(OSError):  # a store that may only be read; hits do not fail for want of a note
                files.write_durably(path, sealed.seal_text(facts), self.work)

    def folder_of_runs(self, path: Path) -> tuple[str, Path] | None:
        """(host, folder) in a note of `note_runs`, None (and quarantine) when it is not sound."""
        try:
            facts = sealed.read_sealed(path)
            if digest_of(facts)[:16] != path.name:
                raise ValueError("its name does not belong to its contents")
            return facts["host"], Path(facts["path"])
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError) as error:
            self.quarantine(path, str(error))
            return None

    def share(self, key: str) -> None:
        """Send a recorded result to the shared tier, if there is one; `close` waits for it."""
        if self.remote is not None:
            self.remote.push(key)

    def close(self) -> None:
        """Wait for what is being sent to the shared tier, and save the memos."""
        if self.remote is not None:
            self.remote.close()
        self.save()

    def save(self) -> None:
        """Keep what was learned about source files and modules for the next process."""
        self.sources.save()
        self.code.save()

    def put(self, value: Artifact, attempt: Path) -> Stored:
        """Write an artifact and return where it is. Equal bytes are kept once. Raises StoreError on a full disk."""
        with files.writing("the store", self.root, "--store"):
            return self._put(value, attempt)

    def _put(self, value: Artifact, attempt: Path) -> Stored:
        draft = attempt / f"object-{time.monotonic_ns()}"
        data = draft / "data"
        data.mkdir(parents=True)
        value.save(data)
        for folder, *_ in os.walk(data, topdown=False):  # empty folders are in no digest, so in no object
            with contextlib.suppress(OSError):
                if Path(folder) != data and Path(folder).parent != data:  # those are of the type's own making
                    os.rmdir(folder)
        table: dict[str, list[Any]] = {}
        for name, path in files.walk_files(data):
            if path.is_symlink() or not path.is_file():
                raise StoreError(f"{type(value).__name__}.save wrote {name}, which is not a plain file")
            path.chmod(0o444)
            files.sync(path)
            table[name] = [path.stat().st_size, files.sha256_file(path)]
        digest = artifact_digest(value.type_name, table)
        head = {"format": FORMAT, "type": value.type_name, "digest": digest, "files": table}
        note = draft / "artifact.json"
        note.write_text(sealed.seal_text(head), encoding="utf-8")
        files.sync(note)
        stored = Stored(value.type_name, digest, sum(size for size, _ in table.values()))
        self._publish(draft, digest)
        return stored

    def _publish(self, draft: Path, digest: str) -> None:
        target = self.root / "objects" / digest[:2] / digest
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.exists() and not self.holds(digest):
            self.quarantine(target, "found broken when the same artifact was written again", whatever=True)
        try:
            os.rename(draft, target)
        except OSError:
            if not self.holds(digest):
                raise
            shutil.rmtree(draft, ignore_errors=True)
            with contextlib.suppress(OSError):
                os.utime(target)  # `gc` leaves alone what was made or used a short while ago

    def holds(self, digest: str) -> bool:
        """Whether the object is there, with all its files at their sizes."""
        return self._head(digest) is not None

    def type_of(self, digest: str) -> str | None:
        """The type name of an object, None when it is not sound."""
        head = self._head(digest)
        return None if head is None else str(head["type"])

    def data(self, digest: str) -> Path:
        """The folder of an object's files."""
        return self._object(digest) / "data"

    def load(self, kind: type[Artifact], digest: str) -> Artifact | None:
        """Read an artifact back, its bytes verified; None (and quarantine) when there is any doubt."""
        if self.sound(digest):
            if self.type_of(digest) != kind.type_name:
                self.notes.append(f"object {digest} is {self.type_of(digest)}, not {kind.type_name}")
                return None
            try:
                return kind.load(self.data(digest))
            except Exception as error:
                self.quarantine(self._object(digest), f"{kind.type_name} cannot be read: {error}")
        return None

    def sound(self, digest: str) -> bool:
        """Whether all bytes of an object are as they were stored; quarantined where not."""
        reason = self.doubt(digest)
        if reason is not None:
            self.quarantine(self._object(digest), reason)
        return reason is None

    def doubt(self, digest: str, folder: Path | None = None) -> str | None:
        """Why an object (here, or in a folder) cannot be trusted, with all bytes read; None when it can."""
        head = self._head(digest, folder)
        if head is None:
            return "incomplete"
        for name, (_, expected) in head["files"].items():
            if files.sha256_file((folder or self._object(digest)) / "data" / name) != expected:
                return f"{name} has other bytes than were stored"
        if artifact_digest(head["type"], head["files"]) != digest:
            return "the table of files does not belong to this object"
        return None

    def _head(self, digest: str, place: Path | None = None) -> dict[str, Any] | None:
        folder = place or self._place(f"objects/{digest[:2]}/{digest}")
        try:
            head = sealed.read_sealed(f"{folder}/artifact.json")
            if head["digest"] != digest or head["format"] != FORMAT:
                return None
            sizes = files.sizes(f"{folder}/data")
            return head if sizes == {name: size for name, (size, _) in head["files"].items()} else None
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def record(self, preimage: Mapping[str, Any], outputs: Mapping[str, Stored], info: Mapping[str, Any]) -> str:
        """Write the record of an action whose outputs are all in the store; an older one is replaced."""
        key = key_of(preimage)
        table = {port: asdict(stored) for port, stored in outputs.items()}
        record = {"format": FORMAT, "key": key, "preimage": dict(preimage), "outputs": table, **info}
        with files.writing("the store", self.root, "--store"):
            files.write_durably(self.root / "actions" / key[:2] / f"{key}.json", sealed.seal_text(record), self.work)
        return key

    def look_up(self, key: str, use: bool = True) -> Action | None:
        """The sound record of `key` whose outputs are all there, or None; noted as used, unless it is not for use."""
        path = self._action(key)
        action = self.read(path, use)
        if action is None:
            return None
        for digest in action.digests:
            if not self.holds(digest):
                self.quarantine(self._object(digest), "incomplete")
                if not self._object(digest).exists():
                    self.quarantine(path, f"its output {digest} is missing or incomplete")
                return None
        return action

    def find(self, preimage: Mapping[str, Any], key: str = "", fetch: bool = True) -> Action | None:
        """The record of the pre-image's key, here or in the shared tier, which is asked where there is none here.

        Its record is brought here with its objects, or with fetch=False only shown.
        """
        key = key or key_of(preimage)
        action = self.look_up(key)
        if action is None and self.remote is not None:
            action = self.remote.fetch(key) if fetch else self.remote.peek(key)
        return action

    def read(self, path: Path, use: bool = False) -> Action | None:
        """The record in a file below actions/, None (and quarantine) when it is not sound."""
        try:
            return action_of(path.stem, sealed.read_sealed(path, use=use))
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            self.quarantine(path, str(error))
            return None

    def take_in(self, action: Action | None, text: str, drafts: Mapping[str, Path]) -> Action | None:
        """Keep a record from elsewhere, if any, and objects whose bytes were checked ({digest: folder below work/})."""
        with files.writing("the store", self.root, "--store"):
            for digest, draft in drafts.items():
                for _, path in files.walk_files(draft):
                    path.chmod(0o444)
                    files.sync(path)
                self._publish(draft, digest)
            if action is None or not all(map(self.holds, action.digests)):
                return None
            path = self.root / "actions" / action.key[:2] / f"{action.key}.json"
            files.write_durably(path, text, self.work)
        return action

    def actions(self, node_type: str) -> list[Action]:
        """The sound records of a node type among the latest RECENT of the store, newest first; read once."""
        if self._records is None:
            self._records = {}
            homes = [home / "actions" for home in (self.root, self.below) if home is not None]
            paths = [(path.stat().st_mtime_ns, path) for home in homes for path in home.glob("*/*.json")]
            for _, path in sorted(paths, reverse=True)[:RECENT]:
                action = self.read(path)
                if action is not None:
                    self._records.setdefault(str(action.preimage["type"]), []).append(action)
        return self._records.get(node_type, [])

    def verify(self) -> Iterator[tuple[str, str]]:
        """Re-hash everything; yields (what, why) of each thing that went to quarantine."""
        for folder in sorted((self.root / "objects").glob("*/*")):
            if not self.sound(folder.name):
                yield f"object {folder.name}", self.notes[-1]
        for path in sorted((self.root / "actions").glob("*/*.json")):
            if self.read(path) is None or self.look_up(path.stem, use=False) is None:
                yield f"action {path.stem}", self.notes[-1]
        for path in sorted((self.root / "roots").glob("*")):
            if self.folder_of_runs(path) is None:
                yield f"note of runs {path.name}", self.notes[-1]

    def quarantine(self, path: Path, reason: str, whatever: bool = False) -> None:
        """Move away what is in doubt, and note why; what another version wrote in its own format is left to it."""
        if not path.exists():
            return
        with contextlib.suppress(OSError, ValueError):
            found = sealed.read_sealed(path / "artifact.json" if path.is_dir() else path).get("format", FORMAT)
            if found != FORMAT and not whatever:
                own = f"another version of exmesh-graph wrote it (format {found}, here {FORMAT})"
                self.notes.append(f"{path.name} is not used and left alone: {own}")
                return
        if self.below is not None and path.is_relative_to(self.below):
            self.notes.append(f"{path} is not used: {reason}")
            return
        home, what = self.root / "quarantine", "moved to quarantine"
        try:
            home.mkdir(parents=True, exist_ok=True)
            with contextlib.suppress(FileNotFoundError):  # another process was quicker
                os.rename(path, home / f"{path.name}.{time.time_ns()}")
        except OSError as error:  # a store that may only be read: still a miss
            what = f"is not used and could not be moved to quarantine ({error.strerror})"
        self.notes.append(f"{path.relative_to(self.root)} {what}: {reason}")

    def _object(self, digest: str) -> Path:
        return Path(self._place(f"objects/{digest[:2]}/{digest}"))

    def _action(self, key: str) -> Path:
        return Path(self._place(f"actions/{key[:2]}/{key}.json"))

    def _place(self, name: str) -> str:
        """Where a thing is: here, or in the store below. (Text: a plan of 1000 hits comes here thousands of times.)"""
        path = f"{self.root}/{name}"
        if self.below is not None and not os.path.exists(path) and os.path.exists(f"{self.below}/{name}"):
            return f"{self.below}/{name}"
        return path


@contextlib.contextmanager
def writable(store: Store) -> Iterator[Store]:
    """The store itself, or where its folder may only be read, a temporary one that serves the hits of that store.

    What is computed then is used by the run, published and shared, but not kept; a note says so. Worker processes that
    open the temporary folder find the store below by the file `below` in it.
    """
    if not store.root.is_dir() or os.access(store.root, os.W_OK):
        yield store
        return
    with tempfile.TemporaryDirectory(prefix="exmesh-", ignore_cleanup_errors=True) as folder:
        Path(folder, "below").write_text(str(store.root), encoding="utf-8")
        for memo in (store.sources.path, store.code.path):
            with contextlib.suppress(OSError):
                shutil.copyfile(memo, Path(folder, memo.name))
        layer = Store(Path(folder), None if store.remote is None else store.remote.url)
        layer.notes.append(f"{store.root} may only be read: its hits are used, new results are not kept")
        yield layer
