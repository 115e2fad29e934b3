"""Nodes that crash, hang, print, and go on from checkpoints."""

from __future__ import annotations

import decimal
import io
import os
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Literal

import numpy as np
from threadpoolctl import threadpool_info

from exmesh_graph.errors import DataError, PassingError
from exmesh_graph.graph import Context, Params, node, param
from exmesh_graph.resources import usable_cores
from exmesh_graph.types import Metrics
from toy_pack.nodes import MetricsOut, NoParams, Number, NumberOut, Series, SeriesOut


class CrashParams(Params):
    how: str = param("segfault", doc="segfault, kill, exit, abort, leave, interrupt, signal or nothing.")


class PathParams(Params):
    path: str = param(doc="A file outside of the graph, as a signal between tests and nodes.")


class CountParams(Params):
    steps: int = param(100, ge=1, doc="How far to count.")
    seconds: float = param(0.0, ge=0, tuning=True, doc="For each step.")
    trace: str = param("", tuning=True, doc="A file that gets a line per step.")
    stop_at: int = param(0, ge=0, tuning=True, doc="Kill -9 itself there if it began at 0.")


class MeetParams(Params):
    folder: str = param(tuning=True, doc="Where the parties leave a mark.")
    parties: int = param(2, tuning=True, doc="How many must be there at once.")
    tell: bool = param(False, doc="Return the process it ran in.")


@node("toy.crash", version="1")
def crash(ctx: Context, number: Number, *, p: CrashParams) -> NumberOut:
    """Dies as it is told."""
    print("about to", p.how)
    os.write(2, b"a native library says so\n")
    if p.how == "segfault":
        import ctypes

        ctypes.string_at(0)
    elif p.how == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    elif p.how == "abort":
        os.abort()
    elif p.how == "exit":
        os._exit(7)
    elif p.how == "leave":
        raise SystemExit(3)
    elif p.how == "interrupt":
        raise KeyboardInterrupt
    elif p.how == "signal":
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(5)
    return NumberOut(Number(number.value))


@node("toy.meet", version="1")
def meet(ctx: Context, number: Number, *, p: MeetParams) -> NumberOut:
    """Ends only when all parties run at the same time."""
    folder = Path(p.folder)
    _leave_a_mark(folder)
    end = time.monotonic() + 20
    while len(list(folder.iterdir())) < p.parties:
        if time.monotonic() > end:
            raise DataError("the others did not come")
        time.sleep(0.01)
    return NumberOut(Number(float(os.getpid()) if p.tell else number.value))


def _leave_a_mark(folder: Path) -> None:
    os.close(tempfile.mkstemp(dir=folder)[0])


@node("toy.alone", version="1", resources={"licence": 1})
def alone(ctx: Context, number: Number, *, p: MeetParams) -> NumberOut:
    """Fails when another one runs at the same time."""
    mark = Path(p.folder) / "busy"
    mark.touch(exist_ok=False)
    time.sleep(0.05)
    mark.unlink()
    return NumberOut(Number(number.value))


@node("toy.gpu", version="1", resources={"gpu": 1})
def gpu(ctx: Context, number: Number, *, p: NoParams) -> NumberOut:
    """The number of the one GPU it may see."""
    return NumberOut(Number(float(os.environ["CUDA_VISIBLE_DEVICES"])))


@node("toy.wide", version="1", resources={"cpu": 0})
def wide(ctx: Context, number: Number, *, p: NoParams) -> NumberOut:
    """Its CPU threads, as granted and as native libraries see them, those that are loaded and those to come."""
    assert int(os.environ["OMP_NUM_THREADS"]) == ctx.threads
    assert {pool["num_threads"] for pool in threadpool_info()} == {ctx.threads}
    assert os.environ["OMP_WAIT_POLICY"] == "passive"
    return NumberOut(Number(float(ctx.threads)))


