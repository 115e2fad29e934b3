"""Faults from outside: a child process is traced, and one of its system calls is killed, torn or refused.

Nothing in the framework knows of it. The tracer (ptrace, as strace uses it) stops the child at every system call that
changes the file system and numbers them. `Fault("kill", 7)` kills the child (SIGKILL) before the seventh takes place;
`torn` lets a write take half of its bytes first; `full` answers ENOSPC from there on to all that needs room; `error`
answers EIO once. Linux on x86-64 only; elsewhere `why_not()` says so.
"""

from __future__ import annotations

import ctypes
import errno
import functools
import os
import platform
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

WRITES = {1: "write", 18: "pwrite", 20: "writev", 40: "sendfile", 296: "pwritev", 326: "copy_file_range"}
MAKES = {83: "mkdir", 258: "mkdirat", 88: "symlink", 266: "symlinkat", 86: "link", 265: "linkat", 285: "fallocate"}
OPENS = {2: ("open", "rsi"), 257: ("openat", "rdx"), 85: ("creat", None)}
OTHERS = {
    74: "fsync", 75: "fdatasync", 73: "flock", 76: "truncate", 77: "ftruncate", 82: "rename", 264: "renameat",
    316: "renameat2", 84: "rmdir", 87: "unlink", 263: "unlinkat", 90: "chmod", 91: "fchmod", 268: "fchmodat",
    280: "utimensat", 132: "utime",
}  # fmt: skip
REGISTERS = [
    "r15", "r14", "r13", "r12", "rbp", "rbx", "r11", "r10", "r9", "r8", "rax", "rcx", "rdx", "rsi", "rdi", "orig_rax",
    "rip", "cs", "eflags", "rsp", "ss", "fs_base", "gs_base", "ds", "es", "fs", "gs",
]  # fmt: skip
TRACEME, GETREGS, SETREGS, SYSCALL, SETOPTIONS = 0, 12, 13, 24, 0x4200
OPTIONS = 0x1 | 0x8 | 0x100000  # mark stops at system calls, follow new threads, die with the tracer
ALL_THREADS = 0x40000000


@dataclass(frozen=True)
class Fault:
    """What happens at which step; `step` counts from 1."""

    kind: str
    step: int


@dataclass
class Traced:
    """How a traced child ended: its steps, -9 for killed, and whether the fault was reached."""

    status: int
    steps: list[str] = field(default_factory=list)
    reached: bool = False


class Stuck(Exception):
    """A child did not end in time."""


@functools.cache
def why_not() -> str | None:
    """Why system calls cannot be traced here; None when they can."""
    if not (sys.platform == "linux" and platform.machine() == "x86_64"):
        return "system calls are traced on Linux on x86-64 only"
    try:
        return None if traced(lambda: os.mkdir("/proc/none"), None, 5).steps else "ptrace shows no system calls here"
    except OSError as error:
        return f"ptrace is not allowed here: {error}"


def traced(body: Callable[[], object], fault: Fault | None, timeout: float) -> Traced:
    """Run `body` in a forked child under `fault`. Raises Stuck after `timeout` seconds."""
    child = forked(body, prepare=_ask_to_be_traced)
    child_run = Traced(0)
    try:
        with deadline(timeout):
            os.waitpid(child, 0)
            _ptrace(SETOPTIONS, child, OPTIONS)
            _ptrace(SYSCALL, child)
            _follow(child, fault, child_run)
    except BaseException:
        end(child)
        raise
    return child_run


def forked(body: Callable[[], object], prepare: Callable[[], object] = lambda: None) -> int:
    """A child process that runs `body`; it ends with 0, or with 1 after an exception, which it prints."""
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child:
        return child
    status = 1
    try:
        prepare()
        body()
        status = 0
    except SystemExit as error:
        status = int(error.code or 0)
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
    os._exit(status)


def waited(child: int, timeout: float) -> int:
    """The exit status of a child, -9 for killed. Raises Stuck (and kills it) after `timeout` seconds."""
    try:
        with deadline(timeout):
            return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    except Stuck:
        end(child)
        raise


def end(child: int) -> None:
    """Kill a child and take its remains; gone already is fine."""
    try:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, ALL_THREADS)
    except (ProcessLookupError, ChildProcessError):
        return


