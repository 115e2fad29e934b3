"""`set` and `connect` on sub-graphs: their parameters and inputs, and single nodes inside them.

What a patch says of a node inside goes into the `nodes:` of the entry that uses the file, so that the file itself and
its other uses stay as they are. The other operations act on the graph that holds the node: put variants of a sub-graph
into a file that extends it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from exmesh_graph.graph.language.extends import load_merged, merge_nodes
from exmesh_graph.graph.language.yamlfile import Map
from exmesh_graph.graph.problems import GraphErrors, Problems, Where, nearest
from exmesh_graph.graph.variants.draft import Draft, Names, clone, is_block, is_part, layers_of, refuse


def part_in(draft: Draft, target: Any) -> tuple[Names, str] | None:
    """(path of a sub-graph, what is named inside it) of `stage1.rounds.refine.iterations`, or None."""
    parts = target.split(".") if isinstance(target, str) else []
    paths = set(draft.paths())
    for length in range(1, len(parts)):
        path = tuple(part.partition("[")[0] for part in parts[:length])
        if path in paths and is_part(draft.entry(path)):
            return path, ".".join(parts[length:])
    return None


def put_inside(draft: Draft, path: Names, target: str, value: Any, where: Where, there: Where, *, link: bool) -> None:
    """Set a parameter, or connect an input (`link`), of a sub-graph or of a node inside it."""
    entry, shown = draft.entry(path), ".".join(path)
    part = _file_of(draft, entry)
    if part is None:
        return  # `check` says why the file cannot be read
    if "." not in target:
        known = part.get("inputs" if link else "params") or Map(where)
        if target not in known and (link or target != "seed"):
            near = [f"{shown}.{name}" for name in nearest(target, known) or list(known)]
            kind = "input" if link else "parameter"
            refuse(where, f"the sub-graph {shown} has no {kind} {target!r}", near=near)
        entry.put(target, clone(value), there)
        return
    inner = Draft(part, draft.packs)
    address = inner.address(target, where, key=True)
    found = inner.entry(address.path)
    if is_part(found):
        refuse(where, f"{shown}.{target} lies in a sub-graph of a sub-graph", fix="patch the file that uses it")
    kinds = inner.kinds(found)
    names = [name for kind in kinds for name in (kind.inputs if link else kind.params.model_fields)]
    if is_block(found):
        names = [] if link else ["repeat"]
    elif not link:
        names.append("seed")
    if (kinds or is_block(found)) and address.key not in names:
        near = [f"{shown}.{'.'.join(address.path)}.{name}" for name in nearest(address.key, names) or names[:5]]
        refuse(
            where,
            f"{shown}.{'.'.join(address.path)} has no {address.key!r} to {'connect' if link else 'set'}",
            near=near,
        )
    patch = _patch_of(entry, address.path, there)
    if address.round is not None:
        _step(_step(patch, "at", there), address.round, there).put(address.key, clone(value), there)
        return
    patch.put(address.key, clone(value), there)
    for layer, title in layers_of(found):
        if address.key in layer:  # in every round, whatever single rounds had
            word, number = title.split()
            _step(_step(patch, word, there), int(number), there).put(address.key, clone(value), there)


def _file_of(draft: Draft, entry: Map) -> Map | None:
    """The merged file of a sub-graph with the patches of its use; None where it cannot be read."""
    name = draft.read(entry, "graph")
    path = Path(name).expanduser() if isinstance(name, str) else Path()
    path = path if path.is_absolute() else entry.lines["graph"].base / path
    try:
        part = load_merged(path.resolve(), Problems()).copy()
    except GraphErrors:
        return None
    if isinstance(part.get("nodes"), Map) and isinstance(entry.get("nodes"), Map):
        part["nodes"] = merge_nodes(part["nodes"], entry["nodes"], Problems())
    return part


def _patch_of(entry: Map, path: Names, where: Where) -> Map:
    """The patch of a node inside a sub-graph, made where there is none."""
    patch = entry
    for name in path:
        patch = _step(_step(patch, "nodes", where), name, where)
    return patch


def _step(holder: Map, key: Any, where: Where) -> Map:
    if not isinstance(holder.get(key), Map):
        holder.put(key, Map(where), where)
    found: Map = holder[key]
    return found
