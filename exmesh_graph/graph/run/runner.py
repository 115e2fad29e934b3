"""Running a graph: hits from the store, the rest as jobs on a backend, every result stored at once.

The key of each node is taken from the recorded digests of its inputs as soon as these are known, so that equal outputs
stop a cascade. A node that needs what turned out to be absent does not run, nor does what needs it. A job starts when
its tokens are free, the one with the longest path behind it first. Nodes that share a key run once: the second waits
and finds the record of the first.
"""

from __future__ import annotations

import bisect
import contextlib
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from exmesh_graph.errors import ExmeshError, StoreError
from exmesh_graph.graph.cache.fingerprint import fingerprint, remember_in
from exmesh_graph.graph.cache.keys import LIST, NOTHING, Action, Stored, elements, key_of
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.language.check import Bound, Checked
from exmesh_graph.graph.language.links import Link
from exmesh_graph.graph.run.backends import Backend, Inline
from exmesh_graph.graph.run.job import BROKEN, DONE, FAILED, FIGURES, STOPPED, Job, Outcome, failure, job_of
from exmesh_graph.graph.run.lists import fed, gathered, lacking, mapped, whole
from exmesh_graph.graph.run.plan import IDLE, preimage_for
from exmesh_graph.graph.run.rundir import BLOCKED, HIT, INTERRUPTED, RUNNING, WAITING, Listener, RunFolder, RunRecord
from exmesh_graph.graph.run.schedule import Dataflow, KeyLeases, Pool, remaining_seconds

_ASK = 0.3  # seconds between looks at a result that another process computes
_LONGEST = 60.0  # seconds before a node is tried again
_GRACE = {True: 60.0, False: 3.0}  # seconds to stop in, for nodes that are resumable and for others


class NodeFailed(ExmeshError):
    """Nodes failed. `cause` is the first one's error where it is at hand, `record` what its failure file holds."""

    code = "node"

    def __init__(self, records: list[Mapping[str, Any]], cause: BaseException | None) -> None:
        self.records, self.record, self.cause = records, records[0], cause
        self.node = str(self.record["node"])
        super().__init__(self.record["message"], where=self.node)


