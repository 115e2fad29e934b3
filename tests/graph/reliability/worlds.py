"""Random graphs of toy nodes with the values they must give, and the audit of a store after a fault."""

from __future__ import annotations

import functools
import json
import os
import random
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from exmesh_graph.api.runs import backend_of
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.declare.packs import load_packs
from exmesh_graph.graph.declare.ports import artifact_types
from exmesh_graph.graph.language.check import Checked, check_file
from exmesh_graph.graph.run.rundir import RunFolder
from exmesh_graph.graph.run.runner import Runner
from exmesh_graph.graph.upkeep.collect import verify

sys.path.append(str(Path(__file__).parent.parent / "toy"))
SERVED = ("hit", "done")


@dataclass
class World:
    """A graph as text, the number that each of its nodes must give, and the node whose number it publishes."""

    text: str
    values: dict[str, float | None]  # None: only its bytes are compared
    shown: str

    @property
    def figure(self) -> float | None:
        return self.values[self.shown]

    @functools.cached_property
    def checked(self) -> Checked:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "graph.yaml"
            path.write_text(self.text)
            return check_file(path, [], load_packs())


def random_world(dice: random.Random, count: int, slow: float = 0.0) -> World:
    """A graph of `count` nodes or a few more: constants, sums, differences, states, files; `slow` seconds per pause."""
    lines: list[str] = []
    values: dict[str, float] = {}

    def add(spec: str, value: float) -> None:
        name = f"n{len(values)}"
        lines.append(f"  {name}: {{{spec}}}")
        values[name] = value

    while len(values) < count:
        numbers = list(values)  # those whose output port is `number`
        numbers = [
            n for n, line in zip(numbers, lines, strict=True) if "toy.folder" not in line and ".step" not in line
        ]
        kind = dice.choice(["const", "subtract", "subtract", "step", "seeded", "folder", "slow" if slow else "sign"])
        a = dice.choice(numbers) if numbers else ""
        if not a or kind == "const":
            value = dice.randint(-9, 9)
            add(f"type: toy.const, value: {value}, label: t{dice.randint(0, 3)}", value)
        elif kind == "subtract":
            b = dice.choice(numbers)
            add(f'type: toy.subtract, a: "@{a}.number", b: "@{b}.number"', values[a] - values[b])
        elif kind == "step":
            amount = dice.randint(1, 5)
            add(f'type: toy.step, state: "@{a}.number", amount: {amount}', values[a] + amount)
        elif kind == "seeded":
            add(f'type: toy.seeded, number: "@{a}.number"', values[a] + 1)
        elif kind == "sign":
            add(f'type: toy.sign, number: "@{a}.number"', 1.0 if values[a] >= 0 else -1.0)
        elif kind == "slow":
            add(f'type: toy.slow, number: "@{a}.number", seconds: {dice.random() * 2 * slow:.4f}, steps: 2', values[a])
        else:
            add(f'type: toy.folder, number: "@{a}.number"', values[a])
            add(f'type: toy.read_folder, files: "@n{len(values) - 1}.files"', values[a])
    last = next(
        n for n in reversed(values) if "toy.folder" not in lines[int(n[1:])] and ".step" not in lines[int(n[1:])]
    )
    order = dice.sample(lines, len(lines))
    outputs = f'outputs: {{figure: "@{last}.number"}}\n'
    return World("name: random\nseed: 1\nrun: all\nnodes:\n" + "\n".join(order) + "\n" + outputs, values, last)


def execute(world: World, runs: Path, store: Path, workers: int = 0) -> Any:
    """Run the graph of a world as `exmesh run` does, with a checkpoint at each step; returns the run's record."""
    opened, folder = Store(store), RunFolder(runs, "random")
    backend = backend_of(workers, opened)
    try:
        return Runner(world.checked, opened, folder, lambda event: None, backend=backend, checkpoint_every=0.0).run()
    finally:
        folder.close()


@dataclass
class Report:
    """What a campaign found."""

    trials: int = 0
    misses: list[str] = field(default_factory=list)
    facts: dict[str, Any] = field(default_factory=dict)

    def miss(self, what: str) -> None:
        self.misses.append(f"trial {self.trials}: {what}")


