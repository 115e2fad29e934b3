"""Why a node is no hit, in words: the difference of its key's pre-image and those of records, one sentence each."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from exmesh_graph.graph.cache.fingerprint import fingerprint
from exmesh_graph.graph.problems import in_short
from exmesh_graph.graph.run.plan import Step, plan

if TYPE_CHECKING:
    from exmesh_graph.graph.cache.keys import Action
    from exmesh_graph.graph.cache.store import Store
    from exmesh_graph.graph.language.check import Bound, Checked


def explained(graph: Checked, store: Store, targets: set[str] | None = None) -> list[Step]:
    """The steps of a run, each that must run with its reason."""
    return plan(graph, store, targets, explain)


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
    kinds = unlike(old.get("kinds", {}), preimage.get("kinds", {}))
    words += [f"code of the wire type {name} changed" for name, before, after in kinds if before and after]
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


def unlike(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[tuple[str, Any, Any]]:
    """(key, before, after) of what two mappings do not hold alike."""
    for key in dict.fromkeys([*old, *new]):
        if old.get(key) != new.get(key) or (key in old) != (key in new):
            yield key, old.get(key), new.get(key)