@node("toy.narrow", version="1")
def narrow(ctx: Context, number: Number, *, p: NoParams) -> NumberOut:
    """The process it runs in, in which native libraries use one thread."""
    assert os.environ["OMP_NUM_THREADS"] == "1"
    assert {pool["num_threads"] for pool in threadpool_info()} == {1}
    return NumberOut(Number(float(os.getpid())))


@node("toy.sharing", version="1", resources={"cpu": 0})
def sharing(ctx: Context, number: Number, *, p: MeetParams) -> NumberOut:
    """Has one core of two while another node runs beside it, and both once that has ended."""
    own = len(os.sched_getaffinity(0))
    for cores in (1, 2):
        end = time.monotonic() + 20
        while usable_cores() != min(cores, own):
            if time.monotonic() > end:
                raise DataError(f"{usable_cores()} cores may be used, not {cores}")
            time.sleep(0.01)
        _leave_a_mark(Path(p.folder))  # the other one may end
    return NumberOut(Number(number.value))


@node("toy.who", version="1")
def who(ctx: Context, number: Number, *, p: NoParams) -> NumberOut:
    """The process it runs in."""
    return NumberOut(Number(float(os.getpid())))


@node("toy.where", version="1")
def where(ctx: Context, series: Series, *, p: NoParams) -> NumberOut:
    """The process it runs in."""
    return NumberOut(Number(float(os.getpid())))


@node("toy.count", version="1", resumable=True)
def count(ctx: Context, number: Number, *, p: CountParams) -> SeriesOut:
    """A random walk that can be cut off: each step draws from a generator whose state is kept."""

    generator = np.random.default_rng(ctx.seed)
    values = np.full(4, number.value, np.float32)
    found = ctx.resume()
    first = 0
    if found is not None:
        first, state = found
        values = state["values"]
        generator.bit_generator.state = state["generator"]
    for step in range(first, p.steps):
        if p.stop_at and first == 0 and step == p.stop_at:
            os.kill(os.getpid(), signal.SIGKILL)
        values = values + generator.random(4, np.float32)
        if p.trace:
            with Path(p.trace).open("a") as file:
                file.write(f"{step}\n")
        time.sleep(p.seconds)
        ctx.progress(step + 1, p.steps, value=float(values[0]))
        ctx.checkpoint(step + 1, {"values": values, "generator": generator.bit_generator.state})
    return SeriesOut(Series(values))


@node("toy.undeclared", version="1")
def undeclared(ctx: Context, number: Number, *, p: NoParams) -> NumberOut:
    """Uses checkpoints without saying so."""
    ctx.checkpoint(1, {})
    return NumberOut(number)


@node("toy.hang", version="1")
def hang(ctx: Context, number: Number, *, p: PathParams) -> NumberOut:
    """Runs native code that no signal handler of Python gets in between."""
    Path(p.path).touch()
    sum(range(10**11))
    return NumberOut(number)


@node("toy.dice", version="1", deterministic=False)
def dice(ctx: Context, number: Number, *, p: NoParams) -> NumberOut:
    """Another number each time."""
    return NumberOut(Number(float(int.from_bytes(os.urandom(6)))))


class UntidyParams(Params):
    folder: str = param(tuning=True, doc="To change into.")


@node("toy.untidy", version="1")
def untidy(ctx: Context, number: Number, *, p: UntidyParams) -> NumberOut:
    """Leaves the process other than it was."""
    import random

    import torch

    os.environ["EXMESH_TOY"] = "left behind"
    os.environ.pop("HOME", None)
    os.chdir(p.folder)
    random.seed(1)
    np.random.seed(1)  # noqa: NPY002
    np.seterr(all="raise")
    torch.manual_seed(1)
    torch.set_default_dtype(torch.float64)
    torch.set_num_threads(torch.get_num_threads() + 1)
    torch.set_grad_enabled(False)
    torch.set_default_device("meta")
    torch.set_float32_matmul_precision("medium")
    torch.use_deterministic_algorithms(True)
    np.set_printoptions(precision=2)
    np.seterrcall(print)
    os.environ["TZ"] = "JST-9"
    time.tzset()
    decimal.getcontext().prec = 3
    sys.setrecursionlimit(sys.getrecursionlimit() + 1)
    warnings.simplefilter("error")
    sys.stdout = io.StringIO()
    return NumberOut(Number(number.value + 1))  # else what reads it has a twin before it, and is a hit


