"""What a run left behind: its nodes, their artifacts (read when asked for, checked, remembered), figures and files.

run["settle"].state          the artifact of an output; run["rounds.refine"] is the last round's
run.metrics["PSNR"].value    headline figures, with unit, floor and the seconds spent until there
run.asset, run.outputs       what the graph publishes; run.folder holds copies
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import weakref
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exmesh_graph.api.board import clock
from exmesh_graph.api.values import Node, here
from exmesh_graph.errors import ExmeshError, StoreError
from exmesh_graph.files import copy_files, writing
from exmesh_graph.graph.problems import nearest
from exmesh_graph.graph.run.rundir import failure_file
from exmesh_graph.graph.session import current_session

if TYPE_CHECKING:
    from exmesh_graph.graph.cache.store import Store
    from exmesh_graph.types import Artifact


class UnknownName(ExmeshError, KeyError, AttributeError):
    """A run was asked for a node, output or figure that it does not have."""

    code = "name"

    def __str__(self) -> str:  # KeyError would show its repr
        return ExmeshError.__str__(self)


@dataclass(frozen=True)
class Metric:
    """A headline figure: `floor` is what an uninformed guess scores, `seconds` those spent until it was reached."""

    value: Any
    unit: str = ""
    floor: float | None = None
    seconds: float | None = None
    node: str = ""

    def __str__(self) -> str:
        notes = [] if self.floor is None else [f"floor {_shown(self.floor)}"]
        notes += [] if self.seconds is None else [f"after {clock(self.seconds)}"]
        return f"{_shown(self.value)} {self.unit}".rstrip() + (f" ({', '.join(notes)})" if notes else "")


class MetricTable(dict[str, Metric]):
    """Headline figures by label."""

    def __missing__(self, label: str) -> Metric:
        raise _unknown("figure", label, self, "the run")

    def __str__(self) -> str:
        return "\n".join(f"{label}: {figure}" for label, figure in self.items())


class NodeRun:
    """What one node did; its outputs are its attributes: `run["settle"].state`. `info` holds state, seconds, key."""

    def __init__(self, run: Run, row: Mapping[str, Any]) -> None:
        self._run, self.info = run, row

    @property
    def outputs(self) -> list[str]:
        """The names of its outputs; of those that are there once it has run."""
        return [port for port, stored in self.info["outputs"].items() if stored["type"] != "none" and "[" not in port]

    def __getitem__(self, port: str) -> Any:
        stored = self.info["outputs"].get(port)
        if stored is None:
            state = self.info["state"]
            if not self.info["outputs"]:
                raise _unknown("output", port, (), f"{self.info['name']}, which is {state},")
            raise _unknown("output", port, self.outputs, self.info["name"])
        if stored["type"] == "list":
            return tuple(self._element(port, number) for number in range(1, stored["bytes"] + 1))
        return None if stored["type"] == "none" else self._run.artifact(stored["digest"], f"{self.info['name']}.{port}")

    def __contains__(self, port: object) -> bool:
        return port in self.outputs

    def __iter__(self) -> Iterator[str]:
        return iter(self.outputs)

    def _element(self, port: str, number: int) -> Any:
        """An element of a list: made by this node, or by one of those that it stands for."""
        made_here = f"{port}[{number}]" in self.info["outputs"]
        return self[f"{port}[{number}]"] if made_here else self._run[f"{self.info['name']}[{number}]"][port]

    def __getattr__(self, port: str) -> Any:
        if port.startswith("_"):
            raise AttributeError(port)
        return self[port]

    def __dir__(self) -> list[str]:
        return ["info", "outputs", *self.outputs]

    def __repr__(self) -> str:
        spent = f", {clock(self.info['seconds'])}" if self.info["state"] == "done" else ""
        return f"<{self.info['type']} {self.info['name']}: {self.info['state']}{spent}; {', '.join(self.outputs)}>"


class Run(Mapping[str, NodeRun]):
    """A run: a mapping of its nodes. `record` is what its run.json holds."""

    def __init__(self, folder: Path, record: Mapping[str, Any], store: Store) -> None:
        self.folder, self.record, self.store = folder, record, store
        self._rows: dict[str, Mapping[str, Any]] = {}
        self.kept: dict[str, Artifact] = {}
        self.report_error = ""
        self.failures: list[Mapping[str, Any]] = []  # what the failure files hold, of this run
        self.session = current_session()

    def keep(self, close: Callable[[], Any]) -> None:
        """Call `close` when this handle goes away: for a store that lives no longer than it."""
        weakref.finalize(self, close)

    @property
    def rows(self) -> Mapping[str, Mapping[str, Any]]:
        """The rows of the record by name; a node with `each` adds some while it runs."""
        if len(self._rows) != len(self.record["nodes"]):
            self._rows = {row["name"]: row for row in self.record["nodes"]}
        return self._rows

    @property
    def id(self) -> str:
        return str(self.record["id"])

    @property
    def state(self) -> str:
        """done, failed, interrupted, or unfinished."""
        return str(self.record["state"])

    @property
    def seconds(self) -> float:
        """Wall-clock time of this run."""
        return float(self.record.get("seconds") or 0.0)

    @property
    def nodes(self) -> dict[str, NodeRun]:
        """The nodes by full name, in an order in which they can run."""
        return dict(self)

    @property
    def warnings(self) -> list[tuple[str, str]]:
        """(node, text) of every warning."""
        return [(name, text) for name, row in self.rows.items() for text in row["warnings"]]

    @property
    def report(self) -> Path:
        """The path of the report; made again where it is missing. Raises StoreError where artifacts are gone."""
        page = self.folder / "report.html"
        return page if page.is_file() and (self.folder / "report.json").is_file() else self.make_report()

    def make_report(self) -> Path:
        """Write report.json and report.html anew."""
        from exmesh_graph.report import build_report

        if not self.folder.is_dir():
            raise StoreError("the run folder is gone", where=str(self.folder), expected="a folder with run.json",
                             fix="run the graph again: what is in the store is kept")  # fmt: skip
        return build_report(self.folder, self.record, self.artifact)

    @property
    def metrics(self) -> MetricTable:
        """The headline figures of the report by label."""
        path = self.report.with_name("report.json")
        told = json.loads(path.read_text(encoding="utf-8")).get("headline") or {}
        return MetricTable({label: _figure(entry) for label, entry in told.items()})

    @property
    def outputs(self) -> dict[str, Any]:
        """What the graph publishes, by name; copies of the files lie in `folder`, at `paths`."""
        return {name: self._published(name) for name in self._links()}

    @property
    def paths(self) -> dict[str, Path]:
        """Where the published outputs lie."""
        return {name: self.folder / path for name, path in self.record["published"].items()}

    @property
    def asset(self) -> Any:
        """The published output `asset`."""
        if "asset" not in self._links():
            raise _unknown("output", "asset", self._links(), "the graph")
        return self._published("asset")

    def __getitem__(self, name: str) -> NodeRun:
        name = name._name if isinstance(name, Node) else str(name)
        if name not in self.rows:
            rounds = [full for full in self.rows if re.sub(r"\[\d+\]", "", full) == name]
            if not rounds and name in self.record.get("idle", ()):
                raise UnknownName(f"{name} did not run: no output and no report of the graph needs it",
                                  fix=f'ex.run(graph, nodes="{name}"), or publish it: graph.output(...)')  # fmt: skip
            if not rounds:
                raise _unknown("node", name, self.rows, f"the run {self.id}")
            name = rounds[-1]
        return NodeRun(self, self.rows[name])

    def __getattr__(self, name: str) -> Any:
        rows = self.rows if "_rows" in self.__dict__ else {}
        if name.startswith("_") or not rows:
            raise AttributeError(name)
        near = [other for other in (name, *nearest(name, rows)) if other in rows]
        known = ["asset", "folder", "metrics", "outputs", "paths", "report", "seconds", "state", "warnings"]
        fix = f'a node is run["{near[0]}"]' if near else 'a node is run["its name"]'
        raise UnknownName(f"a run has no attribute {name!r}", where=str(here()), expected=", ".join(known), fix=fix)

    def __iter__(self) -> Iterator[str]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def _ipython_key_completions_(self) -> list[str]:
        return list(self)

    def __repr__(self) -> str:
        hits = sum(row["state"] == "hit" for row in self.rows.values())
        return f"<run {self.id}: {self.state}, {len(self)} nodes, {hits} from the store, {clock(self.seconds)}>"

    def artifact(self, digest: str, what: str = "") -> Any:
        """The value of an artifact of this run, its bytes checked. Raises StoreError where it cannot be had."""
        if digest not in self.kept:
            with self.session:
                self.kept[digest] = load_artifact(self.store, digest, what)
        return self.kept[digest]

    def save(self, output: str, folder: str | os.PathLike[str]) -> Path:
        """Copy the files of an output, `hull.mesh`, into a folder, their bytes checked; gives the folder."""
        node, _, port = str(output).rpartition(".")
        if not node or (output in self and node not in self):  # a node without its port
            raise UnknownName(f"{output!r} names no output", expected=", ".join(f"{output}.{name}" for name in
                              (self[output].outputs if output in self else ["port"])))  # fmt: skip
        self[node][port]
        stored, target = self[node].info["outputs"][port], Path(folder)
        if stored["type"] == "none":
            raise _unknown("output", port, self[node].outputs, node)
        with writing("the copy", target, "the folder"):
            copy_files(self.store.data(stored["digest"]), target)
        return target

    def _links(self) -> Mapping[str, str]:
        return self.record["resolved"].get("outputs") or {}

    def _published(self, name: str) -> Any:
        node, _, port = self._links()[name].removeprefix("@").rpartition(".")
        return self[node][port] if node in self.rows else None


def load_artifact(store: Store, digest: str, what: str = "") -> Any:
    """An artifact of a store. Raises StoreError."""
    from exmesh_graph.graph.declare.ports import artifact_types

    again = "run the graph again: what is missing is made anew"
    where = f"{what} in {store.root}" if what else str(store.root)
    if not store.root.is_dir():
        raise StoreError("the store is gone", where=where, expected="a folder with artifacts",
                         fix=f"name the store, or {again}")  # fmt: skip
    name, kinds = store.type_of(digest), artifact_types()
    if name is None or name not in kinds:
        known = "is not in the store" if name is None else f"has the type {name}, which no node pack defines"
        raise StoreError(f"the artifact {digest[:12]} {known}", where=where, fix=again)
    value = store.load(kinds[name], digest)
    if value is None:
        raise StoreError(store.notes[-1], where=where, fix=again)
    return value


def read_failures(folder: Path, record: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """What the failure files of a run folder hold, as far as they are there: the states of the record tell the rest."""
    told: list[Mapping[str, Any]] = []
    for row in record["nodes"]:
        if row["state"] == "failed":
            with contextlib.suppress(OSError, ValueError):
                told.append(json.loads((folder / failure_file(row["name"])).read_text(encoding="utf-8")))
    return told


def read_run(folder: Path) -> dict[str, Any]:
    """The record of a run folder. Raises ExmeshError where there is none, or none that can be read."""
    path = folder / "run.json"
    if not path.is_file():
        others: list[str] = []
        with contextlib.suppress(OSError):
            others = [other.parent.name for other in folder.parent.glob("*/run.json")]
        near = ", ".join(nearest(folder.name, others) or sorted(others)[-3:])
        raise ExmeshError(f"{folder} is no run folder", expected=near, fix="exmesh status lists the runs")
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        return {**record, "state": record["state"], "nodes": record["nodes"], "started": record["started"]}
    except (OSError, ValueError, KeyError, TypeError) as error:
        what = f"run.json cannot be read: {type(error).__name__}: {error}"
        raise ExmeshError(what, where=str(path), fix="run the graph again: what is in the store is kept") from error


def _figure(told: Any) -> Metric:
    if not isinstance(told, dict):
        return Metric(told)
    seconds = told.get("after_seconds")
    return Metric(told.get("value"), told.get("unit") or "", told.get("floor"),
                  None if seconds is None else float(seconds), told.get("node") or "")  # fmt: skip


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _unknown(kind: str, name: str, known: Any, owner: str) -> UnknownName:
    near = nearest(name, known) or list(known)[:8]
    return UnknownName(f"{owner} has no {kind} {name!r}", expected=", ".join(near) or f"none: there are no {kind}s")
