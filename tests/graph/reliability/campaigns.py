"""Campaigns of faults. Each runs in a fresh process of its own (`python campaigns.py NAME FOLDER TRIALS SEED`), whose
forked children are the victims, and prints a JSON report: {trials, misses, facts}."""

from __future__ import annotations

import errno
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path

from faults import Fault, Stuck, end, forked, sleep_until, traced, waited
from worlds import Report, Truth, World, audit, execute, published, random_world, recorded, truth_of, wrong_values

from exmesh_graph.errors import ExmeshError
from exmesh_graph.graph.cache.lease import Leases
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.upkeep.collect import verify
from exmesh_graph.graph.upkeep.pins import pin

Leases.__init__.__defaults__ = (0.3, time.monotonic)  # seconds without a heartbeat, for want of patience

SMALL = World(
    "name: small\nnodes:\n"
    "  a: {type: toy.const, value: 3}\n"
    '  f: {type: toy.folder, number: "@a.number"}\n'
    '  b: {type: toy.read_folder, files: "@f.files"}\n'
    '  walk: {type: toy.count, number: "@b.number", steps: 3}\n'
    'outputs: {figure: "@b.number"}\n',
    {"a": 3.0, "f": 3.0, "b": 3.0, "walk": None},
    "b",
)
NOBODY = 65534
LIMIT = 60.0  # seconds after which a child counts as stuck


def kill_every_step(root: Path, trials: int, dice: random.Random) -> Report:
    """Kill a run before each system call that changes files, and tear each of its writes in half."""
    return _every_step(root, trials, dice, ("kill", "torn"), {-9})


def full_disk(root: Path, trials: int, dice: random.Random) -> Report:
    """From each step on the disk is full."""
    return _every_step(root, trials, dice, ("full",), {0, 3})


def failing_disk(root: Path, trials: int, dice: random.Random) -> Report:
    """Each step fails once with an input/output error."""
    return _every_step(root, trials, dice, ("error",), {0, 3})


def _every_step(root: Path, trials: int, dice: random.Random, kinds: tuple[str, ...], ends: set[int]) -> Report:
    truth = truth_of(SMALL, root / "truth")
    steps = traced(lambda: execute(SMALL, root / "runs", root / "store"), None, LIMIT).steps
    faults = [Fault(kind, n) for kind in kinds for n, name in enumerate(steps, 1) if kind != "torn" or name == "write"]
    report = Report(facts={"steps": len(steps), "faults": len(faults), **Counter(steps)})
    for fault in faults if trials >= len(faults) else sorted(dice.sample(faults, trials), key=lambda f: f.step):
        report.trials += 1
        home = root / f"{fault.kind}{fault.step}"
        after = f"{fault.kind} at step {fault.step} ({steps[fault.step - 1]})"
        try:
            done = traced(partial(_run_or_explain, SMALL, home), fault, LIMIT)
            if done.reached and done.status not in ends:
                report.miss(f"{after}: the run ended with {done.status}")
            audit(SMALL, truth, home, report, after)
        except Stuck as error:
            report.miss(f"{after}: {error}")
        shutil.rmtree(home)
    return report


def _run_or_explain(world: World, root: Path, workers: int = 0) -> None:
    """A run; exit code 3 for an error that says what is wrong with which folder or within which node."""
    try:
        execute(world, root / "runs", root / "store", workers)
    except ExmeshError as error:
        reasons = [*map(os.strerror, (errno.ENOSPC, errno.EIO, errno.EACCES)), "ended by SIGKILL"]
        reason = any(words in str(error) for words in reasons)
        if reason and (str(root) in str(error) or getattr(error, "node", None) in world.values):
            raise SystemExit(3) from None
        raise


