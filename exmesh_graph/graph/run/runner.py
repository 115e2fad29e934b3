"""Running a graph: hits from the store, the rest as jobs on a backend, every result stored at once.

The key of each node is taken from the recorded digests of its inputs as soon as these are known, so that equal outputs
stop a cascade. A job starts when its tokens are free, the one with the longest path behind it first. Nodes that share
a key run once: the second waits and finds the record of the first.
"""

from __future__ import annotations

import bisect
import contextlib
import heapq
import shlex
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

from exmesh_graph.errors import ExmeshError, StoreError
from exmesh_graph.graph.cache.fingerprint import fingerprint, remember_in
from exmesh_graph.graph.cache.keys import key_of
from exmesh_graph.graph.cache.records import NOTHING, Action, Stored
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.language.check import Bound, Checked
from exmesh_graph.graph.machine import machine_facts
from exmesh_graph.graph.run.backends import Backend
from exmesh_graph.graph.run.backends.inline import Inline
from exmesh_graph.graph.run.job import BROKEN, DONE, FAILED, FIGURES, STOPPED, Job, Outcome, failure, job_of
from exmesh_graph.graph.run.plan import preimage_for
from exmesh_graph.graph.run.rundir import RunFolder, failure_file, log_file, past_seconds
from exmesh_graph.graph.run.schedule import Claims, Pool, remaining_seconds

Listener = Callable[[Mapping[str, Any]], None]
_ASK = 0.3  # seconds between looks at a result that another process computes
_GRACE = {True: 60.0, False: 3.0}  # seconds to stop in, for nodes that are resumable and for others
HIT, WAITING, RUNNING, BLOCKED, INTERRUPTED = "hit", "waiting", "running", "blocked", "interrupted"


class NodeFailed(ExmeshError):
    """Nodes failed. `cause` is the first one's error where it is at hand, `record` what its failure file holds."""

    code = "node"

    def __init__(self, records: list[Mapping[str, Any]], cause: BaseException | None) -> None:
        self.records, self.record, self.cause = records, records[0], cause
        self.node = str(self.record["node"])
        super().__init__(self.record["message"], where=self.node)


