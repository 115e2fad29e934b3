"""What a run would do with each node, and why: hit, run, or unknown below a node that must run first.

Why a node is no hit is the difference of key pre-images, in words.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from exmesh_graph.errors import ExmeshError, GraphError
from exmesh_graph.graph.cache.fingerprint import fingerprint, remember_in
from exmesh_graph.graph.cache.keys import NOTHING, Action, Stored, key_of, preimage_of
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.language.check import Bound, Checked
from exmesh_graph.graph.problems import in_short
from exmesh_graph.graph.run.lists import Outputs, fed, gathered, mapped, whole
from exmesh_graph.graph.variants.compare import unlike

HIT, RUN, UNKNOWN = "hit", "run", "unknown"


@dataclass(frozen=True)
class Step:
    """One node of a plan. `preimage` is None where it cannot be known yet."""

    name: str
    state: str
    reason: str
    key: str | None = None
    preimage: Mapping[str, Any] | None = None
    action: Action | None = None


def plan(graph: Checked, store: Store, targets: set[str] | None = None, reasons: bool = True) -> list[Step]:
    """The steps of a run, in order. Nothing is computed; below a node that must run, keys are unknown."""
    with graph.packs:
        steps = _steps(graph, store, targets, reasons)
    store.save()
    return steps


def _steps(graph: Checked, store: Store, targets: set[str] | None, reasons: bool) -> list[Step]:
    steps: list[Step] = []
    outputs: dict[str, Mapping[str, Stored]] = {}
    for name, bound in graph.nodes.items():
        if targets is not None and name not in targets:
            continue
        waits = sorted({link.node for link in bound.inputs.values() if link.node not in outputs})
        if waits:
            steps.append(Step(name, UNKNOWN, f"waits for {', '.join(waits)}"))
            continue
        try:
            nodes = mapped(bound, outputs) if bound.each else [bound]
            made = [_step(node, store, outputs, reasons) for node in nodes]
        except ExmeshError as error:
            steps.append(Step(name, UNKNOWN, error.what))
            continue
        steps += made
        missing = [step.name for step in made if step.action is None]
        if not missing:
            known = [step.action.outputs for step in made if step.action is not None]
            outputs[name] = gathered(bound, known) if bound.each else known[0]
        if bound.each:
            words = f"waits for {in_short(missing, 3)}" if missing else f"gathers {len(made)}"
            steps.append(Step(name, UNKNOWN if missing else HIT, words))
    return steps


def _step(bound: Bound, store: Store, outputs: Outputs, reasons: bool) -> Step:
    preimage = preimage_for(bound, store, outputs)
    key = key_of(preimage)
    action = store.find(preimage, key, fetch=False)
    if action is not None and whole(action.outputs, bound.signature):
        far = store.remote is not None and store.look_up(key) is None
        return Step(bound.name, HIT, "in the shared store" if far else "", key, preimage, action)
    words = explain(bound, preimage, store) if reasons else []
    return Step(bound.name, RUN, "; ".join([*words[:3], *(["..."] if words[3:] else [])]), key, preimage)


def preimage_for(bound: Bound, store: Store, outputs: Outputs) -> dict[str, Any]:
    """The pre-image of a node's key, given the recorded outputs of the nodes before it."""
    given = fed(bound, outputs).items()
    inputs = {port: (stored.type, stored.digest) for port, (_, stored) in given if stored != NOTHING}
    remember_in(store.code)
    try:
        sources = {name: store.sources.digest(path) for name, path in bound.sources.items()}
    except OSError as error:
        what = f"{bound.name}: a source file cannot be read: {error.strerror}"
        raise GraphError(what, where=str(error.filename), fix="it was there when the graph was checked") from error
    return preimage_of(bound, fingerprint(bound.definition).digest, sources, inputs)


COMPARED = 200  # records of one type


