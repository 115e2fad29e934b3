"""Graphs and runs in a notebook: the graph's picture with its states, live progress in the cell, the summary."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Mapping
from html import escape
from typing import TYPE_CHECKING, Any

from exmesh_graph.api.board import Board, clock
from exmesh_graph.errors import ExmeshError
from exmesh_graph.graph.problems import GraphErrors
from exmesh_graph.notebook import cells

if TYPE_CHECKING:
    from exmesh_graph.api.builder import Graph
    from exmesh_graph.api.differences import Comparison
    from exmesh_graph.api.planning import Plan
    from exmesh_graph.api.results import NodeRun, Run
    from exmesh_graph.api.sweeps import Sweep
    from exmesh_graph.graph.language.check import Checked
    from exmesh_graph.graph.run.runner import Listener
    from exmesh_graph.report.drawing.svg import GraphPicture

_EVERY = 0.25  # seconds between two pictures of a running run
_LISTED = 8  # finished nodes shown while it runs
_MOST_BOXES = 300

_shown_in: dict[str, int] = {}  # run id -> the cell in which its summary stands already


def graph_html(graph: Graph) -> str:
    """A graph that is being built: its picture where it can be checked, else what it lacks."""
    from exmesh_graph.api.opening import checked_graph

    try:
        return checked_html(checked_graph(graph))
    except GraphErrors as errors:
        return cells.cell(cells.said(repr(graph), "soft"), f"<pre>{escape(str(errors))}</pre>")


def checked_html(graph: Checked) -> str:
    """A graph without faults, with what a run would find in the store and what it would do."""
    from exmesh_graph.api.opening import open_store
    from exmesh_graph.report.drawing.states import picture_of_graph

    return cells.cell(_drawn(picture_of_graph(graph, open_store())))


def plan_html(plan: Plan) -> str:
    """What a run would do with each node, and why."""
    counts = plan.counts
    words = f"{counts['hit']} from the store, {counts['run']} to run, {counts['unknown']} below a node that must run"
    rows = ((step.state, step.name, step.reason) for step in plan if step.state != "hit")
    hits = ", ".join(step.name for step in plan if step.state == "hit")
    listed = cells.folded("from the store", cells.said(hits)) if hits else ""
    return cells.cell(cells.said(words), cells.table(rows), listed)


def sweep_html(sweep: Sweep) -> str:
    """The table of a sweep's variants, and where its page lies."""
    from exmesh_graph.report.sweep.files import sweep_markdown

    lines = sweep_markdown(sweep.table).splitlines()
    rows = [
        [text.strip().strip("`") for text in line.strip("|").split(" | ")] for line in lines if line.startswith("|")
    ]
    note = " ".join(line for line in lines if not line.startswith("|"))
    return cells.cell(cells.table(rows[2:], rows[0]), cells.said(note, "soft"), cells.said(str(sweep.page)))


def difference_html(comparison: Comparison) -> str:
    """Both graphs in one picture, and the difference in words."""
    return cells.cell(f"<pre>{escape(str(comparison))}</pre>", _drawn(comparison.picture()) if comparison else "")


def run_html(run: Run) -> str | None:
    """The summary of a run; None in the cell that shows it already, below its progress."""
    if _shown_in.get(run.id) == _cell():
        return None
    return summary(run)


def summary(run: Run) -> str:
    """State, time, headline figures with their floors, the costly nodes, warnings, where results lie, the graph."""
    from exmesh_graph.report.drawing.states import picture_of_run

    rows = list(run.record["nodes"])
    hits = sum(row["state"] == "hit" for row in rows)
    ran = sorted((row for row in rows if row["state"] == "done"), key=lambda row: -row["seconds"])
    bad = run.state in ("failed", "interrupted")
    parts = [
        cells.said(f"{run.id}: {run.state}, {len(rows)} nodes, {hits} from the store, {len(ran)} run, "
                   f"{clock(run.seconds)}", "bad" if bad else "")
    ]  # fmt: skip
    with contextlib.suppress(ExmeshError, OSError, ValueError):  # a report that cannot be read
        parts.append(_figures(run) if (run.folder / "report.json").is_file() else "")
    messages = {record["node"]: record["message"] for record in run.failures}
    failed = [row["name"] for row in rows if row["state"] == "failed"]
    for name in failed[:5]:
        parts.append(cells.said(f"failed: {name}{': ' if name in messages else ''}{messages.get(name, '')}", "bad"))
    if failed[5:]:
        parts.append(cells.said(f"failed: {', '.join(failed[5:])}", "bad"))
    slow = [row for row in ran[:5] if row["seconds"] >= 0.1]
    if slow:
        parts.append(
            cells.said("longest: " + ", ".join(f"{row['name']} {clock(row['seconds'])}" for row in slow), "soft")
        )
    warned = run.warnings
    parts += [cells.said(f"{node}: {text}", "warn") for node, text in warned[:5]]
    if warned[5:]:
        parts.append(
            cells.folded(f"{len(warned) - 5} more warnings", "".join(cells.said(f"{n}: {t}") for n, t in warned[5:]))
        )
    files = [(name, str(path)) for name, path in run.paths.items()]
    parts.append(cells.table([*files, ("folder", str(run.folder))]))
    parts.append(cells.folded("graph", _drawn(picture_of_run(run.record))))
    return cells.cell(*parts)