def kill_at_random(root: Path, trials: int, dice: random.Random) -> Report:
    """Kill random runs of random graphs at random times."""
    report = Report(facts={"killed": 0, "nodes": 0})
    while report.trials < trials:
        world = random_world(dice, dice.randint(4, 14), slow=0.002)
        home = root / f"w{report.trials}"
        began = time.monotonic()
        truth = truth_of(world, home)
        whole = time.monotonic() - began
        report.facts["nodes"] += len(world.values)
        for _ in range(min(dice.randint(3, 8), trials - report.trials)):
            report.trials += 1
            trial = home / f"t{report.trials}"
            moment = time.monotonic() + dice.uniform(0.0, 1.1 * whole)
            child = forked(partial(execute, world, trial / "runs", trial / "store"))
            sleep_until(moment)
            end_at = _kill(child)
            report.facts["killed"] += end_at == -9
            audit(world, truth, trial, report, f"killed after {moment - began:.3f} s")
        shutil.rmtree(home)
    return report


def kill_workers(root: Path, trials: int, dice: random.Random) -> Report:
    """Kill a runner with two worker processes, or one of these, at random times."""
    report = Report(facts={"runners killed": 0, "workers killed": 0})
    world = random_world(dice, 10, slow=0.1)
    truth = truth_of(world, root / "truth")
    began = time.monotonic()
    execute(world, root / "runs", root / "store", workers=2)
    whole = time.monotonic() - began
    while report.trials < trials:
        report.trials += 1
        home = root / f"t{report.trials}"
        moment = time.monotonic() + dice.uniform(0.1, 0.9) * whole
        runner = forked(partial(_run_or_explain, world, home, 2))
        sleep_until(moment)
        workers = _children(runner)
        if workers and dice.random() < 0.5:
            os.kill(dice.choice(workers), signal.SIGKILL)
            report.facts["workers killed"] += 1
            _expect(runner, (0, 3), report, "the runner")  # 3: the node of that worker failed; 0: it was idle
        else:
            report.facts["runners killed"] += _kill(runner) == -9
            for worker in workers:
                _gone(worker, report)
        audit(world, truth, home, report, "a runner or a worker killed")
        shutil.rmtree(home)
    return report


def _children(process: int) -> list[int]:
    try:
        return [int(word) for word in Path(f"/proc/{process}/task/{process}/children").read_text().split()]
    except OSError:
        return []


def _gone(process: int, report: Report) -> None:
    """A worker must not outlive its runner."""
    end = time.monotonic() + 10
    while Path(f"/proc/{process}/cwd").exists() and time.monotonic() < end:
        time.sleep(0.01)
    if time.monotonic() >= end:
        report.miss(f"the worker {process} outlives its runner")


def two_runners(root: Path, trials: int, dice: random.Random) -> Report:
    """Two runners of one graph at once on one store."""
    return _runners(root, trials, dice, runners=2, kills=0)


def three_runners_with_kills(root: Path, trials: int, dice: random.Random) -> Report:
    """Three runners at once on one store, one or two of them killed at random times."""
    return _runners(root, trials, dice, runners=3, kills=2)


def _runners(root: Path, trials: int, dice: random.Random, runners: int, kills: int) -> Report:
    report = Report(facts={"killed": 0})
    while report.trials < trials:
        report.trials += 1
        world = random_world(dice, dice.randint(6, 12), slow=0.01)
        home = root / f"w{report.trials}"
        truth = truth_of(world, root / f"w{report.trials}-truth")
        start = time.monotonic() + 0.02

        bodies = [partial(_start_at, start, world, home / f"r{n}", home / "store") for n in range(runners)]
        children = [forked(body) for body in bodies]
        victims = children[: dice.randint(1, kills)] if kills else []
        for victim in victims:
            sleep_until(start + dice.uniform(0.0, 0.25))
            report.facts["killed"] += _kill(victim) == -9
        for child in children[len(victims) :]:
            _expect(child, (0,), report, "a runner")
        audit(world, truth, home, report, f"{runners} runners, {len(victims)} killed")
        shutil.rmtree(home)
    return report


def flipped_bits(root: Path, trials: int, dice: random.Random) -> Report:
    """Flip one random bit of one random file of a store at rest."""

    def flip(data: bytes) -> bytes:
        place, bit = dice.randrange(len(data)), dice.randrange(8)
        return data[:place] + bytes([data[place] ^ (1 << bit)]) + data[place + 1 :]

    return _at_rest(root, trials, dice, flip)


