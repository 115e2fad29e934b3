"""How two graphs differ, in words and wire by wire: added, removed, renamed, retyped, rewired, other parameters.

Graphs are compared as the run record holds them (`Checked.resolved`), so that files, variants and past runs compare
alike. What is the same in every round of a repeat block is said once.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from exmesh_graph.graph.problems import in_short, without_rounds
from exmesh_graph.report.reasons import unlike

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
    result, after = Difference(), new["nodes"]
    result.renamed = {a: b for a, b in (same or {}).items() if a not in after and b not in old["nodes"]}
    before = {result.renamed.get(name, name): entry for name, entry in old["nodes"].items()}
    for name, entry in before.items():
        before[name] = {**entry, "inputs": {p: _now(link, result.renamed) for p, link in entry["inputs"].items()}}
    result.rounds.update(without_rounds(name) for name in {**before, **after})
    counts = _rounds(before), _rounds(after)
    rounds = {name: count for name, count in counts[1].items() if counts[0].get(name, count) != count}
    result.graph += _arrows("graph parameter {} {} -> {}", old.get("params", {}), new.get("params", {}))
    result.graph += _arrows("{}: {} -> {} rounds", {name: counts[0][name] for name in rounds}, rounds)
    kept = {without_rounds(name) for name in before} & {without_rounds(name) for name in after}
    for name, was, entry in unlike(before, after):
        words = [] if was is None or entry is None else _changes(was, entry, rounds)
        if was is None or entry is None:
            wires = "".join(f", {port} from {link}" for port, link in entry["inputs"].items()) if was is None else ""
            result.states[name] = state = ADDED if was is None else REMOVED
            if not (_block(name) in rounds and without_rounds(name) in kept):  # said by the number of rounds
                words = [f"{state} ({(entry or was)['type']}{wires})"]
        elif words:
            result.states[name] = CHANGED
        result.words |= {name: words} if words else {}
    components = component_words(old.get("components", {}), new.get("components", {}))
    result.graph += [f"component {name}: {word}" for name, word in components]
    result.graph += _arrows("output {}: {} -> {}", old.get("outputs", {}), new.get("outputs", {}))
    wires_before, wires_after = _wires(before), _wires(after)
    result.wires = {wire: REMOVED for wire in wires_before if wire not in wires_after}
    result.wires |= {wire: ADDED for wire in wires_after if wire not in wires_before}
    return result


def rerun(old: Mapping[str, str], new: Mapping[str, str]) -> list[str]:
    """Nodes of the new graph that no node of the old one stands for; both map names to identities or keys."""
    known = set(old.values())
    return [name for name, identity in new.items() if identity not in known]


def named_in_short(names: Iterable[str], at_most: int = 12) -> str:
    """`hull, rounds.refine (4 rounds), ...`: rounds folded, the rest counted."""
    counts = Counter(without_rounds(name) for name in names)
    words = [f"{name} ({count} rounds)" if count > 1 else name for name, count in counts.items()]
    return in_short(words, at_most)


def component_words(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """(name, what is other) of every component that differs."""
    for name, before, after in unlike(old, new):
        if before is None or after is None:
            yield name, f"added ({after['type']})" if before is None else f"removed ({before['type']})"
        else:
            values = [{"type": entry["type"], **entry["params"]} for entry in (before, after)]
            yield from ((name, words) for words in _arrows("{} {} -> {}", *values))


def _changes(old: Mapping[str, Any], new: Mapping[str, Any], rounds: Mapping[str, Any]) -> list[str]:
    """What differs between two states of one node."""
    both = old["params"].keys() & new["params"].keys() if old["type"] != new["type"] else None
    values, wires = [], []
    for entry in (old, new):  # parameters that only one of two types has say nothing
        params = {name: value for name, value in entry["params"].items() if both is None or name in both}
        values.append({"type": entry["type"], "seed": entry.get("seed"), **params})
        wires.append({**entry["inputs"], **entry.get("components", {})})
    for port, before, after in list(unlike(*wires)):
        if before and after and without_rounds(before) == without_rounds(after) and _block(_node(after)) in rounds:
            wires[0][port] = after  # from the last round, as before
    return [*_arrows("{} {} -> {}", *values), *_arrows("{} from {} -> {}", *wires)]


def _arrows(form: str, old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    return [form.format(key, _shown(before), _shown(after)) for key, before, after in unlike(old, new)]


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


def _now(link: str, renamed: Mapping[str, str]) -> str:
    """A link by the names that nodes have now."""
    return link.replace(_node(link), renamed.get(_node(link), _node(link)), 1)


def _wires(nodes: Mapping[str, Any]) -> dict[tuple[str, str], None]:
    """(source, target) of every wire, in order."""
    return {(_node(link), name): None for name, entry in nodes.items() for link in entry["inputs"].values()}


def _shown(value: Any) -> str:
    if value is None:
        return "nothing"
    return f"{value:g}" if isinstance(value, float) else str(value)
