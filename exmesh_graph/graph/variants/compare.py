"""How two graphs differ, in words and wire by wire: added, removed, renamed, retyped, rewired, other parameters.

Graphs are compared as the run record holds them (`Checked.resolved`), so that files, variants and past runs compare
alike. What is the same in every round of a repeat block is said once.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from exmesh_graph.graph.problems import without_rounds

Resolved = Mapping[str, Any]
ADDED, REMOVED, CHANGED = "added", "removed", "changed"


@dataclass
class Difference:
    """`states` and `words` by node, rounds apart; `wires` maps (source, target) to added or removed."""

    states: dict[str, str] = field(default_factory=dict)
    words: dict[str, list[str]] = field(default_factory=dict)
    wires: dict[tuple[str, str], str] = field(default_factory=dict)
    renamed: dict[str, str] = field(default_factory=dict)
    graph: list[str] = field(default_factory=list)
    rounds: Counter[str] = field(default_factory=Counter)  # how many nodes of both graphs have a name without rounds

    def __bool__(self) -> bool:
        return bool(self.states or self.graph or self.renamed)

    def lines(self) -> list[str]:
        """One sentence each, rounds folded: `rounds.refine (4 rounds): iterations 400 -> 10`; one round by number."""
        sentences = list(self.graph)
        sentences += [f"{old} is now called {new}" for old, new in self.renamed.items()]
        grouped: dict[tuple[str, str], list[tuple[str, str]]] = {}
        for node, words in self.words.items():
            for word in words:
                key = (without_rounds(node), word if _says_nothing(without_rounds(word)) else without_rounds(word))
                grouped.setdefault(key, []).append((node, word))
        for (node, word), members in grouped.items():
            count, total = len(members), self.rounds[node]
            if count == 1:
                node, word = members[0] if total > 1 else (node, word)
                sentences.append(f"{node}: {word}")
            else:
                sentences.append(f"{node} ({count}{f' of {total}' if count < total else ''} rounds): {word}")
        return sentences


def compare(old: Resolved, new: Resolved, same: Mapping[str, str] | None = None) -> Difference:
    """The difference between two resolved graphs. `same` maps removed nodes to added ones that do the same."""
    result = Difference()
    before, after = old["nodes"], new["nodes"]
    result.rounds.update(without_rounds(name) for name in {**before, **after})
    rounds = {name: (count, _rounds(after).get(name, 0)) for name, count in _rounds(before).items()}
    rounds = {name: counts for name, counts in rounds.items() if counts[0] != counts[1] and counts[1]}
    result.renamed = {a: b for a, b in (same or {}).items() if a not in after and b not in before}
    back = {b: a for a, b in result.renamed.items()}
    result.graph += _settings("graph parameter", old.get("params", {}), new.get("params", {}))
    result.graph += [f"{name}: {counts[0]} -> {counts[1]} rounds" for name, counts in rounds.items()]
    kept = {without_rounds(name) for name in before} & {without_rounds(name) for name in after}
    for name in before:
        if name not in after and name not in result.renamed:
            result.states[name] = REMOVED
            if not (_block(name) in rounds and without_rounds(name) in kept):  # said by the number of rounds
                result.words[name] = [f"removed ({before[name]['type']})"]
    for name, entry in after.items():
        if name not in before and name not in back:
            wires = ", ".join(f"{port} from {link}" for port, link in entry["inputs"].items())
            result.states[name] = ADDED
            if not (_block(name) in rounds and without_rounds(name) in kept):
                result.words[name] = [f"added ({entry['type']}{', ' + wires if wires else ''})"]
        else:
            words = list(_changes(before[back.get(name, name)], entry, result.renamed, rounds))
            if words:
                result.states[name], result.words[name] = CHANGED, words
    components = component_words(old.get("components", {}), new.get("components", {}))
    result.graph += [f"component {name}: {word}" for name, word in components]
    published, now = old.get("outputs", {}), new.get("outputs", {})
    for name in dict.fromkeys([*published, *now]):
        if published.get(name) != now.get(name):
            result.graph.append(f"output {name}: {_shown(published.get(name))} -> {_shown(now.get(name))}")
    wires_before = {(result.renamed.get(a, a), result.renamed.get(b, b)) for a, b in wires_of(old)}
    wires_after = wires_of(new)
    result.wires = {wire: REMOVED for wire in wires_before if wire not in wires_after}
    result.wires |= {wire: ADDED for wire in wires_after if wire not in wires_before}
    return result


def wires_of(graph: Resolved) -> dict[tuple[str, str], None]:
    """(source, target) of every wire, in order."""
    return {(_node(link), name): None for name, entry in graph["nodes"].items() for link in entry["inputs"].values()}


def rerun(old: Mapping[str, str], new: Mapping[str, str]) -> list[str]:
    """Nodes of the new graph that no node of the old one stands for; both map names to identities or keys."""
    known = set(old.values())
    return [name for name, identity in new.items() if identity not in known]


def named_in_short(names: Iterable[str], at_most: int = 12) -> str:
    """`hull, rounds.refine (4 rounds), ...`: rounds folded, the rest counted."""
    counts: dict[str, int] = {}
    for name in names:
        counts[without_rounds(name)] = counts.get(without_rounds(name), 0) + 1
    words = [f"{name} ({count} rounds)" if count > 1 else name for name, count in counts.items()]
    return ", ".join(words[:at_most]) + (f" and {len(words) - at_most} more" if len(words) > at_most else "")


def _changes(
    old: Mapping[str, Any], new: Mapping[str, Any], renamed: Mapping[str, str], rounds: Mapping[str, Any]
) -> Iterable[str]:
    before_params, after_params = old["params"], new["params"]
    if old["type"] != new["type"]:  # parameters that only one of the types has say nothing
        both = set(before_params) & set(after_params)
        before_params, after_params = (
            {k: side[k] for k in side if k in both} for side in (before_params, after_params)
        )
        yield f"type {old['type']} -> {new['type']}"
    if old.get("seed") != new.get("seed"):
        yield f"seed {old.get('seed')} -> {new.get('seed')}"
    yield from _settings("", before_params, after_params)
    plugs = [{**entry["inputs"], **entry.get("components", {})} for entry in (old, new)]
    for port in dict.fromkeys([*plugs[0], *plugs[1]]):
        before, after = plugs[0].get(port), plugs[1].get(port)
        if before is not None:
            node = _node(before)
            before = before.replace(node, renamed.get(node, node), 1)
        last_round = (
            before and after and without_rounds(before) == without_rounds(after) and _block(_node(after)) in rounds
        )
        if before != after and not last_round:
            yield f"{port} from {_shown(before)} -> {_shown(after)}"


def _settings(label: str, old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterable[str]:
    for name in dict.fromkeys([*old, *new]):
        if old.get(name) != new.get(name) or (name in old) != (name in new):
            yield f"{label} {name} {_shown(old.get(name))} -> {_shown(new.get(name))}".lstrip()


def component_words(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterable[tuple[str, str]]:
    """(name, what is other) of every component that differs."""
    for name in dict.fromkeys([*old, *new]):
        if name not in old:
            yield name, f"added ({new[name]['type']})"
        elif name not in new:
            yield name, f"removed ({old[name]['type']})"
        else:
            if old[name]["type"] != new[name]["type"]:
                yield name, f"type {old[name]['type']} -> {new[name]['type']}"
            for words in _settings("", old[name]["params"], new[name]["params"]):
                yield name, words


def _says_nothing(word: str) -> bool:
    """Whether both sides of an arrow read alike without round numbers."""
    before, arrow, after = word.partition(" -> ")
    return bool(arrow) and before.rpartition(" ")[2] == after


def _rounds(nodes: Mapping[str, Any]) -> dict[str, int]:
    """How many rounds every block has."""
    counts: dict[str, int] = {}
    for name in nodes:
        for match in re.finditer(r"\[(\d+)\]", name):
            block = without_rounds(name[: match.start()])
            counts[block] = max(counts.get(block, 0), int(match.group(1)))
    return counts


def _block(name: str) -> str:
    """The innermost block of `rounds[3].refine`: rounds."""
    return without_rounds(name.rpartition(".")[0]) if "[" in name else ""


def _node(link: str) -> str:
    return link.removeprefix("@").rpartition(".")[0] or link.removeprefix("@")


def _shown(value: Any) -> str:
    if value is None:
        return "nothing"
    return f"{value:g}" if isinstance(value, float) else str(value)