def explain(bound: Bound, preimage: Mapping[str, Any], store: Store) -> list[str]:
    """In words: how this pre-image differs from the nearest of the latest records of its type, its own if any."""
    actions = store.actions(bound.definition.type)
    own = [action for action in actions if action.info.get("node") == bound.name]
    answers = [differences(preimage, action, bound) for action in (own or actions)[:COMPARED]]
    if not answers:
        return [f"no earlier run of {bound.definition.type} in this store"]
    return min(answers, key=len) or ["same key as an earlier record, whose outputs are gone"]


def differences(preimage: Mapping[str, Any], action: Action, bound: Bound) -> list[str]:
    """The differences between a pre-image and a record's, one sentence each."""
    old = action.preimage
    parts = changed_code(action, bound) if preimage["code"] != old["code"] else []
    words = _definition(preimage, old, f"code changed: {', '.join(parts) or 'unknown part'}", ":")
    words += _changed_sources(preimage["sources"], old["sources"])
    inputs = unlike(old["inputs"], preimage["inputs"])
    words += [_changed_input(port, after, before, bound) for port, before, after in inputs]
    return words + _components("", preimage, old)


def component_differences(label: str, new: Any, old: Any) -> list[str]:
    """How two pre-images of a component differ, one sentence each; None stands for no component."""
    if old is None or new is None:
        state = "newly plugged in" if old is None else "no longer plugged in"
        return [f"component {label} ({(new or old)['type']}) is {state}"]
    if new["type"] != old["type"]:
        return [f"component {label} is {new['type']}, was {old['type']}"]
    words = _definition(new, old, "code changed", "")
    return [f"component {label}: {word}" for word in words] + _components(f"{label}.", new, old)


def changed_code(action: Action, bound: Bound) -> list[str]:
    """The parts of a node's code that differ from a record's: functions and modules."""
    parts = unlike(action.info.get("code_parts", {}), fingerprint(bound.definition).parts)
    marks = {(False, False): "", (True, False): " (new)", (False, True): " (no longer used)"}
    return [name + marks[before is None, after is None] for name, before, after in parts]


def record_time(action: Action) -> str:
    """When the record was written, for people."""
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(float(action.info.get("finished", 0))))


def _definition(new: Mapping[str, Any], old: Mapping[str, Any], code: str, colon: str) -> list[str]:
    """What differs in version, code, parameters and libraries; of a node in format and seed as well."""
    labels = {"epoch": "format epoch", "version": "version", "seed": "seed"}.items()
    words = [f"{label} {old[name]} -> {new[name]}" for name, label in labels if new.get(name) != old.get(name)]
    words += [code] if new["code"] != old["code"] else []
    for field, label in (("params", "parameter"), ("libraries", "library")):
        for name, before, after in unlike(old[field], new[field]):
            words.append(f"{label} {name}{colon} {_shown(before)} -> {_shown(after)}")
    return words


def _components(prefix: str, new: Mapping[str, Any], old: Mapping[str, Any]) -> list[str]:
    plugs = unlike(old.get("components", {}), new.get("components", {}))
    return [word for port, before, after in plugs for word in component_differences(prefix + port, after, before)]


def _changed_sources(new: Mapping[str, str], old: Mapping[str, str]) -> list[str]:
    names: dict[str, list[str]] = {"changed": [], "new": [], "gone": []}
    for name, before, after in unlike(old, new):
        names["new" if before is None else "gone" if after is None else "changed"].append(name)
    return [f"source files {label}: {in_short(sorted(found), 3)}" for label, found in names.items() if found]


def _changed_input(port: str, new: Any, old: Any, bound: Bound) -> str:
    source = f" (from {bound.inputs[port]})" if port in bound.inputs else ""
    if old is None:
        return f"input {port}{source} is newly connected"
    if new is None:
        return f"input {port} is no longer connected"
    if new[0] != old[0]:
        return f"input {port}{source} is {new[0]}, was {old[0]}"
    return f"input {port}{source} has other contents: {old[1][:10]} -> {new[1][:10]}"


def _shown(value: Any) -> str:
    if isinstance(value, dict) and set(value) == {"~float"}:
        return f"{float.fromhex(value['~float']):g}"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_shown(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_shown(item) for item in value) + "]"
    return "nothing" if value is None else str(value)
