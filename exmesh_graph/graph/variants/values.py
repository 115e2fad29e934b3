"""Operations that change one value or one wire: `set`, `connect`, `disconnect`; see `patches`.

`set` and `connect` reach into sub-graphs: to their parameters and inputs, and to single nodes inside. What a patch says
of a node inside goes into the `nodes:` of the entry that uses the file, so that the file itself and its other uses stay
as they are. The other operations act on the graph that holds the node: put variants of a sub-graph into a file that
extends it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from exmesh_graph.graph.declare.ports import Signature
from exmesh_graph.graph.language.extends import load_merged, merge_nodes
from exmesh_graph.graph.language.params import give
from exmesh_graph.graph.language.yamlfile import Map
from exmesh_graph.graph.problems import GraphErrors, Problems, Where, nearest
from exmesh_graph.graph.variants.draft import Address, Draft, LinkPlace
from exmesh_graph.graph.variants.entries import clone, is_block, is_link, is_part, layers_of, refuse


@dataclass(frozen=True)
class Target:
    """A key of a node or block that a patch names, in the file of `draft`: the entry that stands there now.

    `holder` takes the change: the same entry, or for a node inside a sub-graph what its user says of it.
    """

    draft: Draft
    address: Address
    entry: Map
    holder: Map

    def put(self, value: Any, where: Where, known: Callable[[Signature], Collection[str]]) -> None:
        """Set the key in every round, whatever single rounds had, or in one round; where the type has such a key."""
        kind = self.draft.kind(self.entry)
        if self.address.round is not None:
            layer = self.round_settings(where)
            self._put(layer, self._names(self.draft.kind(layer) or kind), value, where)
            return
        names = self._names(kind)
        if kind is None or names & set(known(kind)):
            self._put(self.holder, names, value, where)
        for layer, word, number in layers_of(self.entry):
            own = self.draft.kind(layer)
            names = self._names(own or kind)
            if names & set(layer if own is None else known(own)):
                self._put(self.holder.inner(word, where).inner(number, where), names, value, where)

    def _names(self, kind: Signature | None) -> set[str]:
        """The names that the parameter or port has or had."""
        return {self.address.key} if kind is None else kind.names_of(self.address.key)

    def _put(self, holder: Map, names: set[str], value: Any, where: Where) -> None:
        for name in names - {self.address.key}:
            holder.pop(name, None)
        holder.put(self.address.key, clone(value), where)

    def round_settings(self, where: Where) -> Map:
        """The settings of the one round that is named."""
        scope = self.address.scope
        count = self.draft.read(self.draft.entry(scope), "repeat") if self.holder is self.entry else None
        if isinstance(count, int) and not 1 <= (self.address.round or 0) <= count:
            refuse(where, f"{'.'.join(scope)} has no round {self.address.round}", expected=f"1 to {count}")
        return self.holder.inner("at", where).inner(self.address.round, where)


def set_values(draft: Draft, patch: Map) -> None:
    if isinstance(patch["set"], Map):  # several at once
        for target, value in patch["set"].items():
            _set_one(draft, target, value, patch["set"].lines[target], patch["set"].lines[target])
    else:
        _set_one(draft, patch["set"], need(patch, "to", "set", "a value"), patch.lines["set"], patch.lines["to"])


def _set_one(draft: Draft, text: Any, value: Any, where: Where, there: Where) -> None:
    if not isinstance(text, str) or "." in text:
        target = _target_of(draft, text, where, link=False)
        if target is not None:
            target.put(value, there, lambda kind: (*kind.params.model_fields, "seed"))
        return
    params = draft.top.get("params")
    if text == "seed":
        draft.top.put("seed", value, there)
    elif isinstance(params, Map) and text in params:
        give(params, text, value, there)
    else:
        names = [*(params or ()), "seed"]
        fix = f"a node's parameter is set with {{set: {text}.PARAMETER, to: ...}}" if text in draft.names() else ""
        refuse(where, f"the graph has no parameter {text!r}", near=nearest(text, names) or names, fix=fix)


def connect(draft: Draft, patch: Map) -> None:
    link, there = need(patch, "to", "connect", 'a link "@node.port"'), patch.lines["to"]
    if not is_link(link):
        fix = f"{{set: {patch['connect']}, to: {link!r}}} sets a parameter"
        refuse(there, f"{link!r} is not a link", expected='"@node.port"', fix=fix)
    place = fixed_place(draft, patch["connect"])
    if place is not None:
        _check_source(draft, link, place.scope, there)
        place.put(link, there)
        return
    target = _target_of(draft, patch["connect"], patch.lines["connect"], link=True)
    if target is not None:
        if target.draft is draft:
            _check_source(draft, link, target.address.scope, there)
        target.put(link, there, lambda kind: kind.inputs)


def disconnect(draft: Draft, patch: Map) -> None:
    text, where = patch["disconnect"], patch.lines["disconnect"]
    place = fixed_place(draft, text)
    if place is not None and str(text).startswith("outputs."):
        if place.key not in place.holder:
            refuse(where, f"there is no {text}", near=[f"outputs.{name}" for name in place.holder])
        del place.holder[place.key]
        return
    target = port_target(draft, text, where)
    entry, key, node = target.entry, target.address.key, ".".join(target.address.path)
    names = {key}.union(*(kind.names_of(key) for kind in draft.kinds(entry)))
    for kind in draft.kinds(entry):
        port = next((kind.inputs[name] for name in names & kind.inputs.keys()), None)
        if port is not None and not port.optional:
            refuse(where, f"{text} must be connected: {entry.get('type')} needs its {port}",
                   fix=f"connect something else, or {{bypass: {node}}}")  # fmt: skip
    holders = (entry, *(layer for layer, _, _ in layers_of(entry)))
    wired = [(holder, name) for holder in holders for name in names if is_link(holder.get(name))]
    if not wired:
        linked = [f"{node}.{other}" for other, value in entry.items() if is_link(value)]
        refuse(where, f"{text} is not connected", near=nearest(str(text), linked))
    if target.address.round is not None:
        target.round_settings(where).put(key, None, where)
        return
    for holder, name in wired:
        del holder[name]


def need(patch: Map, key: str, operation: str, expected: str) -> Any:
    """What a patch says under a key that its operation cannot do without."""
    if key not in patch:
        refuse(patch.where, f"{operation} needs {key}:", expected=f"{key}: {expected}")
    return patch[key]


def port_target(draft: Draft, text: Any, where: Where) -> Target:
    """The input port that a patch names, outside of sub-graphs."""
    address = draft.address(text, where, key=True)
    return _checked(
        Target(draft, address, draft.entry(address.path), draft.entry(address.path)), text, where, link=True
    )


def fixed_place(draft: Draft, target: Any) -> LinkPlace | None:
    """The place that `outputs.asset`, `rounds.carry.state` or `rounds.next.state` names."""
    parts = target.split(".") if isinstance(target, str) else []
    if len(parts) == 2 and parts[0] == "outputs" and "outputs" not in draft.nodes:
        return LinkPlace(draft.top.inner("outputs", draft.top.where), parts[1], (), (), target)
    path, known = tuple(parts[:-2]), set(draft.paths())
    if len(parts) > 2 and parts[-2] in ("carry", "next") and path in known and is_block(draft.entry(path)):
        holder = draft.entry(path).get(parts[-2])
        if isinstance(holder, Map) and parts[-1] in holder and (*path, parts[-2]) not in known:
            return LinkPlace(holder, parts[-1], path[:-1] if parts[-2] == "carry" else path, (), target)
    return None


def _target_of(draft: Draft, text: Any, where: Where, *, link: bool) -> Target | None:
    """The parameter or input port (`link`) that a patch names; None in a file that cannot be read: `check` says why."""
    names = text.split(".") if isinstance(text, str) else []
    paths = [tuple(name.partition("[")[0] for name in names[:length]) for length in range(1, len(names))]
    known = set(draft.paths())
    path = next((path for path in paths if path in known and is_part(draft.entry(path))), None)
    if path is None:
        address = draft.address(text, where, key=True)
        return _checked(Target(draft, address, draft.entry(address.path), draft.entry(address.path)), text, where, link)
    user, key = draft.entry(path), ".".join(names[len(path) :])
    part = _file_of(draft, user)
    if part is None:
        return None
    if "." not in key:
        own = part.get("inputs" if link else "params") or ()
        if key not in own and (link or key != "seed"):
            name, word = ".".join(path), "input" if link else "parameter"
            near = [f"{name}.{other}" for other in nearest(key, own) or own]
            refuse(where, f"the sub-graph {name} has no {word} {key!r}", near=near)
        return Target(draft, Address(path, None, key), user, user)
    inner = Draft(part, draft.packs)
    address = inner.address(key, where, key=True)
    if is_part(inner.entry(address.path)):
        refuse(where, f"{text} lies in a sub-graph of a sub-graph", fix="patch the file that uses it")
    holder = user
    for name in address.path:
        holder = holder.inner("nodes", where).inner(name, where)
    return _checked(Target(inner, address, inner.entry(address.path), holder), text, where, link)


def _checked(target: Target, text: Any, where: Where, link: bool) -> Target:
    """The target, refused where its node or block has no such parameter, or port (`link`)."""
    entry, key, name = target.entry, target.address.key, str(text).rpartition(".")[0]
    if is_block(entry):
        if link:
            carried = [f"{name}.{word}.{other}" for word in ("carry", "next") for other in entry.get(word) or ()]
            fix = "name the carried value or a node in the block"
            refuse(where, f"{name} is a repeat block", near=carried, fix=fix)
        if key != "repeat" or target.address.round is not None:
            refuse(where, f"the block {name} has no parameter {key!r}", near=[f"{name}.repeat"])
        return target
    kinds = target.draft.kinds(entry)
    ports = [port for kind in kinds for port in kind.inputs]
    fields = [*(field for kind in kinds for field in kind.params.model_fields), "seed"]
    known, names = ports if link else fields, {key}.union(*(kind.names_of(key) for kind in kinds))
    if kinds and not names & set(known):
        near = [f"{name}.{other}" for other in nearest(key, known) or known[:5]]
        if names & set(ports):
            refuse(where, f"{text} is an input port, not a parameter", fix=f'{{connect: {text}, to: "@node.port"}}')
        fix = f"{{set: {text}, to: ...}}" if link and names & set(fields) else ""
        word = "input port" if link else "parameter"
        refuse(where, f"{entry.get('type')} has no {word} {key!r}", near=near, fix=fix)
    return target


def _file_of(draft: Draft, entry: Map) -> Map | None:
    """The merged file of a sub-graph with the patches of its use; None where it cannot be read."""
    name = draft.read(entry, "graph")
    path = entry.lines["graph"].base / Path(name if isinstance(name, str) else "").expanduser()
    try:
        part = load_merged(path.resolve(), Problems()).copy()
    except GraphErrors:
        return None
    if isinstance(part.get("nodes"), Map) and isinstance(entry.get("nodes"), Map):
        part["nodes"] = merge_nodes(part["nodes"], entry["nodes"], Problems())
    return part


def _check_source(draft: Draft, text: str, scope: tuple[str, ...], where: Where) -> None:
    """Refuse a link to nowhere; whether its type fits is left to `check`, which looks at every wire."""
    source = draft.source(text, scope)
    if source is None:
        link = text.removeprefix("@")
        node, dot, port = link.rpartition(".") if "." in link else (link, "", "")
        near = [f"@{name}{dot}{port}" for name in nearest(node, draft.names())]
        refuse(where, f"{text}: there is no node {node!r}", near=near)
    if source.path is not None and not is_block(draft.entry(source.path)):
        kind = draft.kind(draft.entry(source.path))
        if kind is not None and source.port and source.port not in (*kind.outputs, *kind.renamed_outputs):
            near = [f"@{text[1:].rpartition('.')[0]}.{name}" for name in kind.outputs]
            refuse(where, f"{text}: {draft.entry(source.path)['type']} has no output {source.port!r}", near=near)