def truncated_files(root: Path, trials: int, dice: random.Random) -> Report:
    """Cut one random file of a store at rest to a random shorter length, often to nothing."""
    return _at_rest(root, trials, dice, lambda data: data[: dice.choice([0, dice.randrange(len(data))])])


def _at_rest(root: Path, trials: int, dice: random.Random, spoil: Callable[[bytes], bytes]) -> Report:
    report = Report(facts={})
    kinds: Counter[str] = Counter()
    world, truth = _well_used_store(root, dice)
    while report.trials < trials:
        report.trials += 1
        home = root / f"t{report.trials}"
        shutil.copytree(root / "store", home / "store", symlinks=True)
        files = [p for p in sorted((home / "store").rglob("*")) if p.is_file() and p.stat().st_size]
        rooms = sorted({p.relative_to(home / "store").parts[0] for p in files} - {"work", "quarantine"})
        room = rooms[report.trials % len(rooms)]
        victim = dice.choice([p for p in files if p.relative_to(home / "store").parts[0] == room])
        name = victim.relative_to(home / "store")
        kinds[room] += 1
        before = victim.read_bytes()
        after = spoil(before)
        victim.chmod(0o644)
        victim.write_bytes(after)
        try:
            record = execute(world, root / "runs", home / "store")
        except ExmeshError as error:
            report.miss(f"{name}: the run fails: {error}")
            continue
        store = Store(home / "store")
        wrong = wrong_values(world, record, store, may_refuse=True)
        if published(root / "runs") != world.figure:
            wrong.append("the published figure is wrong")
        if next(row["outputs"] for row in record["nodes"] if row["name"] == "walk")["series"]["digest"] != truth.walk:
            wrong.append("the resumed node ends with other bytes")
        told = (root / "runs" / "latest" / "events.jsonl").read_text()
        found = [*record["store_notes"], *store.notes, *verify(store)]
        if not found and "is not used" not in told and "taken over" not in told and not _harmless(name, before, after):
            wrong.append("nobody noticed")
        report.misses += [f"trial {report.trials}: {name}: {text}" for text in wrong]
        shutil.rmtree(home / "store" / "pins")  # they rightly miss what was lost; nothing else may be wrong
        audit(world, truth, home, report, f"{name} changed")
        shutil.rmtree(home)
    report.facts.update(kinds)
    return report


def _well_used_store(root: Path, dice: random.Random) -> tuple[World, Truth]:
    """root/store: results, a pin, and what a runner leaves that was killed in a node that keeps
    checkpoints: these and its lease. The world returned still needs that node."""
    (root / "number.txt").write_text("4.5")
    os.utime(root / "number.txt", (0, 0))
    base = random_world(dice, 10)
    read = f"  from_file: {{type: toy.file, path: {root}/number.txt}}\n"
    walk = f'  walk: {{type: toy.count, number: "@{base.shown}.number", steps: 8, stop_at: STOP}}\n'

    def world(more: str, values: dict[str, float | None]) -> World:
        return World(base.text.replace("nodes:\n", "nodes:\n" + more), base.values | values, base.shown)

    first = world(read, {"from_file": 4.5})
    execute(first, root / "before", root / "store")
    waited(forked(lambda: execute(world(read + walk.replace("STOP", "6"), {}), root / "before", root / "store")), LIMIT)
    store = Store(root / "store")
    pin(store, "kept", "some results", recorded(root / "store"))
    whole = world(read + walk.replace("STOP", "0"), {"from_file": 4.5, "walk": None})
    truth = truth_of(whole, root / "truth")
    rooms = {path.name for path in store.root.iterdir()}
    assert {"objects", "actions", "leases", "checkpoints", "pins"} <= rooms, rooms
    return whole, truth


