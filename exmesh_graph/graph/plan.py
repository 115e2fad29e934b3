"""What a run would do with each node, and why: hit, run, or unknown below a node that must run first."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from exmesh_graph.errors import ExmeshError
from exmesh_graph.graph.check import Bound, Checked
from exmesh_graph.graph.fingerprint import fingerprint, remember_in
from exmesh_graph.graph.keys import ABSENT, key_of, preimage_of
from exmesh_graph.graph.language import components
from exmesh_graph.graph.store import Action, Store, Stored

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
            preimage = preimage_for(bound, store, lambda node, port: outputs[node][port])
        except ExmeshError as error:
            steps.append(Step(name, UNKNOWN, error.what))
            continue
        key = key_of(preimage)
        action = store.look_up(key)
        if action is not None and set(action.outputs) == set(bound.signature.outputs):
            outputs[name] = action.outputs
            steps.append(Step(name, HIT, "", key, preimage, action))
        else:
            words = explain(bound, preimage, store) if reasons else []
            reason = "; ".join(words[:3]) + ("; ..." if len(words) > 3 else "")
            steps.append(Step(name, RUN, reason, key, preimage))
    store.save()
    return steps


def preimage_for(bound: Bound, store: Store, output: Callable[[str, str], Stored]) -> dict[str, Any]:
    """The pre-image of a node's key, given the recorded outputs of the nodes before it."""
    inputs = {}
    for port, link in bound.inputs.items():
        stored = output(link.node, link.port)
        if (stored.type, stored.digest) != ABSENT:
            inputs[port] = (stored.type, stored.digest)
    remember_in(store.code)
    sources = {name: store.sources.digest(path) for name, path in bound.sources.items()}
    return preimage_of(bound, fingerprint(bound.definition).digest, sources, inputs)


def explain(bound: Bound, preimage: Mapping[str, Any], store: Store) -> list[str]:
    """In words: how this pre-image differs from the nearest earlier record of the same node type."""
    best: tuple[tuple[bool, int], Action, list[str]] | None = None
    for action in store.actions(bound.definition.type):
        words = differences(preimage, action, bound)
        score = (action.info.get("node") != bound.name, len(words))
        if best is None or score < best[0]:
            best = (score, action, words)
        if best[0] == (False, 0):
            break
    if best is None:
        return [f"no earlier run of {bound.definition.type} in this store"]
    if not best[2]:
        return ["same key as an earlier record, whose outputs are gone"]
    return best[2]


def differences(preimage: Mapping[str, Any], action: Action, bound: Bound) -> list[str]:
    """The differences between a pre-image and a record's, one sentence each."""
    old = action.preimage
    words: list[str] = []
    for field, label in (("epoch", "format epoch"), ("version", "version"), ("seed", "seed")):
        if preimage[field] != old[field]:
            words.append(f"{label} {old[field]} -> {preimage[field]}")
    if preimage["code"] != old["code"]:
        words.append("code changed: " + (", ".join(_changed_code(action, bound)) or "unknown part"))
    for field, label in (("params", "parameter"), ("libraries", "library")):
        for name in sorted({*preimage[field], *old[field]}):
            new_value, old_value = preimage[field].get(name), old[field].get(name)
            if new_value != old_value:
                words.append(f"{label} {name}: {_shown(old_value)} -> {_shown(new_value)}")
    words += _changed_sources(preimage["sources"], old["sources"])
    for port in sorted({*preimage["inputs"], *old["inputs"]}):
        new_input, old_input = preimage["inputs"].get(port), old["inputs"].get(port)
        if new_input != old_input:
            words.append(_changed_input(port, new_input, old_input, bound))
    plugs, before = preimage.get("components", {}), old.get("components", {})
    for port in sorted({*plugs, *before}):
        if plugs.get(port) != before.get(port):
            words += components.differences(port, plugs.get(port), before.get(port), _shown)
    return words


def record_time(action: Action) -> str:
    """When the record was written, for people."""
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(float(action.info.get("finished", 0))))


def _changed_code(action: Action, bound: Bound) -> list[str]:
    new, old = fingerprint(bound.definition).parts, action.info.get("code_parts", {})
    words = [name for name in new if name in old and new[name] != old[name]]
    words += [f"{name} (new)" for name in new if name not in old]
    return words + [f"{name} (no longer used)" for name in old if name not in new]


def _changed_sources(new: Mapping[str, str], old: Mapping[str, str]) -> list[str]:
    words = []
    for label, names in (
        ("changed", [n for n in new if n in old and new[n] != old[n]]),
        ("new", [n for n in new if n not in old]),
        ("gone", [n for n in old if n not in new]),
    ):
        if names:
            more = f" and {len(names) - 3} more" if len(names) > 3 else ""
            words.append(f"source files {label}: {', '.join(sorted(names)[:3])}{more}")
    return words


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
