"""Operations that change which nodes there are: `replace`, `insert`, `bypass`, `remove`, `add`; see `patches`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exmesh_graph.graph.declare.ports import Port, Signature, type_name
from exmesh_graph.graph.language.yamlfile import Map
from exmesh_graph.graph.problems import Where, nearest
from exmesh_graph.graph.variants.draft import Address, Draft, LinkPlace
from exmesh_graph.graph.variants.entries import clone, is_block, is_link, is_part, layers_of, refuse
from exmesh_graph.graph.variants.values import Target, fixed_place, need, port_target


def replace(draft: Draft, patch: Map) -> None:
    where = patch.lines["replace"]
    address = draft.address(patch["replace"], where, key=False)
    entry = draft.entry(address.path)
    if is_block(entry):
        refuse(where, f"{address} is a repeat block", fix="replace the nodes in it")
    wanted, there = need(patch, "type", "replace", "a node type"), patch.lines.get("type", where)
    new, old = draft.known_type(wanted, there), draft.kind(entry)
    renamed = _renames(patch, old, new)
    given = {key: value for key, value in patch.items() if key not in ("replace", "ports")}
    if address.round is not None:
        if renamed:
            refuse(patch.lines["ports"], "ports cannot be renamed in a single round", fix="replace it in every round")
        layer = Target(draft, address, entry, entry).round_settings(where)
        for key, value in given.items():
            layer.put(key, clone(value), patch.lines[key])
        return
    used = draft.users(address.path)
    for place, source in used:
        target = renamed.get(source.port, source.port)
        if not target and new.component is None:
            refuse(there, f"{patch['type']} is a node, but {address} is a component", fix="replace it by a component")
        if target and target not in new.outputs:
            what = f"{patch['type']} has no output {target!r}, which {place.label} ({place.where}) uses"
            fix = f"ports: {{{source.port}: {next(iter(new.outputs), '...')}}}"
            refuse(where, what, expected=_ports(new.outputs), fix=fix)
    for place, source in used:
        if source.port in renamed:
            place.put(f"{place.text.rpartition('.')[0]}.{renamed[source.port]}", place.where)
    kept = Map(entry.where)
    for key, value in entry.items():
        into = renamed[key] if renamed.get(key) in new.inputs else key
        if into in new.inputs or into in new.params.model_fields or key in ("seed", "doc"):
            kept.put(into, value, entry.lines[key])
    for key, value in given.items():
        kept.put(key, clone(value), patch.lines[key])
    draft.inside(address.scope).put(address.path[-1], kept, where)


def insert(draft: Draft, patch: Map) -> None:
    where, new = patch.lines["insert"], patch["insert"]
    if not isinstance(new, Map) or not {"name", "type"} <= set(new):
        refuse(where, "insert needs the new node", expected='{insert: {name: ..., type: ..., ...}, on: "pbr.carrier"}')
    on, there = need(patch, "on", "insert", 'a port "pbr.carrier" or a link "@settle.state"'), patch.lines["on"]
    kind = draft.known_type(new["type"], new.lines["type"])
    places: list[tuple[LinkPlace, str]]
    if is_link(on):
        meant = draft.source(on, ())
        if meant is None or meant.path is None:
            near = [f"@{name}" for name in nearest(on[1:].rpartition(".")[0], draft.names())]
            refuse(there, f"{on} is the output of no node", near=near, expected='"@rounds.split.state", blocks named')
        scope, text = meant.path[:-1], f"@{meant.path[-1]}.{meant.port}"
        name = draft.check_free(new["name"], scope, new.lines["name"])
        users = draft.users(meant.path, meant.port)
        if not users:
            refuse(there, f"nothing uses {on}", fix=f"{{add: {{name: {new['name']}, type: {new['type']}, ...}}}}")
        places = [(place, draft.moved(text, scope, place, source, there)) for place, source in users]
    else:
        place = _wire_into(draft, on, there)
        scope, text = place.scope, place.text
        name = draft.check_free(new["name"], scope, new.lines["name"])
        places = [(place, text)]
    wire = draft.port_of(text, scope)
    given = {key for key in new if key not in ("name", "type")}
    source_port = _pick(patch, "in", {n: p for n, p in kind.inputs.items() if n not in given}, wire, new, there)
    output = _pick(patch, "out", kind.outputs, wire, new, there)
    entry = _entry_of(new)
    entry.put(source_port, text, there)
    for place, read in places:
        node = read.rpartition(".")[0].rpartition(".")
        place.put(f"@{name}.{output}" if place.scope == scope else f"{node[0]}{node[1] or '@'}{name}.{output}", there)
    draft.inside(scope).put(name, entry, where)


def bypass(draft: Draft, patch: Map) -> None:
    where = patch.lines["bypass"]
    address = _whole_node(draft, patch["bypass"], where, "bypass")
    entry = draft.entry(address.path)
    if is_part(entry):
        refuse(where, f"{address} is a sub-graph", fix=f"connect what uses {address} to something else and remove it")
    kind = draft.kind(entry)
    if kind is None:
        refuse(where, f"the type of {address} is unknown: {entry.get('type')!r}")
    used = draft.users(address.path)
    if kind.component is not None:
        fix = f"{{replace: {address}, type: ...}}, or disconnect what it is plugged into"
        refuse(where, f"{address} is a component, through which nothing flows", fix=fix)
    wired = {name: port for name, port in kind.inputs.items() if is_link(entry.get(name)) and not port.plugged}
    through = {}
    for port in dict.fromkeys(source.port for _, source in used):
        through[port] = _way_through(patch, str(address), kind, wired, port)
        for layer, word, number in layers_of(entry):
            if through[port] in layer:
                refuse(where, f"{address} gets another {through[port]} in some rounds ({word} {number})",
                       fix=f"{{connect: {address}.{through[port]}, to: ...}} first")  # fmt: skip
    for place, source in used:
        text = draft.moved(entry[through[source.port]], address.scope, place, source, where)
        place.put(text, where)
    del draft.inside(address.scope)[address.path[-1]]


def remove(draft: Draft, patch: Map) -> None:
    where, value = patch.lines["remove"], patch["remove"]
    addresses = [_whole_node(draft, n, where, "remove") for n in (value if isinstance(value, list) else [value])]
    gone = [address.path for address in addresses]
    left = [
        (place, source)
        for path in gone
        for place, source in draft.users(path)
        if not any(place.owner[: len(other)] == other for other in gone)
    ]
    if left:
        users = ", ".join(f"{place.label} ({place.where})" for place, _ in left[:4])
        more = f" and {len(left) - 4} more" if len(left) > 4 else ""
        names = ", ".join(".".join(path) for path in gone)
        outputs = [place.label for place, _ in left if place.owner == ("outputs",)]
        fix = f"{{disconnect: {outputs[0]}}}" if outputs else f"{{bypass: {names}}}, or remove what uses it as well"
        refuse(where, f"{names} cannot be removed: {users}{more} links to it", fix=f"{fix} first" if outputs else fix)
    for path in sorted(gone, key=len, reverse=True):
        del draft.inside(path[:-1])[path[-1]]


def add(draft: Draft, patch: Map) -> None:
    where, new = patch.lines["add"], patch["add"]
    if not isinstance(new, Map) or "name" not in new or not {"type", "graph", "repeat"} & set(new):
        expected = "{add: {name: ..., type: ..., ...}}"
        refuse(where, "add needs a name and a node", expected=expected, fix="type, graph or repeat")
    block, _, name = str(new["name"]).rpartition(".")
    scope = tuple(block.split(".")) if block else ()
    if scope and (scope not in set(draft.paths()) or not is_block(draft.entry(scope))):
        blocks = [".".join(path) for path in draft.paths() if is_block(draft.entry(path))]
        refuse(new.lines["name"], f"there is no repeat block {block!r}", near=nearest(block, blocks) or blocks)
    draft.check_free(name, scope, new.lines["name"])
    if "type" in new and "${" not in str(new["type"]):
        draft.known_type(new["type"], new.lines["type"])
    draft.inside(scope).put(name, _entry_of(new), where)


def _entry_of(new: Map) -> Map:
    """The entry of a new node, without its name."""
    entry = clone(new)
    del entry["name"]
    return entry  # type: ignore[no-any-return]


def _whole_node(draft: Draft, text: Any, where: Where, operation: str) -> Address:
    address = draft.address(text, where, key=False)
    if address.round is not None:
        what = f"{operation} works on all rounds at once, not on {text}"
        refuse(where, what, fix=f"{operation}: {'.'.join(address.path)}")
    if operation == "bypass" and is_block(draft.entry(address.path)):
        refuse(where, f"{address} is a repeat block", fix=f"{{set: {address}.repeat, to: 0}}")
    return address


def _wire_into(draft: Draft, target: Any, where: Where) -> LinkPlace:
    """The one wire into a port."""
    fixed = fixed_place(draft, target)
    if fixed is not None and is_link(fixed.holder.get(fixed.key)):
        return fixed
    address = port_target(draft, target, where).address
    if address.round is not None:
        refuse(where, f"a node cannot be inserted in a single round: {target}", fix="insert it in every round")
    entry = draft.entry(address.path)
    if not is_link(entry.get(address.key)):
        refuse(where, f"{target} is not connected", fix="add the node and connect both of its ends")
    if any(kind.inputs[address.key].plugged for kind in draft.kinds(entry) if address.key in kind.inputs):
        refuse(where, f"{target} takes a component, which is no wire", fix=f'{{connect: {target}, to: "@component"}}')
    for layer, word, number in layers_of(entry):
        if address.key in layer:
            what = f"{target} is wired otherwise in some rounds ({word} {number})"
            refuse(where, what, fix="connect it in every round first")
    return LinkPlace(entry, address.key, address.scope, address.path, str(target))


def _renames(patch: Map, old: Signature | None, new: Signature) -> dict[str, str]:
    """`ports: {old: new}` of a replacement."""
    ports = patch.get("ports")
    if ports is None:
        return {}
    if not isinstance(ports, Map):
        refuse(patch.lines["ports"], "ports: maps old port names to new ones", expected="{state: mesh}")
    for before, after in ports.items():
        where = ports.lines[before]
        if old is not None and before not in (*old.inputs, *old.outputs):
            refuse(where, f"the old node has no port {before!r}", near=nearest(before, [*old.inputs, *old.outputs]))
        if after not in (*new.inputs, *new.outputs):
            near = nearest(str(after), [*new.inputs, *new.outputs]) or [*new.inputs, *new.outputs]
            refuse(where, f"{patch['type']} has no port {after!r}", near=near)
    return {str(before): str(after) for before, after in ports.items()}


def _pick(patch: Map, key: str, ports: Mapping[str, Port], wire: Port | None, new: Map, where: Where) -> str:
    """The port of an inserted node that goes on the wire."""
    side = "input" if key == "in" else "output"
    if key in patch:
        if patch[key] not in ports:
            near = nearest(str(patch[key]), ports) or list(ports)
            refuse(patch.lines[key], f"{new['type']} has no free {side} {patch[key]!r}", near=near)
        return str(patch[key])
    fits = {name: port for name, port in ports.items() if wire is None or _fits(port, wire, side)}
    fits = {name: port for name, port in fits.items() if not port.optional} or fits
    if len(fits) != 1:
        found = _ports(fits) or "none"
        carried = f" that carries {wire}" if wire else ""
        refuse(where, f"{new['type']} has {len(fits) or 'no'} {side}s{carried}", found=found,
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
            refuse(there, f"{name} has no connected input {given!r}", near=nearest(str(given), wired) or list(wired))
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
