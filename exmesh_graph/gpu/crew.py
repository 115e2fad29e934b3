"""Threads that help with a launch. They wait without spinning, so several solvers of a process may share them.

An executor of `concurrent.futures` does the same and takes longer: it makes, locks and waits for a future, also where
the caller has done all the work before a thread woke up.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from queue import SimpleQueue

Job = tuple[Callable[[], None], list[None], "SimpleQueue[BaseException | None]"]

_jobs: SimpleQueue[Job] = SimpleQueue()
_started: list[threading.Thread] = []
_starting = threading.Lock()


def together(work: Callable[[], None], helpers: int) -> None:
    """Call `work` here and on up to `helpers` threads at the same time; returns when all calls that began have ended.

    Whoever comes when the caller is done does not begin. Raises what any call raised.
    """
    _ready(helpers)
    tickets: list[None] = [None] * helpers
    ended: SimpleQueue[BaseException | None] = SimpleQueue()
    for _ in range(helpers):
        _jobs.put((work, tickets, ended))  # not in the key: its threads
    faults: list[BaseException | None] = []
    try:
        work()
    finally:
        begun = helpers
        while _taken(tickets):
            begun -= 1
        faults = [ended.get() for _ in range(begun)]
    for fault in faults:
        if fault is not None:
            raise fault


def _taken(tickets: list[None]) -> bool:
    """Take a ticket, which is atomic; False where there is none left."""
    try:
        tickets.pop()
    except IndexError:
        return False
    return True


def _ready(helpers: int) -> None:
    """So many threads, but no more than there are cores beside the caller's (three at least: solvers share them)."""
    wanted = min(helpers, max(len(os.sched_getaffinity(0)) - 1, 3))  # not in the key: how many work
    if len(_started) >= wanted:
        return
    with _starting:
        while len(_started) < wanted:
            # a daemon: nobody waits for it at the interpreter's end, when no launch is under way
            # not in the key: its threads
            thread = threading.Thread(target=_serve, args=(_jobs,), name=f"exmesh-core-{len(_started)}", daemon=True)
            thread.start()
            _started.append(thread)  # not in the key: its threads


def _serve(jobs: SimpleQueue[Job]) -> None:
    while True:
        work, tickets, ended = jobs.get()
        if _taken(tickets):
            fault: BaseException | None = None
            try:
                work()
            except BaseException as error:
                fault = error
            ended.put(fault)
            del fault
        del work, tickets, ended  # what a launch was for must not live until the next


def _forget() -> None:
    """A forked child has none of its parent's threads, nor may it wait on their queue."""
    global _jobs, _starting  # not in the key: its threads
    _jobs, _starting = SimpleQueue(), threading.Lock()
    _started.clear()  # not in the key: its threads


os.register_at_fork(after_in_child=_forget)