@dataclass
class Truth:
    """What a store that no fault ever touched holds for a world: {key: {port: digest}} and {node: key}."""

    keys: dict[str, dict[str, str]]
    nodes: dict[str, str]

    @property
    def walk(self) -> str:
        """The digest of the node that keeps checkpoints."""
        return self.keys[self.nodes["walk"]]["series"]


def truth_of(world: World, root: Path) -> Truth:
    """Run a world in a store of its own and check all its values."""
    record = execute(world, root / "runs", root / "store")
    wrong = wrong_values(world, record, Store(root / "store"))
    assert not wrong, wrong
    nodes = {row["name"]: row["key"] for row in record["nodes"]}
    outputs = {row["key"]: {p: o["digest"] for p, o in row["outputs"].items()} for row in record["nodes"]}
    return Truth(outputs, nodes)


def wrong_values(world: World, record: Mapping[str, Any], store: Store, *, may_refuse: bool = False) -> list[str]:
    """The nodes of a finished run whose stored result is not what it must be; with `may_refuse`, one that the store
    does not serve is all right."""
    wrong = []
    for row in record["nodes"]:
        (stored,) = row["outputs"].values()
        value: Any = store.load(artifact_types()[stored["type"]], stored["digest"])
        if value is not None and stored["type"] == "Files":
            value = float((value.root / value.main).read_text())
        else:
            value = getattr(value, "value", None)
        expected = world.values[row["name"]]
        if expected is not None and value != expected and not (may_refuse and value is None):
            wrong.append(f"{row['name']} is {value}, not {expected}")
    return wrong


def published(runs: Path) -> float:
    """The figure that the latest run published."""
    return float.fromhex(json.loads((runs / "latest" / "figure" / "number.json").read_text())["value"])


def recorded(store: Path) -> set[str]:
    """The keys of all records that lie in a store."""
    return {path.stem for path in (store / "actions").glob("*/*.json")}


def announced(root: Path) -> set[str]:
    """The nodes that any run below `root` reported as finished."""
    names = set()
    for path in root.rglob("events.jsonl"):
        for line in path.read_text().splitlines():
            try:
                event = json.loads(line)
            except ValueError:  # the last line of a killed run
                continue
            if event["event"] == "node_finished" and event["state"] in SERVED:
                names.add(event["node"])
    return names


def audit(world: World, truth: Truth, root: Path, report: Report, after: str) -> None:
    """After faults in runs below `root` on the store `root/store`: `verify` is clean, all that was recorded is served
    and right, and the same run now completes with the right values and leaves nothing behind."""
    store = root / "store"
    opened = Store(store)
    for what, why in verify(opened):
        if what != "lease":  # that of a killed runner, which verify takes away
            report.miss(f"{after}: verify finds {what}: {why}")
    kept = recorded(store)
    for key in kept & set(truth.keys):
        action = opened.look_up(key)
        if action is None:
            report.miss(f"{after}: the record {key[:10]} is not served")
        elif {p: o.digest for p, o in action.outputs.items()} != truth.keys[key]:
            report.miss(f"{after}: the record {key[:10]} serves a wrong result")
    if kept - set(truth.keys):
        report.miss(f"{after}: records that no run can have made: {sorted(kept - set(truth.keys))}")
    lost = [node for node in announced(root) if truth.nodes[node] not in kept]
    if lost:
        report.miss(f"{after}: reported as done but not recorded: {lost}")
    for left in (store / "work").glob("*"):
        os.utime(left, (0, 0))  # a folder without its lock is spared for some seconds: it may be in the making
    record = execute(world, root / "audit", store)
    if record["store_notes"]:
        report.miss(f"{after}: the next run finds {record['store_notes']}")
    again = [row["name"] for row in record["nodes"] if row["key"] in kept and row["state"] != "hit"]
    if again:
        report.miss(f"{after}: recorded but made again: {again}")
    report.misses += [f"trial {report.trials}: {after}: {text}" for text in wrong_values(world, record, Store(store))]
    if published(root / "audit") != world.figure:
        report.miss(f"{after}: the published figure is wrong")
    remains = [path.name for path in (store / "work").iterdir()]
    if remains:
        report.miss(f"{after}: the next run leaves work/{', work/'.join(remains)}")
