"""`doctor`: whether this machine can run graphs: each thing is tried, not guessed.

A finding is (state, what, found, fix): `ok`; `warn` for what costs speed or single nodes; `fail` for what stops runs.
"""

from __future__ import annotations

import ctypes
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from exmesh_graph.api.opening import Folder, open_store, packs
from exmesh_graph.api.unseen import outside_imports, unseen
from exmesh_graph.api.upkeep import shown_bytes
from exmesh_graph.errors import ExmeshError
from exmesh_graph.files import lock, sync
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.problems import in_short
from exmesh_graph.resources import machine_facts

OK, WARN, FAIL = "ok", "warn", "fail"
LOW, EMPTY = 5 * 10**9, 5 * 10**8
SYSTEM = {"libGL.so.1": "libgl1", "libgomp.so.1": "libgomp1"}  # what the wheels of Open3D and PyMeshLab link
OPTIONAL = {"ray": "ray", "fsspec": "shared"}
GPU = """
import json, torch
cuda = torch.cuda.is_available()
print(json.dumps([torch.__version__, torch.cuda.get_device_name() if cuda else None, torch.cuda.device_count()]))
"""


@dataclass(frozen=True)
class Finding:
    """One line of the report."""

    state: str
    what: str
    found: str
    fix: str = ""

    def __str__(self) -> str:
        return f"{self.state:<5} {self.what}: {self.found}" + (f"\n      fix: {self.fix}" if self.fix else "")


def findings(store: Folder = None, shared: str | None = None) -> Iterator[Finding]:
    """What `exmesh doctor` finds: the state of the store's file system, of libraries and of the GPU."""
    return examine(open_store(store, shared), packs())


def examine(store: Store, packs: Packs) -> Iterator[Finding]:
    """Everything that a run needs of this machine."""
    facts = machine_facts()
    yield Finding(OK, "version", f"exmesh-graph {facts['exmesh_graph']}, Python {facts['python']}, {facts['platform']}")
    yield Finding(OK, "processor", f"{facts['cpus']} cores of {facts['processor']}, {facts['memory_gib']} GiB memory")
    yield from _store(store)
    yield from _shared(store)
    yield from _packs(packs)
    yield from _libraries(packs)
    yield from _system()
    yield _gpu()


def examine_gpu() -> Iterator[Finding]:
    """Every accelerated operation on CUDA and on the CPU, in a process of its own: `device: auto` goes by it."""
    finding = _gpu()
    yield finding
    if finding.state != OK or finding.found.startswith("none"):
        return
    from exmesh_graph.gpu.verdict import faults_of, remember, run_check

    outcomes = run_check("cuda")
    remember(outcomes)
    for outcome in outcomes:
        state, found = (WARN, outcome["fault"]) if outcome["fault"] else (OK, "as on the CPU")
        yield Finding(state, str(outcome["operation"]), f"{found} ({outcome['seconds']:.1f} s)")
    if faults_of(outcomes):
        fix = "update the driver, torch or warp-lang; or say device: cuda, and look at the results"
        yield Finding(WARN, "device: auto", "takes the CPU on this machine", fix)


def _store(store: Store) -> Iterator[Finding]:
    home = next(path for path in (store.root, *store.root.parents) if path.is_dir())
    free = shutil.disk_usage(home).free
    state = FAIL if free < EMPTY else WARN if free < LOW else OK
    fix = "" if state == OK else "make room (exmesh gc), or put the store elsewhere with --store or $EXMESH_STORE"
    yield Finding(state, "free space", f"{shown_bytes(free)} at {store.root}", fix)
    try:
        with tempfile.TemporaryDirectory(prefix=".doctor-", dir=home, ignore_cleanup_errors=True) as place:
            for what, attempt, state, fix in TRIALS:
                try:
                    yield Finding(OK, f"store, {what}", attempt(Path(place)))
                except (OSError, AssertionError) as error:
                    yield Finding(state, f"store, {what}", f"does not work at {home} ({error})", fix)
    except OSError as error:
        found = f"{home} cannot be written ({error.strerror}): hits are served, nothing new is kept"
        yield Finding(FAIL, "store", found, "allow writing, or name another folder with --store")


def _renames(place: Path) -> str:
    for name, text in (("one", "old"), ("two", "new")):
        (place / name).write_text(text, encoding="utf-8")
    os.replace(place / "two", place / "one")
    assert (place / "one").read_text(encoding="utf-8") == "new", "the old contents are back"
    (place / "folder").mkdir()
    os.rename(place / "folder", place / "moved")
    return "files and folders are renamed in one step"


