"""Kernels on every core: one launch shared by threads, the same bytes for any number of them.

Warp runs a CPU kernel on the thread that launches it, without the interpreter's lock, so threads share the work. What
a piece of work is depends on its size alone, and each result has one owner: who computes it changes no bit of it.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import pairwise
from typing import Any, TypeVar

import torch

from exmesh_graph.gpu.crew import together
from exmesh_graph.gpu.warp_runtime import convert, launch, launch_converted
from exmesh_graph.resources import usable_cores

Result = TypeVar("Result")

HANDING = 30e-6
"""Seconds that each core costs a launch that is shared: Python hands the work out, one core after another."""
_LONG = 0.7
"""Of the work, in the first run of each core."""
_count: ContextVar[int] = ContextVar("exmesh_cores", default=0)
_launched: set[Any] = set()
_seconds: dict[Any, float] = {}
"""Of each kernel: what an item took, as last seen. Who computes an item changes no byte, so this may be wrong."""
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
    token = _count.set(count)  # not in the key: how many cores work
    try:
        yield workers()
    finally:
        _count.reset(token)


def split(kernel: Any, size: int, *arguments: Any, grain: int) -> None:
    """Launch `kernel` over [0, size), in pieces of `grain` items, runs of which the cores of `cores()` take in turn.

    The kernel's first parameter is `first: int`, and its item is `first + wp.tid()`; `arguments` are the others, as
    for `launch`. Items must not write what other items read or write; sums belong to an item, or to a piece (number
    item // grain), and are added up by the caller in their order. On CUDA this is one launch with first = 0. Launches
    that are too short to be worth it stay on this thread.
    """
    device = next(a.device for a in arguments if isinstance(a, torch.Tensor))
    count = min(workers(), -(-size // grain))
    # the first launch of a kernel compiles its module: on one thread
    if count <= 1 or device.type != "cpu" or kernel not in _launched:
        launch(kernel, size, 0, *arguments)
        # not in the key: what is compiled
        _launched.add(kernel)
        return
    count = min(count, paying(size * _seconds.get(kernel, math.inf)))
    if count <= 1:
        began = time.perf_counter()
        launch(kernel, size, 0, *arguments)
        _seconds[kernel] = (time.perf_counter() - began) / size  # not in the key: how many cores work
        return
    converted = convert(kernel, (0, *arguments))[1:]
    runs = iter(_runs(size, count, grain))  # shared: taking the next one is atomic
    took: list[float] = []

    def work() -> None:
        for first, items in runs:
            began = time.perf_counter()
            launch_converted(kernel, items, [first, *converted])
            took.append((time.perf_counter() - began) / items)

    together(work, count - 1)
    _seconds[kernel] = min(took)  # the others waited for Python too  # not in the key: how many cores work


def paying(seconds: float) -> int:
    """How many cores end a launch of t = `seconds` on one core soonest: the n for which t / n + n `HANDING` is least.

    That is the first with n (n + 1) >= t / `HANDING`, from where on one more costs more than it takes off.
    """
    return math.ceil((math.sqrt(1 + 4 * min(seconds / HANDING, 1e12)) - 1) / 2)


def _runs(size: int, count: int, grain: int) -> list[tuple[int, int]]:
    """[0, size) in runs (first, items) of whole pieces: a long one for each core, then a short one for even ends.

    More of them cost more: a launch takes the interpreter's lock for some microseconds.
    """
    pieces = -(-size // grain)
    long = max(1, int(_LONG * pieces / count))
    short = max(1, -(-(pieces - long * count) // count))
    ends = [min(long * k, pieces) for k in range(count + 1)]
    ends += range(ends[-1] + short, pieces, short)
    ends = list(dict.fromkeys([*ends, pieces]))
    return [(grain * a, min(grain * b, size) - grain * a) for a, b in pairwise(ends)]


def share(function: Callable[..., Result], *items: Iterable[Any]) -> list[Result]:
    """[function(a, b, ...) for a, b, ... in zip(*items)], calls shared by the cores of `cores()`.

    For calls that leave the interpreter's lock (torch, numpy, decoders) and do not depend on one another. `items` are
    taken when a core will soon be free, so few of those that come from a generator are there at a time. A call has one
    core: what it splits itself stays on its thread.
    """
    return list(shared(function, *items))


def shared(function: Callable[..., Result], *items: Iterable[Any]) -> Iterator[Result]:
    """The results of `share`, one after another: few more are made than were asked for."""
    count = workers()
    if count <= 1:
        yield from (function(*each) for each in zip(*items, strict=True))
        return

    def alone(*each: Any) -> Result:
        with cores(1):  # a new thread does not know of the caller's block
            return function(*each)

    waiting: deque[Future[Result]] = deque()
    with ThreadPoolExecutor(count, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        for each in zip(*items, strict=True):
            if len(waiting) > count:
                yield waiting.popleft().result()
            waiting.append(pool.submit(alone, *each))
        yield from (future.result() for future in waiting)


def scratch(name: str, size: int, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    """At least `size` elements of CPU memory, not cleared, that this thread keeps under `name` for the next call.

    Fresh memory is paged in by the kernel of the operating system at every step; this is paged in once. Never return
    it, or a view of it, to a caller.
    """
    kept: dict[str, torch.Tensor] = _own.__dict__  # not in the key: room to be written over
    if name not in kept or len(kept[name]) < size or kept[name].dtype != dtype:
        kept[name] = torch.empty(size, dtype=dtype)  # not in the key: the same room
    return kept[name]
