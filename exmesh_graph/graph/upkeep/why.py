"""Why a node is no hit: the difference of key pre-images, in words."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from exmesh_graph.graph.cache.fingerprint import fingerprint
from exmesh_graph.graph.cache.store import Action, Store
from exmesh_graph.graph.declare import components
from exmesh_graph.graph.language.check import Bound

COMPARED = 200  # records of one type


def explain(bound: Bound, preimage: Mapping[str, Any], store: Store) -> list[str]:
    """In words: how this pre-image differs from the nearest of the latest records of its type, its own if any."""
    actions = store.actions(bound.definition.type)
    own = [action for action in actions if action.info.get("node") == bound.name]
    found = [differences(preimage, action, bound) for action in (own or actions)[:COMPARED]]
    if not found:
        return [f"no earlier run of {bound.definition.type} in this store"]
    return min(found, key=len) or ["same key as an earlier record, whose outputs are gone"]


def differences(preimage: Mapping[str, Any], action: Action, bound: Bound) -> list[str]:
    """The differences between a pre-image and a record's, one sentence each."""
    old = action.preimage
    words: list[str] = []
    for field, label in (("epoch", "format epoch"), ("version", "version"), ("seed", "seed")):
        if preimage[field] != old[field]:
            words.append(f"{label} {old[field]} -> {preimage[field]}")
    if preimage["code"] != old["code"]:
        words.append("code changed: " + (", ".join(changed_code(action, bound)) or "unknown part"))
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


def changed_code(action: Action, bound: Bound) -> list[str]:
    """The parts of a node's code that differ from a record's: functions and modules."""
    new, old = fingerprint(bound.definition).parts, action.info.get("code_parts", {})
    words = [name for name in new if name in old and new[name] != old[name]]
    words += [f"{name} (new)" for name in new if name not in old]
    return words + [f"{name} (no longer used)" for name in old if name not in new]


def record_time(action: Action) -> str:
    """When the record was written, for people."""
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(float(action.info.get("finished", 0))))


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