class Run:
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
        overrides: tuple[str, ...] = (),
        backend: Backend | None = None,
        tokens: Mapping[str, float] | None = None,
        keep_going: bool = False,
        checkpoint_every: float = 30.0,
    ) -> None:
        self.graph, self.store, self.folder, self.listener = graph, store, folder, listener
        self.force, self.keep_going, self.tokens = set(force or ()), keep_going, tokens or {}
        self.checkpoint_every = checkpoint_every
        self.alone = alone or command  # the command without --node, for the replay of one node
        self.backend: Backend = Inline(store) if backend is None else backend
        self.nodes = {n: b for n, b in graph.nodes.items() if targets is None or n in targets}
        self.index = {name: index for index, name in enumerate(self.nodes)}
        self.names = list(self.nodes)
        self.outputs: dict[str, dict[str, Stored]] = {}
        self.users: Counter[tuple[str, str]] = Counter()
        self.below: dict[str, list[str]] = {name: [] for name in self.nodes}
        for name, bound in self.nodes.items():
            self.users.update((link.node, link.port) for link in bound.inputs.values())
            for above in {link.node for link in bound.inputs.values()}:
                self.below[above].append(name)
        self.missing = {name: len({link.node for link in b.inputs.values()}) for name, b in self.nodes.items()}
        self.ready = [index for name, index in self.index.items() if not self.missing[name]]
        self.queue: list[tuple[float, int]] = []  # misses, the most urgent first
        self.planned: dict[str, tuple[str, Mapping[str, Any]]] = {}
        self.running: dict[str, tuple[Job, float]] = {}
        self.claims = Claims(store.root, lambda n, text: self._emit({"event": "log", "node": n, "message": text}))
        self.needed: Counter[str] = Counter()  # digests that nodes to come will read
        self.remade: set[str] = set()
        self.stopping = False
        self.failures: list[Mapping[str, Any]] = []
        self.cause: BaseException | None = None
        self.pool: Pool | None = None
        self.packs = tuple(graph.packs.modules())
        self.remaining: Mapping[str, float] = {}
        self.saved, self.save_cost = 0.0, 0.0
        self.rows: dict[str, dict[str, Any]] = {
            name: {"name": name, "type": bound.definition.type, "state": WAITING, "key": None, "seconds": 0.0,
                   "spent": 0.0, "outputs": {}, "warnings": []}
            for name, bound in self.nodes.items()
        }  # fmt: skip
        self.record: dict[str, Any] = {
            "id": folder.id, "graph": graph.name, "file": str(graph.file), "command": command,
            "overrides": list(overrides), "state": "unfinished", "started": time.time(), "machine": machine_facts(),
            "store": str(store.below or store.root), "resolved": graph.resolved(), "nodes": list(self.rows.values()),
            "published": {},
        }  # fmt: skip

    def run(self) -> dict[str, Any]:
        """Run everything; returns the record. Raises NodeFailed or KeyboardInterrupt, with the record written."""
        with self.graph.packs:
            return self._run()

    def _run(self) -> dict[str, Any]:
        started = time.perf_counter()
        self.store.sweep()
        self.store.note_runs(self.folder.path.parent)
        self._look_at_code()
        self._save(now=True)
        self._emit({"event": "run_started", "run": self.folder.id, "nodes": list(self.nodes)})
        state = FAILED
        try:
            self._loop()
            if self.failures:
                raise NodeFailed(self.failures, self.cause) from self.cause
            state = DONE
        except KeyboardInterrupt:
            state = INTERRUPTED
            self._stop()
            raise
        finally:
            self.backend.close()
            for name in self.running:
                self.rows[name]["state"] = INTERRUPTED
            self.claims.close()
            if self.running:
                self.store.sweep()
            self.store.close()
            self.record["store_notes"] = list(self.store.notes)
            self.record["machine"] = machine_facts()
            self.finish(state, time.perf_counter() - started)
        return self.record

    def finish(self, state: str, seconds: float) -> None:
        """Write the final state."""
        self.record.update(state=state, seconds=seconds, finished=time.time())
        self._save(now=True)
        self._emit({"event": "run_finished", "state": state, "seconds": round(seconds, 3)})

    def _look_at_code(self) -> None:
        """Take all fingerprints now, beside the imports: what is edited later must not pass for what runs."""
        remember_in(self.store.code)
        with contextlib.suppress(ExmeshError):  # told of where the node is planned
            for bound in self.nodes.values():
                for definition in bound.definitions():
                    fingerprint(definition)

    def _loop(self) -> None:
        while True:
            while self.ready and self._going():
                self._plan(self.names[heapq.heappop(self.ready)])
            self._dispatch()
            if self.ready and self._going():
                continue
            if not self.running and not (self.claims.elsewhere and self._going()):
                return
            for outcome in self.backend.poll(_ASK if self.claims.elsewhere else 1.0, self._emit):
                self._take(outcome)

    def _stop(self) -> None:
        """Let running nodes write a checkpoint and end; those that do not are killed."""
        self.stopping = True
        self.backend.stop()
        self._emit({"event": "stopping", "nodes": list(self.running)})
        began = time.monotonic()
        while self.running:
            for outcome in self.backend.poll(0.2, self._emit):
                self._take(outcome)
            for name in list(self.running):
                grace = _GRACE[self.nodes[name].definition.resumable]
                if time.monotonic() - began > grace:
                    self.backend.cancel(name)
                    self._take(Outcome(name, STOPPED))
        self.store.sweep()

    def _going(self) -> bool:
        return self.keep_going or not self.failures

    def _plan(self, name: str) -> None:
        """Take a node whose inputs are known as a hit, or queue it."""
        started = time.perf_counter()
        bound = self.nodes[name]
        if self.missing[name] or self.rows[name]["state"] != WAITING or name in self.planned:
            return  # an input is being made again, or it was queued twice
        try:
            preimage = preimage_for(bound, self.store, lambda node, port: self.outputs[node][port])
            key = key_of(preimage)
            action = None if name in self.force else self._look_up(bound, preimage)
        except ExmeshError as error:
            self._fail(name, failure(name, error), None)
            return
        self.rows[name]["key"] = key if action is None else action.key
        if action is not None:
            self._settle(name, HIT, action.outputs, action.info, time.perf_counter() - started)
            return
        if not self.remaining:
            past = past_seconds(self.folder.path, self.graph.name)
            self.remaining = remaining_seconds(self.nodes, past)
            self._emit({"event": "expected", "seconds": past})
        self.planned[name] = key, preimage
        bisect.insort(self.queue, (-self.remaining[name], self.index[name]))

    def _look_up(self, bound: Bound, preimage: Mapping[str, Any]) -> Action | None:
        action = self.store.find(preimage)
        if action is None or set(action.outputs) != set(bound.signature.outputs):
            return None
        shown = [link.port for link in self.graph.outputs.values() if link.node == bound.name]
        sound = all(self.store.sound(action.outputs[p].digest) for p in shown if action.outputs[p] != NOTHING)
        return action if sound else None

    def _dispatch(self) -> None:
        """Start what is queued, as far as tokens go and no twin of it runs."""
        if not self.queue or not self._going():
            return
        if self.pool is None:
            self.pool = Pool({**self.backend.capacity(), **self.tokens}, self.backend.largest())
            self.store.save()  # what was learned about the code, for workers
        busy = {self.rows[name]["key"] for name in self.running}
        for entry in list(self.queue):
            if self.pool.free["jobs"] < 1:
                return
            name = self.names[entry[1]]
            key, preimage = self.planned[name]
            if key in busy:
                continue
            try:
                wanted = self.pool.wish(self.nodes[name])
                if not self.pool.fits(wanted) or not self.claims.take(name, key):
                    continue
                action = None if name in self.force else self._look_up(self.nodes[name], preimage)
            except ExmeshError as error:
                self.queue.remove(entry)
                self._fail(name, failure(name, error), None)
                continue
            self.queue.remove(entry)
            if action is not None:  # made meanwhile by a twin
                self.claims.give_back(name)
                self._settle(name, HIT, action.outputs, action.info, 0.0)
                continue
            busy.add(key)
            self._start(name, preimage, wanted)

    def _start(self, name: str, preimage: Mapping[str, Any], wanted: dict[str, float]) -> None:
        assert self.pool is not None
        devices = self.pool.take(name, wanted)
        job = job_of(
            self.nodes[name], self.graph.nodes, preimage, self.store, graph=self.graph.name, run=self.folder.id,
            threads=max(1, int(wanted["cpu"])), devices=devices, log=str(log_file(self.folder.path, name)),
            checkpoint_every=self.checkpoint_every, packs=self.packs,
        )  # fmt: skip
        self.rows[name]["state"] = RUNNING
        self.running[name] = job, time.perf_counter()
        self._emit({"event": "node_started", "node": name})
        self._save()
        self.backend.submit(job)

    def _take(self, outcome: Outcome) -> None:
        """Note how a job ended."""
        name = outcome.name
        job, started = self.running.pop(name)
        assert self.pool is not None
        self.pool.give_back(name)
        self.claims.give_back(name)
        if outcome.state == DONE:
            self.store.share(self.rows[name]["key"])
            self._settle(name, DONE, outcome.outputs, outcome.info, time.perf_counter() - started)
        elif outcome.state == STOPPED or self.stopping:
            self.rows[name]["state"] = INTERRUPTED
        elif outcome.state == BROKEN:
            self._make_again(name, outcome)
        else:
            self._fail(name, outcome, job, time.perf_counter() - started)

    def _settle(
        self, name: str, state: str, outputs: Mapping[str, Stored], info: Mapping[str, Any], spent: float
    ) -> None:  # fmt: skip
        """A node's outputs are known: publish them, let go of its inputs, look at the nodes below."""
        row, bound = self.rows[name], self.nodes[name]
        self.outputs[name] = dict(outputs)
        row.update(state=state, outputs={port: vars(stored) for port, stored in outputs.items()}, spent=spent)
        row.update({figure: info[figure] for figure in FIGURES if figure in info})
        try:
            self._publish(name)
        except ExmeshError as error:
            self._fail(name, failure(name, error), None, spent)
            return
        unused = [stored.digest for stored in outputs.values()]
        for port, stored in outputs.items():
            self.needed[stored.digest] += self.users[name, port]
        for link in bound.inputs.values():
            self.users[link.node, link.port] -= 1
            if link.node in self.outputs:  # else it is being made again
                unused.append(self.outputs[link.node][link.port].digest)
                self.needed[unused[-1]] -= 1
        self.backend.forget(digest for digest in unused if self.needed[digest] <= 0)
        for below in self.below[name]:
            self._look_again(below)
        self._emit({"event": "node_finished", "node": name, "state": state, "seconds": row["seconds"], "spent": spent})
        self._save()

    def _look_again(self, name: str) -> None:
        """Make a node ready when all it needs is known."""
        self.missing[name] = len({link.node for link in self.nodes[name].inputs.values()} - self.outputs.keys())
        if not self.missing[name] and self.rows[name]["state"] == WAITING and name not in self.planned:
            heapq.heappush(self.ready, self.index[name])

    def _make_again(self, name: str, outcome: Outcome) -> None:
        """An input's bytes in the store are broken: run the node that made it again, then this one."""
        link = self.nodes[name].inputs[outcome.info["port"]]
        self.rows[name]["state"] = WAITING
        del self.planned[name]
        stored = self.outputs.get(link.node, {}).get(link.port)
        if stored is not None and not self.store.sound(stored.digest):
            if link.node in self.remade:
                error = StoreError(f"the output {link.port} of {link.node} is broken again", fix="check the disk")
                self._fail(name, failure(name, error), None)
                return
            self._emit({"event": "log", "node": link.node, "message": f"made again: {outcome.info['note']}"})
            self.remade.add(link.node)
            self.force.add(link.node)
            self.planned.pop(link.node, None)
            for old in self.outputs.pop(link.node).values():
                self.needed.pop(old.digest, None)
            self.rows[link.node]["state"] = WAITING
            self.users.update((above.node, above.port) for above in self.nodes[link.node].inputs.values())
            for below in (link.node, *self.below[link.node]):
                self._look_again(below)
        self._look_again(name)

    def _publish(self, node: str) -> None:
        for name, link in self.graph.outputs.items():
            done = name in self.record["published"]
            if link.node == node and self.outputs[node][link.port] != NOTHING and not done:
                path = self.folder.publish(name, self.outputs[node][link.port], self.store)
                self.record["published"][name] = str(path.relative_to(self.folder.path))

    def _fail(self, name: str, outcome: Outcome, job: Job | None, spent: float = 0.0) -> None:
        """Note a failure; what lies below is blocked."""
        row, bound = self.rows[name], self.nodes[name]
        row.update(state=FAILED, spent=spent)
        known = {p: self.outputs[link.node][link.port] for p, link in bound.inputs.items() if link.node in self.outputs}
        error = {field: value for field, value in outcome.info.items() if field != "warnings"}
        record = {
            "node": name, "type": bound.definition.type, **error, "key": row["key"],
            "inputs": {port: str(link) for port, link in bound.inputs.items()},
            "input_digests": {port: vars(stored) for port, stored in known.items()},
            "params": bound.params.model_dump(mode="json"), "seed": bound.seed,
            "run_again": self.record["command"], "replay": f"{self.alone} --node {shlex.quote(name)}",
            "argv": sys.argv, "job": None if job is None else job.to_json(),
            "file": failure_file(name),
        }  # fmt: skip
        self.folder.write(record["file"], record)
        if not self.failures:
            self.folder.write("failure.json", record)
            self.cause = outcome.cause
        self.failures.append(record)
        self._emit({"event": "node_failed", "node": name, "message": outcome.info["message"]})
        if self.keep_going:
            todo = [name]
            while todo:
                for below in self.below[todo.pop()]:
                    if self.rows[below]["state"] == WAITING:
                        self.rows[below]["state"] = BLOCKED
                        self._emit({"event": "node_blocked", "node": below})
                        todo.append(below)
        self._save()

    def _emit(self, event: Mapping[str, Any]) -> None:
        stamped = {"time": round(time.time(), 3), **event}
        self.folder.event(stamped)
        self.listener(stamped)

    def _save(self, now: bool = False) -> None:
        """Write run.json, between start and end at most so often that it costs a twentieth of the time."""
        began = time.monotonic()
        if not now and began - self.saved < max(0.5, 20 * self.save_cost):
            return
        readable = self.record["state"] != "unfinished" and len(self.nodes) <= 200
        self.folder.write("run.json", self.record, 1 if readable else None)  # compact is much faster
        self.saved = time.monotonic()
        self.save_cost = self.saved - began
