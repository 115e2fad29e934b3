"""What a run shows while it runs: a live table on a terminal, plain lines anywhere else."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import typer

from exmesh_graph.cli.show import clock
from exmesh_graph.graph.check import Checked
from exmesh_graph.graph.run import Listener

if TYPE_CHECKING:
    from rich.table import Table

_SHOWN = 12  # finished nodes kept on the screen
_EVERY = 5.0  # seconds between progress lines without a terminal
_PLAIN = ("time", "event", "node", "step", "total")


@contextlib.contextmanager
def view(graph: Checked, run: str) -> Iterator[Listener]:
    """A listener for the run's events that shows them."""
    from rich.console import Console

    console = Console(stderr=False)
    if not console.is_terminal:
        yield _Plain(graph).listen
        return
    from rich.live import Live

    table = _Live(graph, run)
    with Live(get_renderable=table.render, console=console, refresh_per_second=5) as live:
        table.say = live.console.print
        yield table.listen


class _Plain:
    """One line per finished node, progress now and then."""

    def __init__(self, graph: Checked) -> None:
        self.types = {name: bound.definition.type for name, bound in graph.nodes.items()}
        self.total, self.done, self.last, self.began = 0, 0, 0.0, 0.0

    def listen(self, event: Mapping[str, Any]) -> None:
        kind, node = event["event"], event.get("node", "")
        if kind == "run_started":
            self.total = len(event["nodes"])
        elif kind == "node_started":
            self.began = self.last = time.monotonic()
        elif kind == "progress" and time.monotonic() - self.last >= _EVERY:
            self.last = time.monotonic()
            typer.echo(f"          {node}  {progress_text(event, self.last - self.began)}")
        elif kind == "warning":
            typer.echo(f"          {node}: warning: {event['message']}")
        elif kind == "node_finished":
            self.done += 1
            count = f"[{self.done}/{self.total}]"
            seconds = "" if event["state"] == "hit" else f"  {clock(event['seconds'])}"
            typer.echo(f"{count:>9} {event['state']:<5}{node}  {self.types[node]}{seconds}")


class _Live:
    """A table that redraws itself: the last finished nodes, the running one, how many wait."""

    def __init__(self, graph: Checked, run: str) -> None:
        self.types = {name: bound.definition.type for name, bound in graph.nodes.items()}
        self.run, self.total, self.waiting = run, 0, 0
        self.finished: list[tuple[str, str, float]] = []
        self.running: str | None = None
        self.progress: Mapping[str, Any] = {}
        self.began = self.started = time.monotonic()
        self.say: Any = None

    def listen(self, event: Mapping[str, Any]) -> None:
        kind = event["event"]
        if kind == "run_started":
            self.total = self.waiting = len(event["nodes"])
        elif kind == "node_started":
            self.running, self.progress, self.began = event["node"], {}, time.monotonic()
        elif kind == "progress":
            self.progress = event
        elif kind == "warning" and self.say is not None:
            self.say(f"{event['node']}: warning: {event['message']}", markup=False, highlight=False)
        elif kind in ("node_finished", "node_failed"):
            state = event.get("state", "failed")
            self.finished.append((event["node"], state, float(event.get("seconds", 0.0))))
            self.running, self.waiting = None, self.waiting - 1

    def render(self) -> Table:
        from rich.table import Table
        from rich.text import Text

        table = Table.grid(padding=(0, 2))
        colours = {"hit": "cyan", "done": "green", "failed": "red"}
        earlier = len(self.finished) - _SHOWN
        if earlier > 0:
            table.add_row(Text(f"... {earlier} more", style="dim"))
        for name, state, seconds in self.finished[-_SHOWN:]:
            spent = "" if state == "hit" else clock(seconds)
            table.add_row(Text(state, style=colours.get(state, "")), Text(name), Text(self.types[name], "dim"), spent)
        if self.running is not None:
            elapsed = time.monotonic() - self.began
            words = progress_text(self.progress, elapsed) if self.progress else clock(elapsed)
            kind = Text(self.types[self.running], "dim")
            table.add_row(Text("run", style="yellow"), Text(self.running), kind, Text(words))
        total = clock(time.monotonic() - self.started)
        table.add_row(Text("", "dim"), Text(f"{self.waiting} of {self.total} to go, {total}", style="dim"))
        return table


def progress_text(event: Mapping[str, Any], elapsed: float) -> str:
    """`120/500  loss 0.0123  psnr 24.1  12 s left`."""
    step, total = event["step"], event["total"]
    figures = "".join(f"  {name} {value:.4g}" for name, value in event.items() if name not in _PLAIN)
    left = f"  {clock(elapsed / step * (total - step))} left" if 0 < step < total else ""
    return f"{step}/{total}{figures}{left}"
