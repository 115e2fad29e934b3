"""Whether the tests would notice: each line that trust rests on is spoilt, and a test must fail then.

    python -m benchmarks.mutants                      # all, some twenty minutes
    python -m benchmarks.mutants --only store 41      # those of files whose names hold "store", and number 41
    python -m benchmarks.mutants --list
    python -m benchmarks.mutants --check              # whether each can be set in, without running tests

A mutant is a file, a text that stands in it once, another text, a test file and words for pytest's -k. It is set into
a copy of the tracked files, and its tests run there, and before any mutant once as they are. A mutant lives when they
pass; one that cannot be set in, or whose words choose no test, counts as a fault as well. Ends with 1 for either.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from benchmarks.mutants_list import MUTANTS, Mutant

ROOT = Path(__file__).parent.parent
PATIENCE = 120  # seconds; a mutant that makes a test wait for ever is caught


class Result(NamedTuple):
    words: str
    fine: bool


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", default=[], help="numbers, or parts of file names and groups")
    parser.add_argument("--list", action="store_true", help="say which there are")
    parser.add_argument("--check", action="store_true", help="say which cannot be set in, and run nothing")
    args = parser.parse_args()
    chosen = [
        (number, one)
        for number, one in enumerate(MUTANTS, 1)
        if not args.only or any(word == str(number) or (not word.isdigit() and word in str(one)) for word in args.only)
    ]
    if args.list:
        for number, one in chosen:
            print(number, one.group, one.file, "|", one.old.strip(), "->", one.new.strip())
        return 0
    if args.check:
        print(*misfits(), sep="\n")
        return int(bool(misfits()))
    counts = {"caught": 0, "all": len(chosen)}
    with tempfile.TemporaryDirectory() as folder:
        home = copied(Path(folder) / "copy")
        for number, one in chosen:
            result = tried(home, one)
            counts["caught"] += result.fine
            print(f"{number} {result.words}: {one.file}: {one.old.strip().splitlines()[0][:70]}", flush=True)
    print("{caught} of {all} are caught".format(**counts))
    return int(counts["caught"] < counts["all"])


def misfits() -> list[str]:
    """Mutants that cannot be set in, as their text stands nowhere in their file any more, or in several places."""
    found = []
    for number, one in enumerate(MUTANTS, 1):
        places = (ROOT / one.file).read_text(encoding="utf-8").count(one.old)
        if places != 1:
            found.append(f"{number} {one.file}: {places} places, not one, for {one.old.strip()!r}")
        if one.old == one.new or not (ROOT / one.tests).is_file():
            found.append(f"{number} {one.file}: it changes nothing, or its tests {one.tests} are not there")
    return found


def copied(home: Path) -> Path:
    """The tracked files, where `exmesh_nodes` is their own too."""
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(None, names.split("\0")):
        if (ROOT / name).is_file():
            (home / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, home / name)
    (home / "path").mkdir()
    (home / "path" / "exmesh_nodes").symlink_to(home / "nodes")
    return home


def tried(home: Path, one: Mutant) -> Result:
    """Whether the tests of a mutant pass without it and fail with it."""
    file = home / one.file
    text = file.read_text(encoding="utf-8")
    if text.count(one.old) != 1:
        return Result(f"CANNOT BE SET IN ({text.count(one.old)} places)", False)
    tests = one.tests, one.words
    if tests not in _passed and (code := status(home, tests)) != 0:
        return Result(f"ITS TESTS FAIL WITHOUT IT, or there are none (pytest ends with {code})", False)
    _passed.add(tests)
    put(file, text.replace(one.old, one.new))
    began = time.monotonic()
    try:
        code = status(home, tests)
    finally:
        put(file, text)
    return Result("LIVES" if code == 0 else f"caught in {time.monotonic() - began:.0f} s", code != 0)


_passed: set[tuple[str, str]] = set()  # without a mutant


def put(file: Path, text: str) -> None:
    """Write a source file, with a time that no bytecode was made for."""
    file.write_text(text, encoding="utf-8")
    later = time.time() - 1e6 + 2 * next(_count)
    os.utime(file, (later, later))


_count = itertools.count()


def status(home: Path, tests: tuple[str, str]) -> int:
    """How pytest ends in the copy; 124 where it does not."""
    path, words = tests
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", path]
    environment = {**os.environ, "PYTHONPATH": f"{home}{os.pathsep}{home / 'path'}"}
    process = subprocess.Popen(
        [*command, *(["-k", words] if words else [])], cwd=home, env=environment, start_new_session=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        return process.wait(PATIENCE)
    except subprocess.TimeoutExpired:
        return 124
    finally:
        with contextlib.suppress(ProcessLookupError):  # with the processes that its tests began
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


if __name__ == "__main__":
    raise SystemExit(main())