class Runner:
    """One run of a checked graph. `record` is what run.json holds; it is up to date at any time."""

    def __init__(
        self,
        graph: Checked,
        store: Store,
        folder: RunFolder,
        listener: Listener,
        *,
        targets: set[str] | None = None,
        force: set[str] | None = None,
        command: str = "",
        alone: str = "",
        overrides: Iterable[str] = (),
        backend: Backend | None = None,
        tokens: Mapping[str, float] | None = None,
        keep_going: bool = False,
        checkpoint_every: float = 30.0,
    ) -> None:
        self.graph, self.store, self.folder = graph, store, folder
        self.force, self.keep_going, self.tokens = set(force or ()), keep_going, tokens or {}
        self.checkpoint_every = checkpoint_every
        self.alone = alone or command  # the command without --node, for the replay of one node
        self.here = Inline(store)  # for jobs that only this process can do
        self.backend: Backend = backend or self.here
        self.nodes = {n: b for n, b in graph.nodes.items() if targets is None or n in targets}
        self.flow = Dataflow(self.nodes)
        self.log = RunRecord(graph, self.nodes, store, folder, listener, command, overrides)
        self.record, self.rows = self.log.record, self.log.rows
        self.queue: list[tuple[float, int]] = []  # misses, the most urgent first
        self.planned: dict[str, Mapping[str, Any]] = {}  # pre-images
        self.running: dict[str, tuple[Job, float]] = {}
        self.leases = KeyLeases(store.root, lambda n, text: self.log.emit("log", node=n, message=text))
        self.remade: set[str] = set()
        self.tries: Counter[str] = Counter()  # of nodes that failed for causes that may pass
        self.later: dict[str, float] = {}  # {node: when it is tried again}, by the monotonic clock
        self.stopping = False
        self.failures: list[Mapping[str, Any]] = []
        self.cause: BaseException | None = None
        self.pool: Pool | None = None
        self.packs = tuple(graph.packs.modules())
        self.remaining: dict[str, float] = {}
        self.wires: dict[str, Mapping[str, Link]] = {}  # of what is planned
        self.parts: dict[str, list[str]] = {}  # of nodes with `each`, the nodes that they stand for

    def run(self) -> dict[str, Any]:
        """Run everything; returns the record. Raises NodeFailed or KeyboardInterrupt, with the record written."""
        with self.graph.packs:
            return self._run()

    def _run(self) -> dict[str, Any]:
        started = time.perf_counter()
        self.store.sweep()
        self.store.note_runs(self.folder.path.parent)
        self._look_at_code()
        self.log.save(now=True)
        self.log.emit("run_started", run=self.folder.id, nodes=list(self.nodes))
        state = FAILED
        try:
            self._loop()
            if self.failures:
                raise NodeFailed(self.failures, self.cause) from self.cause
            missing = [name for name in self.nodes if self.rows[name]["state"] not in (DONE, HIT, IDLE)]
            if missing:
                what = f"the run ended without {', '.join(missing)}"
                raise ExmeshError(what, fix="a fault of the framework: tell us")
            state = DONE
        except KeyboardInterrupt:
            state = INTERRUPTED
            self._stop()
            raise
        finally:
            self.here.close()
            self.backend.close()
            for name in self.running:
                self.rows[name]["state"] = INTERRUPTED
            self.leases.close()
            if self.running:
                self.store.sweep()
            self.store.close()
            self.log.finish(state, time.perf_counter() - started)
        return self.record

    def _look_at_code(self) -> None:
        """Take all fingerprints now, beside the imports: what is edited later must not pass for what runs."""
        remember_in(self.store.code)
        with contextlib.suppress(ExmeshError):  # told of where the node is planned
            for bound in self.nodes.values():
                for definition in bound.definitions():
                    fingerprint(definition)

    def _loop(self) -> None:
        while True:
            while self._going() and (name := self.flow.next()) is not None:
                self._plan(name)
            self._dispatch()
            if self.flow.ready and self._going():
                continue
            waiting = bool(self.leases.elsewhere or self.later)
            if not self.running and not (waiting and self._going()):
                return
            self._poll(_ASK if waiting else 1.0)

    def _poll(self, timeout: float) -> None:
        """Take what ended. A job of a script or a notebook runs in here."""
        beside = self.backend is not self.here and self.here.waiting
        done = self.backend.poll(0.0 if beside else timeout, self.log.forward)
        if beside:
            if not self.stopping:
                why = "runs in the calling process: what a script or a notebook defines cannot go to another one"
                self.log.emit("log", node=beside[0].name, message=why)
            done += self.here.poll(0.0, self.log.forward)
        for outcome in done:
            self._take(outcome)

    def _stop(self) -> None:
        """Let running nodes write a checkpoint and end; those that do not are killed."""
        self.stopping = True
        self.here.stop()
        self.backend.stop()
        self.log.emit("stopping", nodes=list(self.running))
        began = time.monotonic()
        while self.running:
            self._poll(0.2)
            for name in list(self.running):
                if time.monotonic() - began > _GRACE[self.nodes[name].definition.resumable]:
                    self.here.cancel(name)
                    self.backend.cancel(name)
                    self._take(Outcome(name, STOPPED))
        self.store.sweep()

    def _going(self) -> bool:
        return self.keep_going or not self.failures

    def _plan(self, name: str) -> None:
        """Take a node whose inputs are known as a hit, or queue it."""
        started = time.perf_counter()
        bound = self.nodes[name]
        if self.flow.waits(name) or self.rows[name]["state"] != WAITING or name in self.planned:
            return  # an input is being made again, or it was offered twice
        if wire := lacking(bound, self.flow.outputs):
            self.log.emit("log", node=name, message=f"not needed: {wire} carries nothing")
            self._settle(name, IDLE, dict.fromkeys(bound.signature.outputs, NOTHING), {}, 0.0)
            return
        if bound.each:
            self._map(bound)
            return
        try:
            preimage = preimage_for(bound, self.store, self.flow.outputs)
            self.wires[name] = {port: link for port, (link, _) in fed(bound, self.flow.outputs).items()}
            action = self._look_up(bound, preimage)
        except ExmeshError as error:
            self._fail(name, failure(name, error), None)
            return
        self.rows[name]["key"] = key_of(preimage)
        if action is not None:
            self._settle(name, HIT, action.outputs, action.info, time.perf_counter() - started)
            return
        if not self.remaining:
            past = self.folder.past("seconds")
            self.remaining = remaining_seconds(self.nodes, past)
            self.log.emit("expected", seconds=past)
        self.planned[name] = preimage
        bisect.insort(self.queue, (-self.remaining[name], self.flow.rank[name]))

    def _map(self, bound: Bound) -> None:
        """A node for each element of a list, when that is known; what they make is gathered when it is all there."""
        name = bound.name
        if name not in self.parts:
            try:
                parts = mapped(bound, self.flow.outputs)
            except ExmeshError as error:
                self._fail(name, failure(name, error), None)
                return
            self.parts[name] = [part.name for part in parts]
            self.nodes.update({part.name: part for part in parts})
            self.remaining.update({part: self.remaining.get(name, 0.0) for part in self.parts[name] if self.remaining})
            self.force |= {*self.parts[name]} if name in self.force else set()
            self.log.add(parts, name)
            self.flow.spread(name, parts)
        if not self.flow.waits(name):
            hits = all(self.rows[part]["state"] == HIT for part in self.parts[name])
            made = gathered(bound, [self.flow.outputs[part] for part in self.parts[name]])
            self._settle(name, HIT if hits else DONE, made, {}, 0.0)

    def _look_up(self, bound: Bound, preimage: Mapping[str, Any]) -> Action | None:
        """The sound record of a node, unless it is to run in any case."""
        action = None if bound.name in self.force else self.store.find(preimage)
        if action is None or not whole(action.outputs, bound.signature):
            return None
        owner = bound.name if bound.name in self.graph.nodes else bound.name.rpartition("[")[0]
        ports = [link.port for link in self.graph.outputs.values() if link.node == owner]
        shown = [one for port in ports for one in elements(action.outputs, port)]
        sound = all(self.store.sound(action.outputs[p].digest) for p in shown if action.outputs[p] != NOTHING)
        return action if sound else None

    def _dispatch(self) -> None:
        """Start what is queued, as far as tokens go and no twin of it runs."""
        if not self.queue or not self._going():
            return
        if self.pool is None:
            offered = {**self.backend.capacity(), **self.tokens}
            self.pool = Pool(offered, self.backend.largest(), self.folder.past("peak_rss"))
            self.store.save()  # what was learned about the code, for workers
        keys = {self.rows[name]["key"] for name in self.running}
        for entry in list(self.queue):
            if self.pool.free["jobs"] < 1:
                return
            name = self.flow.names[entry[1]]
            key, preimage = self.rows[name]["key"], self.planned[name]
            if key in keys or self.later.get(name, 0.0) > time.monotonic():
                continue
            try:
                wanted = self.pool.wanted(self.nodes[name])
                if not self.pool.fits(wanted) or not self.pool.roomy(name) or not self.leases.take(name, key):
                    continue
                action = self._look_up(self.nodes[name], preimage)
            except ExmeshError as error:
                self.queue.remove(entry)
                self._fail(name, failure(name, error), None)
                continue
            self.queue.remove(entry)
            self.later.pop(name, None)
            if action is not None:  # made meanwhile by a twin
                self.leases.give_back(name)
                self._settle(name, HIT, action.outputs, action.info, 0.0)
                continue
            keys.add(key)
            self._start(name, preimage, wanted, self.pool.take(name, wanted))

    def _start(
        self, name: str, preimage: Mapping[str, Any], wanted: Mapping[str, float], devices: tuple[int, ...]
    ) -> None:
        assert self.pool is not None
        threads = max(1, int(self.pool.most["cpu"] if name in self.pool.any_number else wanted["cpu"]))
        job = job_of(
            self.nodes[name], self.graph, preimage, self.store, self.wires[name], run=self.folder.id,
            threads=threads, devices=devices, log=str(self.folder.log(name)),
            checkpoint_every=self.checkpoint_every, packs=self.packs,
        )  # fmt: skip
        self.rows[name]["state"] = RUNNING
        self.running[name] = job, time.perf_counter()
        self.log.emit("node_started", node=name)
        self.log.save()
        place = self.here if job.is_of_main() else self.backend
        if place is self.here and job.limits.keys() - {"retries"}:
            why = "its limits are not kept: it runs in the process of the run, which would end with it"
            self.log.emit("warning", node=name, message=why)
        place.submit(job)
        self._divide_cores()

    def _divide_cores(self) -> None:
        """Say how many cores each running node may use, since one has come or gone."""
        assert self.pool is not None
        for name, cores in self.pool.cores().items():
            self.backend.grant(name, cores)

    def _take(self, outcome: Outcome) -> None:
        """Note how a job ended."""
        name = outcome.name
        job, started = self.running.pop(name)
        assert self.pool is not None
        self.pool.give_back(name)
        self._divide_cores()
        self.leases.give_back(name)
        if outcome.state == FAILED:
            self.store.sweep()  # a process that was killed leaves its work folder
        if outcome.state == DONE:
            self.store.share(self.rows[name]["key"])
            self._settle(name, DONE, outcome.outputs, outcome.info, time.perf_counter() - started)
        elif self.stopping:
            self.rows[name]["state"] = INTERRUPTED
        elif outcome.state == STOPPED:
            what = "was interrupted, though nobody stopped the run: by KeyboardInterrupt in its code, or a signal"
            self._fail(name, failure(name, ExmeshError(what, fix="run it again")), job, time.perf_counter() - started)
        elif outcome.state == BROKEN:
            self._make_again(name, outcome)
        elif outcome.info.get("passes") and self.tries[name] < job.limits.get("retries", 0):
            self._try_again(name, outcome, job.limits["retries"])
        else:
            self._fail(name, outcome, job, time.perf_counter() - started)

    def _try_again(self, name: str, outcome: Outcome, most: float) -> None:
        """A failure whose cause may pass: queue the node for a while later, each time twice as long."""
        wait = min(_LONGEST, 2.0 ** self.tries[name])
        self.tries[name] += 1
        self.rows[name]["state"] = WAITING
        self.later[name] = time.monotonic() + wait
        bisect.insort(self.queue, (-self.remaining[name], self.flow.rank[name]))
        again = f"tried again in {wait:g} s ({self.tries[name]} of {most:g}): {outcome.info['message']}"
        self.log.emit("warning", node=name, message=again)

    def _settle(
        self, name: str, state: str, outputs: Mapping[str, Stored], info: Mapping[str, Any], spent: float
    ) -> None:
        """A node's outputs are known: publish them, let go of its inputs, look at the nodes below."""
        row = self.rows[name]
        shown = {p: s for p, s in outputs.items() if not self.nodes[name].each or s.type == LIST}  # once, by its nodes
        row.update(state=state, outputs={port: vars(stored) for port, stored in shown.items()}, spent=spent)
        row.update({figure: info[figure] for figure in FIGURES if figure in info})
        try:
            self.log.publish(name, outputs)
        except ExmeshError as error:
            self._fail(name, failure(name, error), None, spent)
            return
        unread = self.flow.settle(name, outputs)
        self.here.forget(unread)
        self.backend.forget(unread)
        self.log.emit("node_finished", node=name, state=state, seconds=row["seconds"], spent=spent)
        self.log.save()

    def _make_again(self, name: str, outcome: Outcome) -> None:
        """An input's bytes in the store are broken: run the node that made it again, then this one."""
        link = self.wires[name][outcome.info["port"]]
        self.rows[name]["state"] = WAITING
        del self.planned[name]
        if link.node in self.parts:  # made by one of the nodes that it stands for
            port, _, number = link.port.partition("[")
            if link.node in self.flow.outputs:
                self.rows[link.node]["state"] = WAITING
                self.flow.lose(link.node)
            link = Link(f"{link.node}[{number}", port)
        stored = self.flow.outputs.get(link.node, {}).get(link.port)
        if stored is not None and not self.store.sound(stored.digest):
            if link.node in self.remade:
                error = StoreError(f"the output {link.port} of {link.node} is broken again", fix="check the disk")
                self._fail(name, failure(name, error), None)
                return
            self.log.emit("log", node=link.node, message=f"made again: {outcome.info['note']}")
            self.remade.add(link.node)
            self.force.add(link.node)
            self.planned.pop(link.node, None)
            self.rows[link.node]["state"] = WAITING
            self.flow.lose(link.node)
        self.flow.look_again(name)

    def _fail(self, name: str, outcome: Outcome, job: Job | None, spent: float = 0.0) -> None:
        """Note a failure; what lies below is blocked."""
        self.rows[name].update(state=FAILED, spent=spent)
        first, inputs = not self.failures, self.flow.inputs(name)
        self.failures.append(self.log.failed(self.nodes[name], outcome, inputs, job, self.alone, first))
        self.cause = outcome.cause if first else self.cause
        self.log.emit("node_failed", node=name, message=outcome.info["message"])
        blocked = {name}
        for other in self.nodes if self.keep_going else ():
            if self.rows[other]["state"] == WAITING and self.flow.sources[other] & blocked:
                self.rows[other]["state"] = BLOCKED
                self.log.emit("node_blocked", node=other)
                blocked.add(other)
        self.log.save()
