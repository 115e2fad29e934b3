"""Plans of the open graph, made beside the answers: one at a time, and while runs go on only now and then."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotYet
from typing import Any

from exmesh_graph.graph.cache.store import Store
from exmesh_graph.studio.document import Judged
from exmesh_graph.studio.plans import plan_facts

EVERY = 20.0
"""Seconds at least between two plans while a run goes on."""
FRESH = 10.0
"""Seconds for which a plan is given to whoever asks anew: code, photographs and the store may be others by then."""
Plan = dict[str, Any]


class Planner:
    """The plan of the graph that is open; `store` opens the store anew, so that what other processes did counts."""

    def __init__(self, store: Callable[[], Store]) -> None:
        self._store = store
        self._work = ThreadPoolExecutor(1, "studio-plan")
        self._known: tuple[Judged, int, Future[Plan]] | None = None
        self._made = 0.0  # when the plan that is known was ready
        self._ticks = 0  # grows when runs may have changed the plan
        self._again_after = 0.0
        self._lock = threading.Lock()

    def plan(self, judged: Judged) -> Plan:
        """The plan of a graph without faults."""
        return self._planning(judged).result()

    def ahead(self, judged: Judged) -> None:
        """Begin a plan that nobody asked for yet: most of the first one is reading the code of all nodes."""
        if judged.checked is not None:
            self._planning(judged)

    def soon(self, judged: Judged, wait: float, later: Callable[[], None]) -> Plan | None:
        """The plan where it is ready within `wait` seconds; else None, and `later` is called once it is."""
        known = self._known
        if known is not None and known[2].done() and time.monotonic() - self._made > FRESH:
            self._ticks += 1
        work = self._planning(judged)
        try:
            return work.result(wait)
        except NotYet:
            work.add_done_callback(lambda done: later())
            return None

    def ran(self, judged: Judged, ended: bool, later: Callable[[], None] | None) -> None:
        """A run finished nodes, or ended: the plan may be another now.

        Where somebody looks on, it is made at once, and `later` is called then. While runs go on this costs them at
        most a two-hundredth.
        """
        if not ended and time.monotonic() < self._again_after:
            return
        began = time.monotonic()
        self._ticks += 1
        if later is None or judged.checked is None:
            self._again_after = began + EVERY
            return
        self._again_after = began + 600
        tell = later

        def done(work: Future[Plan]) -> None:
            self._again_after = time.monotonic() + max(EVERY, 200 * (time.monotonic() - began))
            tell()

        self._planning(judged).add_done_callback(done)

    def close(self) -> None:
        self._work.shutdown(wait=False, cancel_futures=True)

    def _planning(self, judged: Judged) -> Future[Plan]:
        with self._lock:
            known = self._known
            if known is None or known[0] is not judged or known[1] != self._ticks:
                known = self._known = judged, self._ticks, self._work.submit(self._planned, judged)
            return known[2]

    def _planned(self, judged: Judged) -> Plan:
        assert judged.checked is not None
        told = plan_facts(judged.checked, self._store())
        self._made = time.monotonic()
        return told
