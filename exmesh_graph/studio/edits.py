"""Edits of the page as patches of graph files (graph.variants.patches), so that any of them can become a variant.

Beyond the eight operations the page knows `unset`, `restore`, `output`, `rename` and `remove` with `force`; they are
written as patches here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from exmesh_graph.errors import GraphError
from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.language.yamlfile import Map, copied
from exmesh_graph.graph.problems import Where
from exmesh_graph.graph.variants.draft import Draft, LinkPlace, is_block, is_part, layers_of, refuse
from exmesh_graph.graph.variants.patches import OPERATIONS, apply_patches
from exmesh_graph.graph.variants.values import taken_apart
from exmesh_graph.studio.values import edit_place, mapped, plain

Op = Mapping[str, Any]
MOST = 2000
"""Patches that one document may hold, as many as a variant may have."""


def patched(top: Map, ops: Sequence[Op], packs: Packs, folder: Path) -> Map:
    """The merged file after the edits. Raises GraphErrors for the first that is refused."""
    if not ops:
        return top
    return apply_patches(top, [mapped(op, edit_place(folder, n)) for n, op in enumerate(ops, 1)], packs)


def with_edit(top: Map, ops: Sequence[Op], op: Any, packs: Packs, folder: Path) -> list[Op]:
    """The list of patches with one more edit of the page in it. Raises GraphErrors where it is refused."""
    if not isinstance(op, Mapping) or not op:
        raise GraphError("an edit is a mapping", expected='{"set": "node.parameter", "to": value}')
    place = edit_place(folder, len(ops) + 1)
    mapped(op, place)  # refuses what no graph file can hold
    if "unset" in op:
        return _unset(top, ops, str(op["unset"]), packs, folder)
    if "restore" in op:
        return _restored(top, ops, str(op["restore"]), packs, folder)
    draft = Draft(patched(top, ops, packs, folder), packs)
    new: list[Op]
    if "output" in op:
        new = [{"connect": f"outputs.{op['output']}", "to": op.get("to")}]
    elif "rename" in op:
        new = _renamed(draft, str(op["rename"]), op.get("to"), place)
    elif "remove" in op and op.get("force"):
        new = [*_freed(draft, op["remove"], place), {"remove": op["remove"]}]
    else:
        known = [name for name in op if name in OPERATIONS]
        if len(known) != 1:
            raise GraphError(f"{', '.join(map(repr, op)) or 'nothing'} names no edit", where="an edit",
                             expected=", ".join([*OPERATIONS, "unset", "restore", "output", "rename"]))  # fmt: skip
        new = [{key: value for key, value in op.items() if key != "force"}]
    result = [*_without_repeats(ops, new), *new]
    if len(result) > MOST:
        raise GraphError(f"more than {MOST} edits", where="an edit", fix="save the graph, then go on")
    return result


def _without_repeats(ops: Sequence[Op], new: Sequence[Op]) -> list[Op]:
    """The patches so far but for those whose value the new ones set anew."""
    words = {(word, op[word]) for op in new for word in ("set", "connect") if isinstance(op.get(word), str)}
    if len(new) != 1 or not words:
        return list(ops)
    (word, target) = next(iter(words))
    return [op for op in ops if op.get(word) != target or not isinstance(op.get(word), str)]


def _unset(top: Map, ops: Sequence[Op], target: str, packs: Packs, folder: Path) -> list[Op]:
    """Take the value back that edits gave; where none did, give the default of the type."""
    kept = [op for op in ops if op.get("set") != target]
    if len(kept) < len(ops):
        patched(top, kept, packs, folder)  # what is left must still be possible
        return kept
    draft = Draft(patched(top, ops, packs, folder), packs)
    where = edit_place(folder, len(ops) + 1)
    address = draft.address(target, where, key=True)
    kind = draft.kind(draft.entries[address.path])
    field = None if kind is None else kind.params.model_fields.get(address.key)
    if field is None or field.is_required():
        refuse(where, f"{target} has no default", fix="give it a value")
    return [*ops, {"set": target, "to": plain(field.get_default(call_default_factory=True))}]


def _restored(top: Map, ops: Sequence[Op], target: str, packs: Packs, folder: Path) -> list[Op]:
    """Take the edit back that bypassed a node, or one round of it."""
    kept = [op for op in ops if op.get("bypass") != target]
    if len(kept) == len(ops):
        fix = "take `bypass:` out of its text, or undo the edit"
        refuse(edit_place(folder, len(ops) + 1), f"no edit bypassed {target}: its file does", fix=fix)
    patched(top, kept, packs, folder)  # what is left must still be possible
    return kept


def _freed(draft: Draft, names: Any, where: Where) -> list[Op]:
    """Patches that take away optional wires, and outputs, that lead to nodes which are to be removed."""
    listed = [str(name) for name in (names if isinstance(names, list) else [names])]
    whole = Draft(copied(draft.top), draft.packs)
    homes = [taken_apart(whole, name, key=False) for name in listed]
    if len({id(home.top) for home, _ in homes}) != 1:
        return []  # refused where they are removed
    draft, prefix = homes[0][0], listed[0].removesuffix(homes[0][1])
    paths = [draft.address(name, where, key=False).path for _, name in homes]
    ops: list[Op] = []
    for place, _ in draft.users(*paths):
        if place.owner == "outputs":
            ops += [] if prefix else [{"disconnect": place.label}]
        else:
            entry = draft.entries[place.owner]
            kind = None if is_block(entry) or is_part(entry) else draft.kind(entry)
            port = None if kind is None else kind.inputs.get(str(place.key))
            if port is not None and port.optional and place.holder is entry:
                ops.append({"disconnect": f"{prefix}{place.label}"})
    return ops


def _renamed(draft: Draft, old: str, new: Any, where: Where) -> list[Op]:
    """A node of another name as patches: it is added again, what links to it is connected anew, the old one goes."""
    address = draft.address(old, where, key=False)
    entry = draft.entries[address.path]
    if is_block(entry) or is_part(entry):
        what = f"{old} is a {'repeat block' if is_block(entry) else 'sub-graph'}"
        refuse(where, what, fix="rename it in the text of the file")
    name = draft.check_free(new, address.scope, where)
    path = f"{address.scope}.{name}".lstrip(".")
    ops: list[Op] = [{"add": {"name": path, **plain(entry)}}]
    for place, source in draft.users(address.path):
        before, dot, port = place.text.rpartition(".") if source.port else (place.text, "", "")
        head, link, _ = before.rpartition(".")
        text = f"{head}{link}{name}{dot}{port}" if head else f"@{name}{dot}{port}"
        ops.append({"connect": _target_of(draft, place, where), "to": text})
    return [*ops, {"remove": address.path}]


def _target_of(draft: Draft, place: LinkPlace, where: Where) -> str:
    """What a patch calls a place where a link stands."""
    entry = draft.entries.get(place.owner)
    if place.owner == "outputs" or is_block(entry) or place.holder is entry:
        return place.label
    if isinstance(place.holder, list):
        refuse(where, f"{place.label} is a list that links to it", fix="rename it in the text of the file")
    word, number = next((w, n) for layer, w, n in layers_of(entry) if layer is place.holder)  # type: ignore[arg-type]
    if word != "at":
        refuse(where, f"{place.label} links to it in some rounds", fix="rename it in the text of the file")
    scope, _, name = place.owner.rpartition(".")
    return f"{scope}[{number}].{name}.{place.key}"
