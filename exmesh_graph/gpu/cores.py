"""Kernels on every core: one launch shared by threads, the same bytes for any number of them.

Warp runs a CPU kernel on the thread that launches it, without the interpreter's lock, so threads share the work. What
a piece of work is depends on its size alone, and each result has one owner: who computes it changes no bit of it.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

import torch

from exmesh_graph.gpu.warp_runtime import convert, launch, launch_converted
from exmesh_graph.resources import usable_cores

Result = TypeVar("Result")

_LAUNCHES = 4
_count: ContextVar[int] = ContextVar("exmesh_cores", default=0)
_launched: set[Any] = set()
_pool: ThreadPoolExecutor | None = None
_own = threading.local()


def available() -> int:
    """The cores that this process may use now: a run grants a node more or fewer while it works."""
    return usable_cores()


def workers() -> int:
    """The cores that `split` and `share` take here."""
    return _count.get() or available()


@contextmanager
def cores(count: int) -> Iterator[int]:
    """Let `split` and `share` take `count` cores (0, as without a block: all that the process may use)."""
    token = _count.set(count)
    try:
        yield workers()
    finally:
        _count.reset(token)


def split(kernel: Any, size: int, *arguments: Any, grain: int) -> None:
    """Launch `kernel` over [0, size), in pieces of `grain` items, runs of which the cores of `cores()` take in turn.

    The kernel's first parameter is `first: int`, and its item is `first + wp.tid()`; `arguments` are the others, as
    for `launch`. Items must not write what other items read or write; sums belong to an item, or to a piece (number
    item // grain), and are added up by the caller in their order. On CUDA this is one launch with first = 0.
    """
    device = next(a.device for a in arguments if isinstance(a, torch.Tensor))
    count = min(workers(), -(-size // grain))
    # the first launch of a kernel compiles its module: on one thread
    if count <= 1 or device.type != "cpu" or kernel not in _launched:
        launch(kernel, size, 0, *arguments)
        _launched.add(kernel)
        return
    converted = convert(kernel, (0, *arguments))[1:]
    # a launch costs some 20 us of the interpreter's lock: a few for each core are enough to even out their ends
    run = grain * max(1, size // (grain * count * _LAUNCHES))
    pieces = iter(range(0, size, run))  # shared: taking the next one is atomic

    def work() -> None:
        for first in pieces:
            launch_converted(kernel, min(run, size - first), [first, *converted])

    others = [_threads().submit(work) for _ in range(count - 1)]
    try:
        work()
    finally:
        for other in others:
            other.result()


def share(function: Callable[..., Result], *items: Iterable[Any]) -> list[Result]:
    """[function(a, b, ...) for a, b, ... in zip(*items)], calls shared by the cores of `cores()`.

    For calls that leave the interpreter's lock (torch, numpy, decoders) and do not depend on one another. `items` are
    taken when a core will soon be free, so few of those that come from a generator are there at a time. A call has one
    core: what it splits itself stays on its thread.
    """
    count = workers()
    if count <= 1:
        return [function(*each) for each in zip(*items, strict=True)]

    def alone(*each: Any) -> Result:
        with cores(1):  # a new thread does not know of the caller's block
            return function(*each)

    results: list[Result] = []
    waiting: deque[Future[Result]] = deque()
    with ThreadPoolExecutor(count, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        for each in zip(*items, strict=True):
            if len(waiting) > count:
                results.append(waiting.popleft().result())
            waiting.append(pool.submit(alone, *each))
        return results + [future.result() for future in waiting]


def scratch(name: str, size: int, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    """At least `size` elements of CPU memory, not cleared, that this thread keeps under `name` for the next call.

    Fresh memory is paged in by the kernel of the operating system at every step; this is paged in once. Never return
    it, or a view of it, to a caller.
    """
    kept: dict[str, torch.Tensor] = _own.__dict__
    if name not in kept or len(kept[name]) < size or kept[name].dtype != dtype:
        kept[name] = torch.empty(size, dtype=dtype)
    return kept[name]


def _threads() -> ThreadPoolExecutor:
    """Threads wait without spinning, so several solvers of a process may share them."""
    global _pool
    if _pool is None:
        most = len(os.sched_getaffinity(0))
        _pool = ThreadPoolExecutor(max(most - 1, 3), thread_name_prefix="exmesh-core")
    return _pool


def _forget_threads() -> None:
    """A forked child has none of its parent's threads."""
    global _pool
    _pool = None


os.register_at_fork(after_in_child=_forget_threads)