def _harmless(name: Path, before: bytes, after: bytes) -> bool:
    """Whether the change has no meaning, or hit what is simply made again."""
    if name.parts[0] in ("sources.json", "code.json", "leases"):  # a lease only saves work
        return True
    try:
        return name.suffix == ".json" and bool(json.loads(before) == json.loads(after))
    except ValueError:
        return False


def read_only_store(root: Path, trials: int, dice: random.Random) -> Report:
    """A store that this user may read but not write: hits are served, anything else is a clear error."""
    report = Report()
    root = Path(tempfile.mkdtemp())  # another user may not enter the folders above `root`
    root.chmod(0o755)
    while report.trials < trials:
        report.trials += 1
        home = root / f"w{report.trials}"
        world, other = random_world(dice, 8), random_world(dice, 9)
        truth = truth_of(world, home)
        for served, status in ((world, 0), (other, 3)):
            home.joinpath("runs").mkdir(exist_ok=True)
            home.joinpath("runs").chmod(0o777)
            child = forked(partial(_run_or_explain, served, home), partial(_may_only_read, home / "store"))
            found = waited(child, LIMIT)
            if found != status:
                report.miss(f"a run of {'hits' if not status else 'misses'} ended with {found}")
        _may_write(home / "store")
        audit(world, truth, home, report, "read-only")
    shutil.rmtree(root)
    return report


def jumping_clock(root: Path, trials: int, dice: random.Random) -> Report:
    """The clock stands still, or jumps by up to a year to and fro, while two runners work on one store."""
    report = Report(facts={"stands still": 0})
    while report.trials < trials:
        report.trials += 1
        home = root / f"w{report.trials}"
        world = random_world(dice, 8, slow=0.01)
        truth = truth_of(world, root / f"w{report.trials}-truth")
        still = dice.random() < 0.25
        report.facts["stands still"] += still
        children = []
        for number in range(2):
            jump = partial(_jump, random.Random(dice.random()), still)
            children.append(forked(partial(execute, world, home / f"r{number}", home / "store"), jump))
        for child in children:
            _expect(child, (0,), report, "a runner")
        audit(world, truth, home, report, "the clock stood still" if still else "the clock jumped")
        shutil.rmtree(home)
    return report


def _may_only_read(store: Path) -> None:
    """Take this process's right to write `store`: by its permissions, and for root by becoming another user."""
    for path in [store, *store.rglob("*")]:
        path.chmod(0o555 if path.is_dir() else 0o444)
    if os.geteuid() == 0:
        os.setuid(NOBODY)


def _may_write(store: Path) -> None:
    for path in [store, *store.rglob("*")]:
        if path.is_dir():
            path.chmod(0o755)


def _jump(dice: random.Random, still: bool) -> None:
    """Take over this process's wall clock; the monotonic clock goes on."""
    real = time.time_ns
    fixed = real()

    def clock() -> int:
        return fixed if still else real() + int(dice.choice([-1, 0, 0, 1]) * dice.random() * 3.15e16)

    time.time_ns = clock
    time.time = lambda: clock() / 1e9


def _expect(child: int, status: tuple[int, ...], report: Report, who: str) -> None:
    try:
        found = waited(child, LIMIT)
    except Stuck as error:
        report.miss(f"{who} is stuck: {error}")
    else:
        if found not in status:
            report.miss(f"{who} ended with {found}")


def _start_at(moment: float, world: World, runs: Path, store: Path) -> None:
    sleep_until(moment)
    execute(world, runs, store)


def _kill(child: int) -> int:
    """Kill a child that may have ended by itself; returns how it ended."""
    found, status = os.waitpid(child, os.WNOHANG)
    if found:
        return os.waitstatus_to_exitcode(status)
    end(child)
    return -9


def main() -> None:
    name, folder, trials, seed = sys.argv[1:]
    root = Path(folder)
    root.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    report = globals()[name](root, int(trials), random.Random(int(seed)))
    report.facts["seconds"] = round(time.monotonic() - began, 1)
    print("REPORT", json.dumps(asdict(report)))


if __name__ == "__main__":
    main()