def node_html(node: NodeRun) -> str:
    """What a node did, and its outputs by name and type."""
    from exmesh_graph.report.text import size

    info = node.info
    rows = [(f".{port}", out["type"], size(int(out.get("bytes") or 0))) for port, out in info["outputs"].items()]
    spent = f", {clock(info['seconds'])}" if info["state"] == "done" else ""
    warned = [cells.said(text, "warn") for text in info["warnings"]]
    return cells.cell(cells.said(f"{info['name']}  {info['type']}: {info['state']}{spent}"), cells.table(rows), *warned)


class Cells:
    """How runs show themselves (api.progress.Display): progress in the cell that began them, then the summary."""

    def __init__(self) -> None:
        self.live: dict[str, LiveRun] = {}

    @contextlib.contextmanager
    def view(self, graph: Checked, run: str) -> Iterator[Listener]:
        """A listener that keeps one output of the cell up to date."""
        live = self.live[run] = LiveRun({name: bound.definition.type for name, bound in graph.nodes.items()}, run)
        try:
            yield live.listen
        except BaseException:
            del self.live[run]
            raise
        finally:
            live.show()

    def finish(self, run: Run) -> None:
        """Put the summary in the place of the progress."""
        live = self.live.pop(run.id, None)
        if live is not None:
            live.show(summary(run))
            _shown_in[run.id] = _cell()


class LiveRun:
    """The state of a run in one output of a cell, drawn anew as events come."""

    def __init__(self, types: Mapping[str, str], run: str) -> None:
        self.types, self.run, self.board = types, run, Board()
        self.next, self.handle = 0.0, None
        self.notes: list[str] = []

    def listen(self, event: Mapping[str, Any]) -> None:
        """Account for an event of the run."""
        self.board.take(event)
        if event["event"] == "warning":
            self.notes.append(f"{event['node']}: {event['message']}")
        elif event["event"] == "stopping" and event["nodes"]:
            self.notes.append(f"stopping {', '.join(event['nodes'])}; interrupt once more to kill")
        now = time.monotonic()
        if now >= self.next or event["event"] in ("run_started", "stopping"):
            self.show()
            self.next = time.monotonic() + _EVERY

    def show(self, html: str = "") -> None:
        """Draw the state as it is, or `html` in its place."""
        from IPython.display import display

        now = time.time()
        content = {"text/html": html or self.html(now), "text/plain": f"{self.run} {self.words(now)}"}
        if self.handle is None:
            self.handle = display(content, raw=True, display_id=True)
        else:
            self.handle.update(content, raw=True)

    def words(self, now: float) -> str:
        """`running: 3 of 12 nodes, 40 s, about 1 min left`."""
        board = self.board
        spent = (board.last if board.end else now) - board.began
        left = None if board.end else board.left(now)
        done = f"{board.count('hit', 'done')} of {len(board.states)} nodes"
        words = f"{board.end or 'running'}: {done}, {clock(max(spent, 0.0))}"
        return words + ("" if left is None else f", about {clock(left)} left")

    def html(self, now: float) -> str:
        """The nodes that run and those that ended last, with bars, times and what is still to come."""
        board = self.board
        rows = []
        for name in board.finished[-_LISTED:]:
            state = board.states[name]
            rows.append((state, name, self.types.get(name, ""), clock(board.seconds[name]) if state == "done" else ""))
        listed = cells.table(rows)
        for name, active in board.running.items():
            event = active.progress
            bar = f'<progress max="{event["total"]}" value="{event["step"]}"></progress> ' if event else ""
            listed += f"<p>{bar}{escape(name)} <span class=soft>{escape(active.text(now))}</span></p>"
        notes = "".join(cells.said(note, "warn") for note in self.notes[-5:])
        if board.end == "interrupted":
            notes += cells.said("Interrupted: what is done is kept, the same call goes on from there.", "warn")
        bar = f'<progress max="{max(len(board.states), 1)}" value="{board.count("hit", "done")}"></progress> '
        return cells.cell(
            f"<p>{bar}{escape(self.run)} <span class=soft>{escape(self.words(now))}</span></p>", listed, notes
        )


def _figures(run: Run) -> str:
    from exmesh_graph.report.text import number

    told = []
    for label, figure in run.metrics.items():
        notes = [] if figure.floor is None else [f"uninformed guess {number(figure.floor)}"]
        notes += [] if figure.seconds is None else [f"after {clock(figure.seconds)}"]
        told.append((label, f"{number(figure.value)} {figure.unit}".rstrip(), ", ".join(notes)))
    return cells.tiles(told)


def _drawn(picture: GraphPicture) -> str:
    from exmesh_graph.report.drawing.svg import draw

    if len(picture.boxes) > _MOST_BOXES:
        return cells.said(f"{len(picture.boxes)} nodes: too many to draw here; `exmesh show` draws them", "soft")
    return f'<div class="graphbox">{draw(picture)}</div>'


def _cell() -> int:
    """The number of the cell that runs."""
    from IPython import get_ipython

    shell = get_ipython()
    return -1 if shell is None else int(shell.execution_count)