def _syncs(place: Path) -> str:
    (place / "sync").write_bytes(b"x" * 4096)
    began = time.perf_counter()
    sync(place / "sync")
    return f"a small file is on the disk after {1000 * (time.perf_counter() - began):.1f} ms"


def _locks(place: Path) -> str:
    held = lock(place / "lock")
    assert held is not None
    again = lock(place / "lock")
    for handle in filter(None, (held, again)):
        os.close(handle)
    assert again is None, "a lock can be taken twice"
    return "locks exclude each other"


def _times(place: Path) -> str:
    path, seen = place / "times", set()
    for size in range(3):
        path.write_bytes(b"x" * size)
        seen.add(path.stat().st_mtime_ns)
        time.sleep(0.02)
    assert len(seen) == 3, "file times are coarse"
    return "file times are fine enough to tell edits"


TRIALS: tuple[tuple[str, Callable[[Path], str], str, str], ...] = (
    ("rename", _renames, FAIL, "put the store on another file system with --store"),
    ("fsync", _syncs, FAIL, "put the store on another file system with --store"),
    ("locks", _locks, WARN, "do not let two processes use this store at once, or put it on another file system"),
    ("file times", _times, WARN, "wait a second between an edit and a run"),
)


def _shared(store: Store) -> Iterator[Finding]:
    if store.remote is not None:
        before = len(store.notes)
        store.remote.peek("0" * 64)
        notes = store.notes[before:]
        fix = "check the address and the network" if notes else ""
        yield Finding(WARN if notes else OK, "shared store", notes[0] if notes else f"{store.remote.url} answers", fix)


def _packs(packs: Packs) -> Iterator[Finding]:
    yield Finding(OK if packs.types else FAIL, "node types", str(len(packs.types)), "" if packs.types else "reinstall")
    for module, why in packs.broken.items():
        yield Finding(FAIL, "node pack", f"{module} cannot be imported: {why}", "mend or remove that pack")


def _libraries(packs: Packs) -> Iterator[Finding]:
    """What the code of the nodes imports, and what they declare as part of their keys."""
    users: dict[str, list[str]] = {}
    for name, definition in packs.types.items():
        try:
            for module in outside_imports(definition):
                users.setdefault(module, []).append(name)
        except ExmeshError as error:
            yield Finding(FAIL, name, error.what, error.fix)
    missing = {module: names for module, names in users.items() if not _there(module)}
    yield Finding(OK, "libraries", f"{len(users) - len(missing)} of {len(users)} that nodes import are installed")
    for module, names in sorted(missing.items()):
        more = f" and {len(names) - 4} more" if len(names) > 4 else ""
        yield Finding(WARN, f"library {module}", f"missing; {', '.join(names[:4])}{more} may need it",
                      f"pip install {_distribution(module)}")  # fmt: skip
    yield from _unseen(packs)
    for module, extra in OPTIONAL.items():
        found = "installed" if _there(module) else f"not installed (optional: pip install 'exmesh-graph[{extra}]')"
        yield Finding(OK, f"library {module}", found)


def _unseen(packs: Packs) -> Iterator[Finding]:
    """Places in the code of nodes that depend on what no key holds."""
    users: dict[str, list[str]] = {}
    for name, definition in packs.types.items():
        for place in unseen([definition]):
            users.setdefault(place, []).append(name)
    fix = (
        "make it a parameter or a source, declare code= or libraries=, or end the line with `# not in the key: reason`"
    )
    for place, names in sorted(users.items()):
        yield Finding(WARN, "not in the key", f"{place} ({in_short(names, 3)})", fix)


def _there(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except (ImportError, ValueError):
        return False


def _distribution(module: str) -> str:
    names = {"skimage": "scikit-image", "pxr": "usd-core", "warp": "warp-lang", "ruamel": "ruamel.yaml"}
    return names.get(module, module)


def _system() -> Iterator[Finding]:
    for library, package in SYSTEM.items():
        try:
            ctypes.CDLL(library)
        except OSError:
            yield Finding(WARN, library, "missing; nodes that use Open3D or PyMeshLab need it",
                          f"apt-get install {package}")  # fmt: skip
        else:
            yield Finding(OK, library, "there")


def _gpu() -> Finding:
    command = [sys.executable, "-c", GPU]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        version, name, count = json.loads(done.stdout.strip().splitlines()[-1])
    except (OSError, subprocess.TimeoutExpired, ValueError, IndexError):
        return Finding(FAIL, "torch", "cannot be imported", "pip install torch")
    if name is not None:
        return Finding(OK, "GPU", f"{count} x {name}, torch {version}")
    if shutil.which("nvidia-smi"):
        return Finding(WARN, "GPU", f"torch {version} does not see it", "install the CUDA build of torch")
    return Finding(OK, "GPU", f"none; torch {version} runs on the processor")
