"""Why a node is no hit: the difference of key pre-images, in words."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from exmesh_graph.graph.cache.fingerprint import fingerprint
from exmesh_graph.graph.cache.records import Action
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.language.check import Bound

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
    for port in sorted({*preimage["inputs"], *old["inputs"]}):
        new_input, old_input = preimage["inputs"].get(port), old["inputs"].get(port)
        if new_input != old_input:
            words.append(_changed_input(port, new_input, old_input, bound))
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
    new, old = fingerprint(bound.definition).parts, action.info.get("code_parts", {})
    words = [name for name in new if name in old and new[name] != old[name]]
    words += [f"{name} (new)" for name in new if name not in old]
    return words + [f"{name} (no longer used)" for name in old if name not in new]


def record_time(action: Action) -> str:
    """When the record was written, for people."""
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(float(action.info.get("finished", 0))))


def _definition(new: Mapping[str, Any], old: Mapping[str, Any], code: str, colon: str) -> list[str]:
    """What differs in version, code, parameters and libraries; of a node in format and seed as well."""
    labels = {"epoch": "format epoch", "version": "version", "seed": "seed"}.items()
    words = [f"{label} {old[name]} -> {new[name]}" for name, label in labels if new.get(name) != old.get(name)]
    words += [code] if new["code"] != old["code"] else []
    for field, label in (("params", "parameter"), ("libraries", "library")):
        for name in sorted({*new[field], *old[field]}):
            before, after = old[field].get(name), new[field].get(name)
            if before != after:
                words.append(f"{label} {name}{colon} {_shown(before)} -> {_shown(after)}")
    return words


def _components(prefix: str, new: Mapping[str, Any], old: Mapping[str, Any]) -> list[str]:
    words = []
    plugs, before = new.get("components", {}), old.get("components", {})
    for port in sorted({*plugs, *before}):
        if plugs.get(port) != before.get(port):
            words += component_differences(prefix + port, plugs.get(port), before.get(port))
    return words


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