@contextmanager
def deadline(seconds: float) -> Iterator[None]:
    """Raises Stuck when the block takes longer."""

    def ring(signum: int, frame: object) -> None:
        raise Stuck(f"no end after {seconds:g} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


class _Registers(ctypes.Structure):
    _fields_ = [(name, ctypes.c_ulonglong) for name in REGISTERS]


@functools.cache
def _library() -> ctypes.CDLL:
    library = ctypes.CDLL(None, use_errno=True)
    library.ptrace.restype = ctypes.c_long
    library.ptrace.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
    return library


def _ptrace(request: int, process: int, data: int | ctypes.Structure | None = None) -> None:
    pointer = ctypes.byref(data) if isinstance(data, ctypes.Structure) else ctypes.c_void_p(data or 0)
    if _library().ptrace(request, process, None, ctypes.cast(pointer, ctypes.c_void_p)) == -1:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))


def _ask_to_be_traced() -> None:
    _ptrace(TRACEME, 0)
    os.kill(os.getpid(), signal.SIGSTOP)


def _follow(child: int, fault: Fault | None, child_run: Traced) -> None:
    inside: dict[int, str | None] = {}  # threads within a system call, and what to do when it returns
    while True:
        thread, status = os.waitpid(-1, ALL_THREADS)
        if os.WIFEXITED(status) or os.WIFSIGNALED(status):
            inside.pop(thread, None)
            if thread == child:
                child_run.status = os.waitstatus_to_exitcode(status)
                return
            continue
        passed_on = 0
        if os.WSTOPSIG(status) == signal.SIGTRAP | 0x80:
            if thread in inside:
                _leave(child, thread, inside.pop(thread))
            else:
                inside[thread] = _enter(child, thread, fault, child_run)
        elif os.WSTOPSIG(status) not in (signal.SIGSTOP, signal.SIGTRAP):
            passed_on = os.WSTOPSIG(status)
        try:
            _ptrace(SYSCALL, thread, passed_on)
        except ProcessLookupError:  # killed meanwhile
            continue


def _enter(child: int, thread: int, fault: Fault | None, child_run: Traced) -> str | None:
    registers = _Registers()
    _ptrace(GETREGS, thread, registers)
    name, needs_room = _step(registers)
    if name is None:
        return None
    child_run.steps.append(name)
    if fault is None or len(child_run.steps) < fault.step or (fault.kind != "full" and child_run.reached):
        return None
    if fault.kind == "torn" and name == "write" and registers.rdx > 1:
        child_run.reached = True
        registers.rdx //= 2
        _ptrace(SETREGS, thread, registers)
        return "kill"
    if fault.kind in ("kill", "torn"):
        child_run.reached = True
        os.kill(child, signal.SIGKILL)
        return None
    if fault.kind == "error" or needs_room:
        child_run.reached = True
        registers.orig_rax = 2**64 - 1  # no such system call: nothing happens
        _ptrace(SETREGS, thread, registers)
        return "ENOSPC" if fault.kind == "full" else "EIO"
    return None


def _leave(child: int, thread: int, what: str | None) -> None:
    if what == "kill":
        os.kill(child, signal.SIGKILL)
    elif what is not None:
        registers = _Registers()
        _ptrace(GETREGS, thread, registers)
        registers.rax = 2**64 - getattr(errno, what)
        _ptrace(SETREGS, thread, registers)


def _step(registers: _Registers) -> tuple[str | None, bool]:
    """(name of a system call that changes files, whether it needs room); None for all others."""
    number = registers.orig_rax
    if number in WRITES:
        return (None, False) if number == 1 and registers.rdi <= 2 else (WRITES[number], True)
    if number in MAKES:
        return MAKES[number], True
    if number in OPENS:
        name, flags = OPENS[number]
        if flags is None or getattr(registers, flags) & (os.O_CREAT | os.O_TRUNC):
            return name, True
        return None, False
    return OTHERS.get(number), False


def sleep_until(moment: float) -> None:
    """Sleep to a moment of `time.monotonic`."""
    time.sleep(max(0.0, moment - time.monotonic()))
