"""Operations that change one value or one wire: `set`, `connect`, `disconnect`; see `patches`.

Patches reach into sub-graphs: to their parameters and inputs, and to single nodes inside. What `set`, `connect` and
`bypass` say of a node inside goes into the `nodes:` of the entry that uses the file; for `replace`, `insert`, `add` and
`remove`, which change which nodes there are, the entry gets a changed copy of the file (`taken_apart`). So the file
itself and its other uses stay as they are.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import create_model

from exmesh_graph.graph.declare.ports import Signature
from exmesh_graph.graph.language.params import forget, given, is_declaration
from exmesh_graph.graph.language.parts import PartFiles, input_ports
from exmesh_graph.graph.language.spec import Value, tree_of
from exmesh_graph.graph.language.yamlfile import Map, copied
from exmesh_graph.graph.problems import GraphErrors, Problems, Where, closest, nearest
from exmesh_graph.graph.variants.draft import Address, Draft, LinkPlace, is_block, is_link, is_part, layers_of, refuse
from exmesh_graph.params import Params


@dataclass(frozen=True)
class Target:
    """A key of a node or block that a patch names, in the file of `draft`: the entry that stands there now.

    `holder` takes the change: the same entry, or for a node inside a sub-graph what its user says of it. `link` tells
    an input port from a parameter.
    """

    draft: Draft
    address: Address
    entry: Map
    holder: Map
    link: bool

    @property
    def kinds(self) -> list[Signature]:
        return self.draft.kinds(self.entry)

    @property
    def names(self) -> set[str]:
        """The names that the parameter or port has or had, in any round."""
        return {self.address.key}.union(*(kind.names_of(self.address.key) for kind in self.kinds))

    def known(self, kind: Signature) -> list[str]:
        """The keys of this sort that a type has."""
        return list(kind.inputs) if self.link else [*kind.params.model_fields, "seed"]

    def put(self, value: Any, where: Where) -> None:
        """Set the key in every round, whatever single rounds had, or in one round; where the type has such a key."""
        kind, key = self.draft.kind(self.entry), self.address.key

        def put(holder: Map, names: set[str]) -> None:
            for name in names - {key}:
                holder.pop(name, None)
            holder.put(key, copied(value), where)

        def names_in(kind: Signature | None) -> set[str]:
            return {key} if kind is None else kind.names_of(key)

        if self.address.round is not None:
            layer = self.round_settings(where)
            put(layer, names_in(self.draft.kind(layer) or kind))
            return
        if kind is None or names_in(kind) & set(self.known(kind)):
            put(self.holder, names_in(kind))
        for layer, word, number in layers_of(self.entry):
            own = self.draft.kind(layer)
            if names_in(own or kind) & set(layer if own is None else self.known(own)):
                put(self.holder.inner(word, where).inner(number, where), names_in(own or kind))

    def round_settings(self, where: Where) -> Map:
        """The settings of the one round that is named."""
        scope = self.address.scope
        count = self.draft.read(self.draft.entries[scope], "repeat") if self.holder is self.entry else None
        if isinstance(count, int) and not 1 <= (self.address.round or 0) <= count:
            refuse(where, f"{scope} has no round {self.address.round}", expected=f"1 to {count}")
        return self.holder.inner("at", where).inner(self.address.round, where)


def set_values(draft: Draft, patch: Map) -> None:
    if isinstance(patch["set"], Map):  # several at once
        for target, value in patch["set"].items():
            _set_one(draft, target, value, patch["set"].lines[target], patch["set"].lines[target])
    else:
        _set_one(draft, patch["set"], patch["to"], patch.lines["set"], patch.lines["to"])


def _set_one(draft: Draft, text: Any, value: Any, where: Where, there: Where) -> None:
    params = draft.top.get("params")
    if not isinstance(text, str) or "." in text:
        target = target_of(draft, text, where, link=False)
        if target is not None:
            target.put(value, there)
    elif text == "seed":
        draft.top.put("seed", value, there)
    elif isinstance(params, Map) and text in params:
        forget(params, {text: value})
        params.put(text, given(params[text], value, there), there)
        if is_declaration(params[text]):  # a private copy; the patch counts more than the environment
            params[text].pop("env", None)
    else:
        names = [*(params or ()), "seed"]
        fix = f"a node's parameter is set with {{set: {text}.PARAMETER, to: ...}}" if text in draft.entries else ""
        refuse(where, f"the graph has no parameter {text!r}", near=closest(text, names), fix=fix)


def connect(draft: Draft, patch: Map) -> None:
    text, where, link, there = patch["connect"], patch.lines["connect"], patch["to"], patch.lines["to"]
    if not is_link(link):
        fix = f"{{set: {text}, to: {link!r}}} sets a parameter"
        refuse(there, f"{link!r} is not a link", expected='"@node.port"', fix=fix)
    place = fixed_place(draft, text)
    if place is not None:
        _check_source(draft, link, place.scope, there)
        place.holder.put(place.key, link, there)
        return
    target = target_of(draft, text, where, link=True)
    if target is not None:
        if target.draft is draft:
            _check_source(draft, link, target.address.scope, there)
        target.put(link, there)


def disconnect(draft: Draft, patch: Map) -> None:
    text, where = patch["disconnect"], patch.lines["disconnect"]
    place = fixed_place(draft, text)
    if place is not None and str(text).startswith("outputs."):
        if place.key not in place.holder:
            refuse(where, f"there is no {text}", near=[f"outputs.{name}" for name in place.holder])
        del place.holder[place.key]
        return
    draft, text = taken_apart(draft, text)
    target = target_of(draft, text, where, link=True)
    assert target is not None
    entry, node, names = target.entry, target.address.path, target.names
    for port in (kind.inputs[name] for kind in target.kinds for name in names & kind.inputs.keys()):
        if not port.optional:
            refuse(where, f"{text} must be connected: {entry.get('type')} needs its {port}",
                   fix=f"connect something else, or {{bypass: {node}}}")  # fmt: skip
    holders = (entry, *(layer for layer, _, _ in layers_of(entry)))
    wired = [(holder, name) for holder in holders for name in names if is_link(holder.get(name))]
    if not wired:
        linked = [f"{node}.{other}" for other, value in entry.items() if is_link(value)]
        refuse(where, f"{text} is not connected", near=nearest(str(text), linked))
    if target.address.round is not None:
        target.round_settings(where).put(target.address.key, None, where)
        return
    for holder, name in wired:
        del holder[name]


def fixed_place(draft: Draft, target: Any) -> LinkPlace | None:
    """The place that `outputs.asset`, `rounds.carry.state` or `rounds.next.state` names."""
    head, _, key = target.rpartition(".") if isinstance(target, str) else ("", "", "")
    block, _, word = head.rpartition(".")
    entries = draft.entries
    if head == "outputs" and head not in entries:
        return LinkPlace(draft.top.inner(head, draft.top.where), key, "", "", target)
    if word in ("carry", "next") and is_block(entries.get(block)) and head not in entries:
        holder = entries[block].get(word)
        if isinstance(holder, Map) and key in holder:
            return LinkPlace(holder, key, block.rpartition(".")[0] if word == "carry" else block, "", target)
    return None


def taken_apart(draft: Draft, text: Any, *, key: bool = True) -> tuple[Draft, Any]:
    """The draft that holds what a patch names (a `key` of a node), and its name there; a sub-graph around it becomes a
    copy of its file.
    """
    plain = text.removeprefix("@") if isinstance(text, str) else ""
    user = draft.part_around(plain)
    if not user or (key and "." not in _below(plain, user)):
        return draft, text
    entry = draft.entries[user]
    part = file_of(draft, entry)
    if part is None or "[" in text[: len(text) - len(_below(plain, user))]:
        return draft, text  # refused where it is looked up
    entry.put("graph", part, entry.lines["graph"])
    entry.pop("nodes", None)
    return taken_apart(Draft(part, draft.packs), "@" * text.startswith("@") + _below(plain, user), key=key)


def _below(text: str, user: str) -> str:
    """What a path says behind the sub-graph that it leads into."""
    return text.split(".", user.count(".") + 1)[-1]


def kind_of(draft: Draft, entry: Map) -> Signature | None:
    """What an entry looks like from outside; the parameters of a sub-graph take anything. None where it is unknown."""
    part = file_of(draft, entry) if is_part(entry) else None
    if part is None:
        return draft.kind(entry)
    tree, inner = tree_of(part, draft.top.where.file or Path(), (), Problems()), Draft(part, draft.packs)
    ends = {str(name): inner.port_of(str(link), "") for name, link in tree.outputs.items()}
    taken: dict[str, Any] = dict.fromkeys(tree.params, (Any, None))
    params = create_model("Part", __base__=Params, **taken)
    return Signature(input_ports(tree, Problems()), {n: end for n, end in ends.items() if end}, params, None, "")


def node_of(draft: Draft, text: Any, where: Where) -> Target:
    """The node that a patch names."""
    target = _reached(draft, text, where, key=False)
    return target or Target(draft, draft.address(text, where, key=False), Map(where), Map(where), False)


def target_of(draft: Draft, text: Any, where: Where, *, link: bool) -> Target | None:
    """The parameter or input port (`link`) that a patch names, refused where its node or block has none such.

    None where it lies in a sub-graph whose file cannot be read: `check` says why.
    """
    user = draft.part_around(text) if isinstance(text, str) else ""
    if user and "." not in (key := _below(text, user)):
        holder = draft.entries[user]
        part = file_of(draft, holder)
        own = {} if part is None else part.get("inputs" if link else "params") or ()
        if part is not None and key not in own and (link or key != "seed"):
            near = [f"{user}.{other}" for other in closest(key, own)]
            refuse(where, f"the sub-graph {user} has no {'input' if link else 'parameter'} {key!r}", near=near)
        return None if part is None else Target(draft, Address(user, None, key), holder, holder, link)
    target = _reached(draft, text, where, key=True, link=link)
    if target is not None:
        _check_key(target, text, where)
    return target


def _reached(draft: Draft, text: Any, where: Where, *, key: bool, link: bool = False) -> Target | None:
    """What a patch names, in this file or in that of a sub-graph; None where that cannot be read."""
    user, holder = draft.part_around(text) if isinstance(text, str) else "", None
    if user:
        holder, text = draft.entries[user], _below(text, user)
        part = file_of(draft, holder)
        if part is None:
            return None
        draft = Draft(part, draft.packs)
    address = draft.address(text, where, key=key)
    entry = draft.entries[address.path]
    if holder is None or isinstance(holder["graph"], Map):
        return Target(draft, address, entry, entry, link)
    if is_part(entry) and key:
        refuse(where, f"{text} lies in a sub-graph of a sub-graph", fix="patch the file that uses it")
    for name in address.path.split("."):
        holder = holder.inner("nodes", where).inner(name, where)
    return Target(draft, address, entry, holder, link)


def _check_key(target: Target, text: str, where: Where) -> None:
    entry, key, name = target.entry, target.address.key, text.rpartition(".")[0]
    if is_block(entry):
        if target.link:
            carried = [f"{name}.{word}.{other}" for word in ("carry", "next") for other in entry.get(word) or ()]
            fix = "name the carried value or a node in the block"
            refuse(where, f"{name} is a repeat block", near=carried, fix=fix)
        if key != "repeat" or target.address.round is not None:
            refuse(where, f"the block {name} has no parameter {key!r}", near=[f"{name}.repeat"])
        return
    known, names = list(dict.fromkeys(key for kind in target.kinds for key in target.known(kind))), target.names
    if target.kinds and not names & set(known):
        others = {other for kind in target.kinds for other in (*kind.inputs, *kind.params.model_fields)}
        near = [f"{name}.{other}" for other in nearest(key, known) or known[:5]]
        word, fix = ("input port", f"{{set: {text}, to: ...}}") if target.link else ("parameter", "")
        if names & others and not target.link:
            refuse(where, f"{text} is an input port, not a parameter", fix=f'{{connect: {text}, to: "@node.port"}}')
        refuse(where, f"{entry.get('type')} has no {word} {key!r}", near=near, fix=fix if names & others else "")


def file_of(draft: Draft, entry: Map) -> Map | None:
    """The merged file of a sub-graph with the patches of its use; None where it cannot be read."""
    if isinstance(entry["graph"], Map):  # a patch took it apart
        return entry["graph"]
    where, files = entry.lines["graph"], PartFiles(Problems())
    with contextlib.suppress(GraphErrors):
        path = files.path(Value(draft.read(entry, "graph"), where, where.base), where, ())
        return None if path is None else files.merged(path, where, entry.get("nodes"))
    return None


def _check_source(draft: Draft, text: str, scope: str, where: Where) -> None:
    """Refuse a link to nowhere; whether its type fits is left to `check`, which looks at every wire."""
    source, link = draft.source(text, scope), text.removeprefix("@")
    node, dot, port = link.rpartition(".") if "." in link else (link, "", "")
    if source is None:
        near = [f"@{name}{dot}{port}" for name in nearest(node, draft.entries)]
        refuse(where, f"{text}: there is no node {node!r}", near=near)
    entry = draft.entries.get(source.path or "")
    kind = draft.kind(entry)
    if entry and kind is not None and source.port and source.port not in (*kind.outputs, *kind.renamed_outputs):
        near = [f"@{node}.{name}" for name in kind.outputs]
        refuse(where, f"{text}: {entry['type']} has no output {source.port!r}", near=near)
