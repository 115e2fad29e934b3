"""What a run shows while it runs: a live table on a terminal, plain lines anywhere else."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Literal, Protocol

from exmesh_graph.api.board import Board, clock
from exmesh_graph.graph.language.check import Checked
from exmesh_graph.graph.run.runner import Listener

if TYPE_CHECKING:
    from rich.table import Table

    from exmesh_graph.api.results import Run

_SHOWN = 12  # finished nodes kept on the screen
_EVERY, _SHARE = 5.0, 0.1  # a plain progress line at most every 5 s, and every tenth of the node's time
_BAR = 20  # columns


Progress = bool | Literal["auto"]


class Display(Protocol):
    """How a notebook shows a run: a listener while it runs, and its summary at the end."""

    def view(self, graph: Checked, run: str) -> contextlib.AbstractContextManager[Listener]: ...

    def finish(self, run: Run) -> None: ...


notebook: Display | None = None  # set by the room that draws there


@contextlib.contextmanager
def listening(progress: Progress, listener: Listener | None, graph: Checked, run: str) -> Iterator[Listener]:
    """One listener for a run's events: the view that `progress` asks for, and `listener`."""
    shown: contextlib.AbstractContextManager[Listener]
    if progress and in_notebook() and notebook is not None:
        shown = notebook.view(graph, run)
    elif progress is True or (progress == "auto" and sys.stdout.isatty()):
        shown = view(graph, run)
    else:
        shown = contextlib.nullcontext(lambda event: None)
    with shown as show:

        def listen(event: Mapping[str, Any]) -> None:
            show(event)
            if listener is not None:
                listener(event)

        yield listen


def finished(run: Run) -> None:
    """The last picture of a run that was shown in a notebook."""
    if notebook is not None:
        notebook.finish(run)


def in_notebook() -> bool:
    """Whether this is the kernel of a notebook."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython else None
    return shell is not None and "IPKernelApp" in getattr(shell, "config", {})


@contextlib.contextmanager
def view(graph: Checked, run: str) -> Iterator[Listener]:
    """A listener for the run's events that shows them."""
    from rich.console import Console

    console = Console(stderr=False)
    types = _Types({name: bound.definition.type for name, bound in graph.nodes.items()})
    if not console.is_terminal:
        yield Plain(types).listen
        return
    from rich.live import Live

    table = _Live(types)
    with Live(get_renderable=table.render, console=console, refresh_per_second=5) as live:
        table.say = live.console.print
        yield table.listen


class _Types(dict[str, str]):
    """Node types by name; `fit[2]` is one of the nodes that `fit` stands for."""

    def __missing__(self, name: str) -> str:
        return self.get(name.rpartition("[")[0], "")


class Plain:
    """One line for each finished node, progress now and then; no control codes."""

    def __init__(self, types: Mapping[str, str]) -> None:
        self.types, self.board = types, Board()
        self.next: dict[str, float] = {}

    def listen(self, event: Mapping[str, Any]) -> None:
        kind, node, now = event["event"], event.get("node", ""), event["time"]
        self.board.take(event)
        if kind == "node_started":
            self.next[node] = now + _EVERY
        elif kind == "progress" and now >= self.next.get(node, 0.0):
            active = self.board.running[node]
            self.next[node] = now + max(_EVERY, _SHARE * (now - active.began))
            print(f"          {node}  {active.text(now)}")
        elif kind == "warning":
            print(f"          {node}: warning: {event['message']}")
        elif kind == "stopping" and event["nodes"]:
            print(f"          stopping {', '.join(event['nodes'])}; once more to kill")
        elif kind == "node_blocked":
            print(f"          blocked {node}")
        elif kind in ("node_finished", "node_failed"):
            count = f"[{len(self.board.finished)}/{len(self.board.states)}]"
            state = self.board.states[node]
            seconds = f"  {clock(event['seconds'])}" if state == "done" else ""
            line = f"{count:>9} {state:<4} {node}  {self.types[node]}{seconds}".rstrip()
            print(line, flush=state != "hit")


class _Live:
    """A table that redraws itself: the last finished nodes, the running ones with bars, how many wait."""

    def __init__(self, types: Mapping[str, str]) -> None:
        self.types, self.board = types, Board()
        self.lock = threading.Lock()  # the screen is drawn by a thread of rich
        self.say: Any = None

    def listen(self, event: Mapping[str, Any]) -> None:
        with self.lock:
            self.board.take(event)
        if event["event"] == "warning":
            self.say(f"{event['node']}: warning: {event['message']}", markup=False, highlight=False)
        elif event["event"] == "stopping" and event["nodes"]:
            self.say(f"stopping {', '.join(event['nodes'])}; once more to kill", markup=False, highlight=False)

    def render(self) -> Table:
        with self.lock:
            return self._table(self.board, time.time())

    def _table(self, board: Board, now: float) -> Table:
        from rich.progress_bar import ProgressBar
        from rich.table import Table
        from rich.text import Text

        table = Table.grid(padding=(0, 2))
        colours = {"hit": "cyan", "done": "green", "failed": "red"}
        if len(board.finished) > _SHOWN:
            table.add_row(Text(f"... {len(board.finished) - _SHOWN} more", style="dim"))
        for name in board.finished[-_SHOWN:]:
            state = board.states[name]
            spent = clock(board.seconds[name]) if state == "done" else ""
            table.add_row(Text(state, style=colours.get(state, "")), Text(name), Text(self.types[name], "dim"), spent)
        for name, active in board.running.items():
            row: list[Any] = [
                Text("run", style="yellow"),
                Text(name),
                Text(self.types[name], "dim"),
                Text(active.text(now)),
            ]
            if active.progress:
                row.append(ProgressBar(active.progress["total"], active.progress["step"], _BAR))
            table.add_row(*row)
        left = board.left(now)
        words = f"{board.count('waiting', 'running')} of {len(board.states)} to go, {clock(now - board.began)}"
        table.add_row(Text(""), Text(words + ("" if left is None else f", about {clock(left)} left"), style="dim"))
        return table
