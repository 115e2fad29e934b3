"""One run folder as the page sees it, kept up to date by its events: states, seconds, memory, curves, failures."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from exmesh_graph.api.board import Board, event_of
from exmesh_graph.api.results import read_run
from exmesh_graph.errors import ExmeshError
from exmesh_graph.files import Tail
from exmesh_graph.graph.problems import without_rounds
from exmesh_graph.graph.run.plan import IDLE
from exmesh_graph.graph.run.rundir import failure_file, is_alive

_PLAIN = ("time", "event", "node", "step", "total", "message")
POINTS = 500
_HELD = 20_000
_CALM = 2.0
"""Seconds between two tellings of nothing but progress: each costs the run that is watched a little."""
_REPORTING = 600.0  # seconds after its end for which a run's report is waited for
_MOST_RECORD = 64 << 20
_MOST_EVENTS = 64 << 20
"""Bytes of an events file that are read at first, its end; a record that is larger is not read."""


def is_own_file(path: Path, folder: Path) -> bool:
    """Whether a plain file lies in a run folder itself; a link out of it, a pipe or a device is none."""
    return path.is_file() and path.resolve().is_relative_to(folder.resolve())


def is_run(folder: Path) -> bool:
    """Whether a folder can be looked at as a run."""
    return all(is_own_file(folder / name, folder) for name in ("run.json", "events.jsonl"))


class RunView:
    """A run folder. `refresh` reads what is new and tells it as events of the contract."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.id = folder, folder.name
        self.board = Board()
        self.record: Mapping[str, Any] = {}
        self.reason = ""
        self.curves: dict[tuple[str, str], list[tuple[float, float, float]]] = {}
        self.messages: dict[str, str] = {}
        self.stopping = False
        self.alive = False
        self._tail = Tail(folder / "events.jsonl")
        with contextlib.suppress(OSError):
            self._tail.place = max(0, (folder / "events.jsonl").stat().st_size - _MOST_EVENTS)
        self._stamp = 0
        self._reported = False
        self._untold: dict[str, str] = {}  # nodes that are done, whose outputs the record does not show yet
        self._progress: dict[str, dict[str, Any]] = {}  # of each running node the last, not told yet
        self._told = 0.0

    @property
    def rows(self) -> dict[str, Mapping[str, Any]]:
        return {row["name"]: row for row in self.record.get("nodes", ())}

    @property
    def state(self) -> str:
        """running, stopping, done, failed, interrupted, killed or unreadable."""
        if self.reason:
            return "unreadable"
        state = str(self.record.get("state", "unfinished"))
        if state != "unfinished":
            return state
        return ("stopping" if self.stopping else "running") if self.alive else self.board.end or "killed"

    def refresh(self) -> list[tuple[str, dict[str, Any]]]:
        """Read what is new; the events of the contract that it amounts to, progress once for each node."""
        before = self.state
        self.alive = is_alive(self.folder)
        told: list[tuple[str, dict[str, Any]]] = []
        for line in self._tail.lines():
            event = event_of(line)
            if event is not None:
                with contextlib.suppress(KeyError, TypeError, ValueError, AttributeError):  # of another version
                    self.board.take(event)
                    self._note(event, told)
        self._read_record()
        for name in [name for name in self._untold if self.rows.get(name, {}).get("outputs")]:
            told.append(("node", self._node_event(name, self._untold.pop(name))))
        if self._progress and (told or time.monotonic() - self._told > _CALM):
            told += [("progress", one) for one in self._progress.values()]
            self._progress.clear()
            self._told = time.monotonic()
        if told or self.state != before:
            told.append(("run", self.facts()))
        return told

    def has_new_report(self) -> bool:
        """Whether the page of a run that ended a short while ago is there since this was asked last.

        It is written when the run has ended and its folder is let go of, so no event tells of it.
        """
        ended = float(self.record.get("finished") or 0.0)
        before = self._reported or time.time() - ended > _REPORTING
        self._reported = self._reported or (not before and (self.folder / "report.html").is_file())
        return self._reported and not before

    def facts(self) -> dict[str, Any]:
        """RUN of the contract."""
        now = time.time()
        state, record, states = self.state, self.record, self.states()
        live = state in ("running", "stopping")
        started = float(record.get("started", 0.0))
        seconds = record.get("seconds")
        if seconds is None:
            seconds = max(0.0, (now if live else max(self.board.last, started)) - started) if started else 0.0
        return {
            "id": self.id, "graph": str(record.get("graph", "")), "file": str(record.get("file", "")),
            "variant": str((record.get("resolved") or {}).get("variant") or ""), "state": state,
            "reason": self.reason, "started": started, "seconds": float(seconds),
            "left": self.board.left(now) if live else None, "nodes": len(states),
            "ready": sum(each in ("hit", "done", IDLE) for each in states.values()),
            "hits": sum(each == "hit" for each in states.values()),
            "running": list(self.board.running) if live else [],
            "at": [n for n, each in states.items() if each in ("running", "failed", "interrupted")] if not live else [],
            "failed": [name for name, each in states.items() if each == "failed"],
            "sweep": str(record.get("command", "")).startswith("exmesh sweep"),
            "report": (self.folder / "report.html").is_file(),
            "can_stop": live, "can_resume": state in ("failed", "interrupted", "killed") and bool(record),
            "headline": self._headline(), "store": str(record.get("store", "")),
        }  # fmt: skip

    def states(self) -> dict[str, str]:
        """The state of every node: the record's, and where that lags behind, the events'."""
        states = {name: str(row["state"]) for name, row in self.rows.items()}
        if self.record.get("state", "unfinished") == "unfinished":
            states = {**states, **self.board.states}
        return states

    def details(self) -> list[dict[str, Any]]:
        """The nodes of the run, one by one."""
        now, states, rows = time.time(), self.states(), self.rows
        return [self._detail(name, state, rows.get(name, {}), now) for name, state in states.items()]

    def curve_facts(self, node: str = "") -> list[dict[str, Any]]:
        """Curves of what progress events told, at most `POINTS` points each."""
        told = []
        for (name, figure), points in self.curves.items():
            if not node or node in (name, without_rounds(name)):
                kept = points[:: -(-len(points) // POINTS)]
                kept += [points[-1]] if kept[-1] is not points[-1] else []
                x, y, t = (list(axis) for axis in zip(*kept, strict=True))
                told.append({"node": name, "name": figure, "axis": "step", "x": x, "y": y, "t": t})
        return told

    def failure(self, name: str) -> dict[str, Any] | None:
        """What the failure file of a node holds, in short, with its replay line."""
        path = self.folder / failure_file(name)
        if not is_own_file(path, self.folder):
            return None
        with contextlib.suppress(OSError, ValueError, AttributeError):
            told = json.loads(path.read_text(encoding="utf-8"))
            return {
                "message": str(told.get("message", "")), "error": str(told.get("error", "")),
                "traceback": str(told.get("traceback", ""))[-20_000:], "at": str(told.get("at") or ""),
                "replay": f"exmesh replay {path}", "run_again": str(told.get("run_again", "")),
                "node_alone": str(told.get("replay", "")), "file": failure_file(name),
            }  # fmt: skip
        return None

    # --- inside

    def _read_record(self) -> None:
        path = self.folder / "run.json"
        try:
            stamp = path.stat().st_mtime_ns
        except OSError:
            stamp = -1
        if stamp == self._stamp:
            return
        self._stamp = stamp
        before = self.record
        try:
            if path.stat().st_size > _MOST_RECORD:
                raise ValueError("run.json is larger than any that a run writes")
            self.record, self.reason = read_run(self.folder), ""
            json.dumps(self.facts())  # what is passed on must be JSON; a record of another shape fails here
            json.dumps(self.record)
        except (ExmeshError, OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            self.record, self.reason = before, getattr(error, "what", f"{type(error).__name__}: {error}")

    def _note(self, event: Mapping[str, Any], told: list[tuple[str, dict[str, Any]]]) -> None:
        kind, name = event["event"], str(event.get("node", ""))
        common = {"run": self.id, "name": name, "id": without_rounds(name)}
        since = event["time"] - (self.board.began or event["time"])
        if kind == "progress":
            figures = {k: float(v) for k, v in event.items() if k not in _PLAIN and isinstance(v, int | float)}
            for figure, value in figures.items():
                points = self.curves.setdefault((name, figure), [])
                points.append((float(event["step"]), value, since))
                if len(points) > _HELD:
                    del points[1::2]
            active = self.board.running.get(name)
            self._progress[name] = {
                **common, "step": event["step"], "total": event["total"], "figures": figures, "time": event["time"],
                "left": None if active is None else active.left(event["time"]), "t": since,
            }  # fmt: skip
        elif kind in ("log", "warning"):
            self.messages[name] = str(event["message"])
            told.append(("log", {**common, "kind": kind, "text": str(event["message"])[:2000], "time": event["time"]}))
        elif kind == "stopping":
            self.stopping = True
        elif kind in ("node_started", "node_finished", "node_failed", "node_blocked"):
            self._read_record()
            if kind != "node_started":
                self._progress.pop(name, None)  # what has ended has none
            text = str(event.get("message", ""))[:2000]
            told.append(("node", self._node_event(name, text)))
            if kind == "node_finished" and not self.rows.get(name, {}).get("outputs"):
                self._untold[name] = text

    def _node_event(self, name: str, message: str) -> dict[str, Any]:
        row = self.rows.get(name, {})
        return {
            "run": self.id, "name": name, "id": without_rounds(name), "state": self.board.states.get(name, ""),
            "seconds": self.board.seconds.get(name, 0.0), "peak_memory": int(row.get("peak_rss") or 0),
            "outputs": row.get("outputs") or {}, "message": message,
        }  # fmt: skip

    def _detail(self, name: str, state: str, row: Mapping[str, Any], now: float) -> dict[str, Any]:
        active = self.board.running.get(name) if state == "running" else None
        progress = None
        if active is not None and active.progress:
            event = active.progress
            figures = {k: v for k, v in event.items() if k not in _PLAIN and isinstance(v, int | float)}
            progress = {"step": event["step"], "total": event["total"], "left": active.left(now), "figures": figures,
                        "message": self.messages.get(name, "")}  # fmt: skip
        seconds = float(row.get("seconds") or self.board.seconds.get(name, 0.0))
        return {
            "name": name, "id": without_rounds(name), "type": str(row.get("type", "")), "state": state,
            "seconds": now - active.began if active else seconds, "spent": float(row.get("spent") or 0.0),
            "peak_memory": int(row.get("peak_rss") or 0), "began": active.began if active else None,
            "progress": progress, "warnings": [str(text) for text in row.get("warnings") or ()],
            "key": row.get("key"), "outputs": row.get("outputs") or {},
            "failure": self.failure(name) if state == "failed" else None,
        }  # fmt: skip

    def _headline(self) -> dict[str, Any]:
        path = self.folder / "report.json"
        if not is_own_file(path, self.folder):
            return {}
        with contextlib.suppress(OSError, ValueError, AttributeError):
            told = json.loads(path.read_text(encoding="utf-8")).get("headline") or {}
            return {label: {"value": entry.get("value"), "unit": entry.get("unit", "")} for label, entry in
                    list(told.items())[:40]}  # fmt: skip
        return {}


def log_lines(events: Iterable[str], node: str) -> Iterator[dict[str, Any]]:
    """The lines of events.jsonl that tell of a node, or of the run, in words."""
    for line in events:
        event = event_of(line)
        if event is not None and (not node or node in (event.get("node"), without_rounds(str(event.get("node", ""))))):
            told = _words(event)
            if told:
                yield {"kind": "event", "time": event["time"], "node": str(event.get("node", "")), "text": told}


def _words(event: Mapping[str, Any]) -> str:
    kind = event["event"]
    if kind in ("log", "warning"):
        return ("warning: " if kind == "warning" else "") + str(event.get("message", ""))
    told = {
        "run_started": "the run starts", "node_started": "starts", "node_blocked": "blocked: needs what failed",
        "node_failed": f"failed: {event.get('message', '')}", "run_finished": f"the run is {event.get('state', '')}",
        "node_finished": f"{event.get('state', '')} in {float(event.get('seconds') or 0):.2f} s",
        "stopping": "asked to stop",
    }  # fmt: skip
    return told.get(kind, "")
