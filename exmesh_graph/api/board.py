"""The state of a run as its events tell it, for the live view and for `exmesh status`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

_PLAIN = ("time", "event", "node", "step", "total")


def clock(seconds: float) -> str:
    """`0.12 s`, `12 s`, `3 min 20 s`, `2 h 5 min`."""
    if seconds < 10:
        return f"{seconds:.2f} s"
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


@dataclass
class RunningNode:
    """A running node: when it began, its latest progress event, and where its own steps began to count."""

    began: float
    progress: Mapping[str, Any] = field(default_factory=dict)
    first: tuple[float, int] | None = None

    def left(self, now: float) -> float | None:
        """Seconds to go at the pace of its steps in this run; None where that cannot be said yet."""
        if not self.progress or self.first is None:
            return None
        time, done = self.first
        steps = self.progress["step"] - done
        pace = (self.progress["time"] - time) / steps if steps > 0 else None
        if pace is None:
            return None
        return max(0.0, pace * (self.progress["total"] - self.progress["step"]) - (now - self.progress["time"]))

    def text(self, now: float) -> str:
        """`120/500  loss 0.0123  psnr 24.1  12 s left`, or how long it runs."""
        if not self.progress:
            return clock(now - self.began)
        event, left = self.progress, self.left(now)
        figures = "".join(f"  {name} {value:.4g}" for name, value in event.items() if name not in _PLAIN)
        return f"{event['step']}/{event['total']}{figures}" + ("" if left is None else f"  {clock(left)} left")


class Board:
    """What has come of each node so far."""

    def __init__(self) -> None:
        self.states: dict[str, str] = {}
        self.seconds: dict[str, float] = {}
        self.running: dict[str, RunningNode] = {}
        self.finished: list[str] = []
        self.expected: dict[str, float] = {}
        self.began = self.last = 0.0
        self.end = ""

    def take(self, event: Mapping[str, Any]) -> None:
        """Account for an event; kinds it does not know change nothing."""
        kind, node = event["event"], event.get("node", "")
        self.last = event["time"]
        if kind == "run_started":
            self.began = event["time"]
            self.states = dict.fromkeys(event["nodes"], "waiting")
        elif kind == "nodes_added":
            self.states |= dict.fromkeys(event["nodes"], "waiting")
        elif kind == "expected":
            self.expected = dict(event["seconds"])
        elif kind == "node_started":
            self.states[node] = "running"
            self.running[node] = RunningNode(event["time"])
        elif kind == "progress" and node in self.running:
            active = self.running[node]
            active.progress = event
            if active.first is None:
                active.first = (
                    (active.began, 0) if event["step"] * 20 <= event["total"] else (event["time"], event["step"])
                )
        elif kind in ("node_finished", "node_failed", "node_blocked"):
            self.running.pop(node, None)
            self.states[node] = event.get("state", kind.removeprefix("node_"))
            if node not in self.seconds:  # else it was made again
                self.finished.append(node)
            self.seconds[node] = float(event.get("seconds", 0.0))
        elif kind == "run_finished":
            self.end = event["state"]
            for name in self.running:
                self.states[name] = "interrupted"
            self.running.clear()

    def count(self, *states: str) -> int:
        return sum(state in states for state in self.states.values())

    def left(self, now: float) -> float | None:
        """Seconds to the end as earlier runs took; None where a node never ran. Nodes that turn out hits shorten it."""
        waiting = [name for name, state in self.states.items() if state == "waiting"]
        if not self.running or any(name not in self.expected for name in waiting):
            return None
        total = sum(self.expected[name] for name in waiting)
        for name, active in self.running.items():
            left = active.left(now)
            if left is None and name not in self.expected:
                return None
            total += max(0.0, self.expected.get(name, 0.0) - (now - active.began)) if left is None else left
        return total / len(self.running)


def board_of(run: Path) -> Board:
    """The board of a run folder, from its events; lines that are cut off or not events are left out."""
    board = Board()
    with (run / "events.jsonl").open(encoding="utf-8", errors="replace") as lines:
        for line in lines:
            event = event_of(line)
            if event is not None:
                board.take(event)
    return board


def event_of(line: str) -> dict[str, Any] | None:
    """The event in a line of events.jsonl."""
    try:
        event = json.loads(line)
        return event if isinstance(event["event"], str) and isinstance(event["time"], int | float) else None
    except (ValueError, KeyError, TypeError):
        return None
