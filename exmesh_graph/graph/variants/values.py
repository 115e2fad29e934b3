"""Operations that change one value or one wire: `set`, `connect`, `disconnect`; see `patches`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from exmesh_graph.graph.declare.ports import Signature
from exmesh_graph.graph.language.params import give
from exmesh_graph.graph.language.yamlfile import Map
from exmesh_graph.graph.problems import Where, nearest
from exmesh_graph.graph.variants.draft import Address, Draft, clone, is_block, is_link, layers_of, refuse
from exmesh_graph.graph.variants.inside import part_in, put_inside


def set_values(draft: Draft, patch: Map) -> None:
    if isinstance(patch["set"], Map):  # several at once
        for target, value in patch["set"].items():
            _set_one(draft, target, value, patch["set"].lines[target], patch["set"].lines[target])
    else:
        value = need(patch, "to", "set", "a value")
        _set_one(draft, patch["set"], value, patch.lines["set"], patch.lines["to"])


def _set_one(draft: Draft, target: Any, value: Any, where: Where, there: Where) -> None:
    top = draft.top
    if isinstance(target, str) and "." not in target:
        params = top.get("params")
        if target == "seed":
            top.put("seed", value, there)
        elif isinstance(params, Map) and target in params:
            give(params, target, value, there)
        else:
            names = [*(params or ()), "seed"]
            named = f"a node's parameter is set with {{set: {target}.PARAMETER, to: ...}}"
            fix = named if target in draft.names() else ""
            refuse(where, f"the graph has no parameter {target!r}", near=nearest(target, names) or names, fix=fix)
        return
    part = part_in(draft, target)
    if part is not None:
        put_inside(draft, *part, value, where, there, link=False)
        return
    address = draft.address(target, where, key=True)
    entry = draft.entry(address.path)
    if is_block(entry):
        if address.key != "repeat" or address.round is not None:
            refuse(where, f"the block {'.'.join(address.path)} has no parameter {address.key!r}",
                   near=[f"{'.'.join(address.path)}.repeat"])  # fmt: skip
        entry.put("repeat", value, there)
        return
    kinds = draft.kinds(entry)
    if address.key != "seed":
        if any(kind.names_of(address.key) & kind.inputs.keys() for kind in kinds):
            fix = f'{{connect: {target}, to: "@node.port"}}'
            refuse(where, f"{target} is an input port, not a parameter", fix=fix)
        fields = [field for kind in kinds for field in kind.params.model_fields]
        if kinds and not any(kind.names_of(address.key) & kind.params.model_fields.keys() for kind in kinds):
            near = [f"{'.'.join(address.path)}.{name}" for name in nearest(address.key, fields) or fields[:5]]
            refuse(where, f"{entry.get('type')} has no parameter {address.key!r}", near=near)
    known = lambda kind: {"seed", *kind.params.model_fields}  # noqa: E731
    _put(draft, entry, address, value, there, known)


def connect(draft: Draft, patch: Map) -> None:
    text, where = need(patch, "to", "connect", 'a link "@node.port"'), patch.lines["connect"]
    there = patch.lines["to"]
    if not is_link(text):
        fix = f"{{set: {patch['connect']}, to: {text!r}}} sets a parameter"
        refuse(there, f"{text!r} is not a link", expected='"@node.port"', fix=fix)
    spot = fixed_spot(draft, patch["connect"])
    if spot is not None:
        _known_source(draft, text, spot[2], there)
        spot[0].put(spot[1], text, there)
        return
    part = part_in(draft, patch["connect"])
    if part is not None:
        if "." not in part[1]:
            _known_source(draft, text, part[0][:-1], there)
        put_inside(draft, *part, text, where, there, link=True)
        return
    address = port_address(draft, patch["connect"], where)
    _known_source(draft, text, address.scope, there)
    entry = draft.entry(address.path)
    _put(draft, entry, address, text, there, lambda kind: set(kind.inputs))


def disconnect(draft: Draft, patch: Map) -> None:
    target, where = patch["disconnect"], patch.lines["disconnect"]
    spot = fixed_spot(draft, target)
    if spot is not None and str(target).startswith("outputs."):
        if spot[1] not in spot[0]:
            refuse(where, f"there is no {target}", near=[f"outputs.{name}" for name in spot[0]])
        del spot[0][spot[1]]
        return
    address = port_address(draft, target, where)
    entry = draft.entry(address.path)
    names = {address.key}.union(*(kind.names_of(address.key) for kind in draft.kinds(entry)))
    for kind in draft.kinds(entry):
        port = next((port for name, port in kind.inputs.items() if name in names), None)
        if port is not None and not port.optional:
            refuse(where, f"{target} must be connected: {entry.get('type')} needs its {port}",
                   fix=f"connect something else, or {{bypass: {'.'.join(address.path)}}}")  # fmt: skip
    holders = (entry, *(layer for layer, _ in layers_of(entry)))
    wired = [(holder, name) for holder in holders for name in names if is_link(holder.get(name))]
    if not wired:
        linked = [f"{'.'.join(address.path)}.{key}" for key, value in entry.items() if is_link(value)]
        refuse(where, f"{target} is not connected", near=nearest(str(target), linked))
    if address.round is not None:
        round_layer(draft, entry, address, where).put(address.key, None, where)
        return
    for holder, name in wired:
        del holder[name]


def need(patch: Map, key: str, name: str, expected: str) -> Any:
    return patch[needed(patch, key, name, expected)]


def needed(patch: Map, key: str, name: str, expected: str) -> str:
    if key not in patch:
        refuse(patch.where, f"{name} needs {key}:", expected=f"{key}: {expected}")
    return key


def _put(
    draft: Draft, entry: Map, address: Address, value: Any, where: Where, known: Callable[[Signature], set[str]]
) -> None:
    """Set a key in every round, whatever single rounds had, or in one round."""
    if address.round is not None:
        layer = round_layer(draft, entry, address, where)
        own = draft.kind(layer) or draft.kind(entry)
        _put_one(layer, address.key, own.names_of(address.key) if own else set(), value, where)
        return
    kind = draft.kind(entry)
    names = {address.key} if kind is None else kind.names_of(address.key)
    if kind is None or names & known(kind):
        _put_one(entry, address.key, names, value, where)
    for layer, _ in layers_of(entry):
        other = draft.kind(layer)
        if other is not None and other.names_of(address.key) & known(other):
            _put_one(layer, address.key, other.names_of(address.key), value, where)
        elif other is None:
            for name in names:
                layer.pop(name, None)


def _put_one(holder: Map, key: str, names: set[str], value: Any, where: Where) -> None:
    """Set a key in place of all names that the same parameter or port has or had."""
    for name in names - {key}:
        holder.pop(name, None)
    holder.put(key, clone(value), where)


def round_layer(draft: Draft, entry: Map, address: Address, where: Where) -> Map:
    """The settings of one round of a node, made where there are none."""
    count = draft.read(draft.entry(address.scope), "repeat")
    if isinstance(count, int) and not 1 <= (address.round or 0) <= count:
        refuse(where, f"{'.'.join(address.scope)} has no round {address.round}", expected=f"1 to {count}")
    rounds = entry.get("at")
    if not isinstance(rounds, Map):
        rounds = Map(where)
        entry.put("at", rounds, where)
    layer = rounds.get(address.round)
    if not isinstance(layer, Map):
        layer = Map(where)
        rounds.put(address.round, layer, where)
    return layer


def port_address(draft: Draft, target: Any, where: Where) -> Address:
    """The input port that a patch names."""
    address = draft.address(target, where, key=True)
    entry = draft.entry(address.path)
    if is_block(entry):
        block = ".".join(address.path)
        carried = [f"{block}.{key}.{name}" for key in ("carry", "next") for name in entry.get(key) or ()]
        refuse(where, f"{block} is a repeat block", near=carried, fix="name the carried value or a node in the block")
    kinds = draft.kinds(entry)
    ports = [port for kind in kinds for port in kind.inputs]
    if kinds and not any(kind.names_of(address.key) & kind.inputs.keys() for kind in kinds):
        isparam = any(address.key in kind.params.model_fields for kind in kinds)
        fix = f"{{set: {target}, to: ...}}" if isparam else ""
        near = [f"{'.'.join(address.path)}.{name}" for name in nearest(address.key, ports) or ports]
        refuse(where, f"{entry.get('type')} has no input port {address.key!r}", near=near, fix=fix)
    return address


def fixed_spot(draft: Draft, target: Any) -> tuple[Map, str, tuple[str, ...]] | None:
    """(mapping, key, scope) of `outputs.asset`, `rounds.carry.state` and `rounds.next.state`."""
    parts = target.split(".") if isinstance(target, str) else []
    if len(parts) == 2 and parts[0] == "outputs" and "outputs" not in draft.nodes:
        if not isinstance(draft.top.get("outputs"), Map):
            draft.top.put("outputs", Map(draft.top.where), draft.top.where)
        return draft.top["outputs"], parts[1], ()
    path, known = tuple(parts[:-2]), set(draft.paths())
    if len(parts) > 2 and parts[-2] in ("carry", "next") and path in known and is_block(draft.entry(path)):
        holder = draft.entry(path).get(parts[-2])
        if isinstance(holder, Map) and parts[-1] in holder and (*path, parts[-2]) not in known:
            return holder, parts[-1], path[:-1] if parts[-2] == "carry" else path
    return None


def _known_source(draft: Draft, text: str, scope: tuple[str, ...], where: Where) -> None:
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