class TalkParams(Params):
    megabytes: int = param(1, doc="To print, from Python and as a native library would.")
    messages: int = param(0, doc="Kilobytes of messages.")


@node("toy.talk", version="1")
def talk(ctx: Context, *, p: TalkParams) -> NumberOut:
    """Prints a lot, slowly enough to be watched."""
    for index in range(4 * p.megabytes):
        os.write(2, f"{index:015d}\n".encode() * (2**18 // 16))
        time.sleep(0.01)
    print("the end", flush=True)
    for _ in range(p.messages):
        ctx.log("x" * 1000)
    return NumberOut(Number(1.0))


@node("toy.found", version="1")
def found(ctx: Context, number: Number, *, p: NoParams) -> MetricsOut:
    """What the process is like."""
    import random

    import torch

    return MetricsOut(Metrics({
        "left": os.environ.get("EXMESH_TOY", ""), "home": os.environ.get("HOME", ""), "folder": os.getcwd(),
        "random": random.random(), "numpy": float(np.random.rand()), "errors": np.geterr(), "pid": os.getpid(),  # noqa: NPY002
        "torch": float(torch.rand((), device="cpu")), "dtype": str(torch.get_default_dtype()),
        "threads": torch.get_num_threads(),
        "grad": torch.is_grad_enabled(), "device": str(torch.get_default_device()), "clock": time.localtime(0).tm_hour,
        "matmul": torch.get_float32_matmul_precision(), "strict": torch.are_deterministic_algorithms_enabled(),
        "printed": str(np.array([1 / 3])), "call": repr(np.geterrcall()), "third": str(decimal.Decimal(1) / 3),
        "depth": sys.getrecursionlimit(), "filters": len(warnings.filters), "stdout": type(sys.stdout).__name__,
    }))  # fmt: skip


class GreedyParams(Params):
    seconds: float = param(0.0, ge=0, doc="How long to sleep.")
    megabytes: int = param(0, ge=0, doc="Memory to fill.")
    by_child: bool = param(False, doc="A process of its own fills it.")
    disk: int = param(0, ge=0, doc="Megabytes to write.")


@node("toy.greedy", version="1")
def greedy(ctx: Context, number: Number, *, p: GreedyParams) -> NumberOut:
    """The number, after it took what it was told to take."""
    filled = f"import time; held = bytearray({p.megabytes} << 20); time.sleep({p.seconds})"
    if p.by_child:
        subprocess.run([sys.executable, "-c", filled], check=True)
    else:
        held = bytearray(p.megabytes << 20)
        (ctx.scratch / "large").write_bytes(bytes(p.disk << 20))
        time.sleep(p.seconds)
        del held
    return NumberOut(number)


class FlakyParams(Params):
    folder: str = param(doc="Where it counts its attempts.")
    until: int = param(2, ge=0, doc="The attempt that goes through.")
    how: Literal["network", "own", "fault", "kill"] = param("network", doc="How the others fail.")


@node("toy.flaky", version="1")
def flaky(ctx: Context, number: Number, *, p: FlakyParams) -> NumberOut:
    """The number, at the attempt `until`."""
    place = Path(p.folder) / f"{time.monotonic_ns()}"
    place.touch()
    if len(list(Path(p.folder).iterdir())) < p.until:
        if p.how == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        if p.how == "network":
            raise RuntimeError("no luck") from ConnectionResetError("the other end is gone")
        raise PassingError("busy") if p.how == "own" else ValueError("always so")
    return NumberOut(number)
