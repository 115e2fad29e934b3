"""Operations that change which nodes there are: `replace`, `insert`, `bypass`, `remove`, `add`; see `patches`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from exmesh_graph.graph.declare.ports import Port, Signature, type_name
from exmesh_graph.graph.language.yamlfile import Map, copied
from exmesh_graph.graph.problems import Where, closest, in_short, nearest
from exmesh_graph.graph.variants.draft import Draft, LinkPlace, is_block, is_link, is_part, layers_of, refuse
from exmesh_graph.graph.variants.values import fixed_place, kind_of, node_of, taken_apart, target_of


def replace(draft: Draft, patch: Map) -> None:
    where, word = patch.lines["replace"], "type" if "type" in patch else "graph"
    there = patch.lines[word]
    draft, named = taken_apart(draft, patch["replace"], key=False)
    node = node_of(draft, named, where)
    address, entry = node.address, node.entry
    if is_block(entry):
        refuse(where, f"{address.path} is a repeat block", fix="replace the nodes in it")
    new, old = _new_kind(draft, patch, there), kind_of(draft, entry)
    renamed = _renames(patch, old, new)
    given = {key: value for key, value in patch.items() if key not in ("replace", "ports")}
    if address.round is not None:
        if renamed:
            refuse(patch.lines["ports"], "ports cannot be renamed in a single round", fix="replace it in every round")
        kept = node.round_settings(where)
    else:
        used = draft.users(address.path)
        for place, source in used:
            target = renamed.get(source.port, source.port)
            if not target and new.component is None:
                what = f"{patch['type']} is a node, but {address.path} is a component"
                refuse(there, what, fix="replace it by a component")
            if target and target not in new.outputs:
                what = f"{patch[word]} has no output {target!r}, which {place.label} ({place.where}) uses"
                fix = f"ports: {{{source.port}: {next(iter(new.outputs), '...')}}}"
                refuse(where, what, expected=_ports(new.outputs), fix=fix)
        for place, source in used:
            if source.port in renamed:
                place.holder[place.key] = f"{place.text.rpartition('.')[0]}.{renamed[source.port]}"
        kept = Map(entry.where)
        for key, value in entry.items():
            into = renamed[key] if renamed.get(key) in new.inputs else key
            if into in new.inputs or into in new.params.model_fields or key in ("seed", "doc"):
                kept.put(into, value, entry.lines[key])
        draft.inside(address.scope).put(address.name, kept, where)
    for key, value in given.items():
        kept.put(key, copied(value), patch.lines[key])


def insert(draft: Draft, patch: Map) -> None:
    where, there, new, on = patch.lines["insert"], patch.lines["on"], patch["insert"], patch["on"]
    if not isinstance(new, Map) or "name" not in new or not {"type", "graph"} & set(new):
        refuse(where, "insert needs the new node", expected='{insert: {name: ..., type: ..., ...}, on: "pbr.carrier"}')
    draft, on = taken_apart(draft, on)
    kind = _new_kind(draft, new, there)
    single = re.search(r"\[(\d+)\]\.[^.\[]+\.[^.\[]+\Z", str(on))  # the round of the innermost block
    if is_link(on):
        meant = draft.source(on, "")
        if meant is None or not meant.path:
            near = [f"@{name}" for name in nearest(on[1:].rpartition(".")[0], draft.entries)]
            refuse(there, f"{on} is the output of no node", near=near, expected='"@rounds.split.state", blocks named')
        scope, text = meant.scope, f"@{meant.name}.{meant.port}"
        users = [(p, s) for p, s in draft.users(meant.path) if (s.path, s.port) == (meant.path, meant.port)]
        if not users:
            refuse(there, f"nothing uses {on}", fix=f"{{add: {{name: {new['name']}, type: {new['type']}, ...}}}}")
        places = [(place, draft.moved(text, scope, place, source, there)) for place, source in users]
    else:
        place = _wire_into(draft, on, there)
        scope, text, places = place.scope, place.text, [(place, place.text)]
    name = draft.check_free(new["name"], scope, new.lines["name"])
    wire = draft.port_of(text, scope)
    source_port = _pick(patch, "in", {n: p for n, p in kind.inputs.items() if n not in new}, wire, new, there)
    output = _pick(patch, "out", kind.outputs, wire, new, there)
    for place, read in places:
        block, dot, _ = ("", "", "") if place.scope == scope else read.rpartition(".")[0].rpartition(".")
        place.put(f"{block}{dot or '@'}{name}.{output}", there)
    entry = _put_new(draft, scope, name, new, where)
    entry.put(source_port, text, there)
    if single:
        entry.inner("bypass", there).put(output, source_port, there)
        entry.inner("at", there).inner(int(single[1]), there).put("bypass", None, there)


def bypass(draft: Draft, patch: Map) -> None:
    where = patch.lines["bypass"]
    target = node_of(draft, patch["bypass"], where)
    draft, address, entry = target.draft, target.address, target.entry
    name, kind = address.path, kind_of(draft, entry)
    if is_block(entry):
        refuse(where, f"{name} is a repeat block", fix=f"{{set: {name}.repeat, to: 0}}")
    holder = target.holder if address.round is None else target.round_settings(where)
    if holder.get("bypass") is not None:
        refuse(where, f"{name} is bypassed already")
    if kind is None:
        refuse(where, f"the type of {name} is unknown: {entry.get('type')!r}")
    if kind.component is not None:
        fix = f"{{replace: {name}, type: ...}}, or disconnect what it is plugged into"
        refuse(where, f"{name} is a component, through which nothing flows", fix=fix)
    used = draft.users(name)
    wired = {port: kind.inputs[port] for port in kind.inputs if is_link(entry.get(port))}
    wired = {port: end for port, end in wired.items() if not end.plugged}
    through = {port: _way_through(patch, name, kind, wired, port) for port in dict.fromkeys(s.port for _, s in used)}
    if address.round is not None or target.holder is not entry or is_part(entry):
        for output, port in through.items():
            holder.inner("bypass", where).put(output, port, where)
        return
    for port in through.values():
        for layer, word, number in layers_of(entry):
            if port in layer:
                refuse(where, f"{name} gets another {port} in some rounds ({word} {number})",
                       fix=f"{{connect: {name}.{port}, to: ...}} first")  # fmt: skip
    for place, source in used:
        text = draft.moved(entry[through[source.port]], address.scope, place, source, where)
        place.put(text, where)
    del draft.inside(address.scope)[address.name]


def remove(draft: Draft, patch: Map) -> None:
    where, value = patch.lines["remove"], patch["remove"]
    homes = [taken_apart(draft, name, key=False) for name in (value if isinstance(value, list) else [value])]
    if len({id(home.top) for home, _ in homes}) > 1:
        refuse(where, "remove takes nodes of one file at a time", fix="a patch for each file")
    draft = homes[0][0] if homes else draft
    gone = [draft.address(name, where, key=False) for _, name in homes]
    for address in [one for one in gone if one.round is not None]:
        refuse(where, f"remove works on all rounds at once, not on {address.round} of {address.path}",
               fix=f"{{bypass: '{address.scope}[{address.round}].{address.name}'}}")  # fmt: skip
    names = ", ".join(address.path for address in gone)
    left = [place for place, _ in draft.users(*(address.path for address in gone))]
    if left:
        users = in_short([f"{place.label} ({place.where})" for place in left], 4)
        outputs = [place.label for place in left if place.owner == "outputs"]
        blocks = [address.path for address in gone if is_block(draft.entries[address.path])]
        fix = f"{{set: {blocks[0]}.repeat, to: 0}}" if blocks else f"{{bypass: {gone[0].path}}}, or remove its users"
        fix = f"{{disconnect: {outputs[0]}}} first" if outputs else fix
        refuse(where, f"{names} cannot be removed: {users} links to it", fix=fix)
    for address in sorted(gone, key=lambda a: a.path.count("."), reverse=True):
        del draft.inside(address.scope)[address.name]


def add(draft: Draft, patch: Map) -> None:
    where, new = patch.lines["add"], patch["add"]
    if not isinstance(new, Map) or "name" not in new or not {"type", "graph", "repeat"} & set(new):
        expected = "{add: {name: ..., type: ..., ...}}"
        refuse(where, "add needs a name and a node", expected=expected, fix="type, graph or repeat")
    draft, full = taken_apart(draft, new["name"], key=False)
    scope, _, name = str(full).rpartition(".")
    blocks = [path for path, entry in draft.entries.items() if is_block(entry)]
    if scope and scope not in blocks:
        refuse(new.lines["name"], f"there is no repeat block {scope!r}", near=closest(scope, blocks))
    draft.check_free(name, scope, new.lines["name"])
    if "type" in new and "${" not in str(new["type"]):
        draft.known_type(new["type"], new.lines["type"])
    _put_new(draft, scope, name, new, where)


def _put_new(draft: Draft, scope: str, name: str, new: Map, where: Where) -> Map:
    """The entry of a new node, where it now stands; `new` also tells its name."""
    entry: Map = copied(new)
    del entry["name"]
    draft.inside(scope).put(name, entry, where)
    return entry


def _new_kind(draft: Draft, new: Map, where: Where) -> Signature:
    """What a patch puts in."""
    if "type" in new:
        return draft.known_type(new["type"], new.lines["type"])
    return kind_of(draft, new) or refuse(where, f"no such graph file: {new['graph']!r}", fix="name one that is there")


def _wire_into(draft: Draft, target: Any, where: Where) -> LinkPlace:
    """The one wire into a port."""
    fixed = fixed_place(draft, target)
    if fixed is not None and is_link(fixed.holder.get(fixed.key)):
        return fixed
    goal = target_of(draft, target, where, link=True)
    assert goal is not None
    entry, key = goal.entry, goal.address.key
    if not is_link(entry.get(key)):
        refuse(where, f"{target} is not connected", fix="add the node and connect both of its ends")
    if any(kind.inputs[key].plugged for kind in goal.kinds if key in kind.inputs):
        refuse(where, f"{target} takes a component, which is no wire", fix=f'{{connect: {target}, to: "@component"}}')
    for layer, word, number in layers_of(entry):
        if key in layer:
            what = f"{target} is wired otherwise in some rounds ({word} {number})"
            refuse(where, what, fix="connect it in every round first")
    return LinkPlace(entry, key, goal.address.scope, goal.address.path, str(target))


def _renames(patch: Map, old: Signature | None, new: Signature) -> dict[str, str]:
    """`ports: {old: new}` of a replacement."""
    ports = patch.get("ports")
    if ports is None:
        return {}
    if not isinstance(ports, Map):
        refuse(patch.lines["ports"], "ports: maps old port names to new ones", expected="{state: mesh}")
    for before, after in ports.items():
        for owner, kind, name in (("the old node", old, before), (patch["type"], new, after)):
            if kind is not None and name not in (*kind.inputs, *kind.outputs):
                near = closest(name, [*kind.inputs, *kind.outputs])
                refuse(ports.lines[before], f"{owner} has no port {name!r}", near=near)
    return {str(before): str(after) for before, after in ports.items()}


def _pick(patch: Map, key: str, ports: Mapping[str, Port], wire: Port | None, new: Map, where: Where) -> str:
    """The port of an inserted node that goes on the wire."""
    side = "input" if key == "in" else "output"
    if key in patch:
        if patch[key] not in ports:
            what = f"{new['name']} has no free {side} {patch[key]!r}"
            refuse(patch.lines[key], what, near=closest(patch[key], ports))
        return str(patch[key])
    fits = {name: port for name, port in ports.items() if wire is None or _fits(port, wire, side)}
    fits = {name: port for name, port in fits.items() if not port.optional} or fits
    if len(fits) != 1:
        found = _ports(fits) or "none"
        carried = f" that carries {wire}" if wire else ""
        refuse(where, f"{new.get('type', new['name'])} has {len(fits) or 'no'} {side}s{carried}", found=found,
               expected=f"one, or {key}: NAME", near=list(fits or ports))  # fmt: skip
    return next(iter(fits))


def _fits(port: Port, wire: Port, side: str) -> bool:
    return issubclass(wire.type, port.types) if side == "input" else issubclass(port.type, wire.type)


def _way_through(patch: Map, name: str, kind: Signature, wired: Mapping[str, Port], port: str) -> str:
    """The input that stands in for an output of a bypassed node: the one wired input of the same type."""
    where = patch.lines["bypass"]
    if port not in kind.outputs:
        refuse(where, f"{name} has no output {port!r}, but something links to it", near=nearest(port, kind.outputs))
    wanted = kind.outputs[port].type
    via = patch.get("via")
    given = via.get(port) if isinstance(via, Map) else via
    if given is not None:
        there = patch.lines["via"]
        if given not in wired:
            refuse(there, f"{name} has no connected input {given!r}", near=closest(given, wired))
        if not all(issubclass(kind, wanted) for kind in wired[given].types):
            what = f"{name}: the input {given} is no {type_name(wanted)}"
            refuse(there, what, expected=str(kind.outputs[port]), found=str(wired[given]))
        return str(given)
    equal = [n for n, p in wired.items() if p.types == (wanted,)]
    fits = equal or [n for n, p in wired.items() if all(issubclass(kind, wanted) for kind in p.types)]
    if len(fits) > 1:
        refuse(where, f"{name} can be bypassed in {len(fits)} ways: {', '.join(fits)} are all {type_name(wanted)}",
               fix=f"{{bypass: {name}, via: {fits[0]}}}")  # fmt: skip
    if not fits:
        what = f"{name} cannot be bypassed: no connected input is a {type_name(wanted)}, which {port} is"
        fix = f"{{replace: {name}, type: ...}}, or connect what uses {name}.{port} to something else"
        refuse(where, what, found=_ports(wired), fix=fix)
    return fits[0]


def _ports(ports: Mapping[str, Port]) -> str:
    return ", ".join(f"{name}: {port}" for name, port in ports.items())
