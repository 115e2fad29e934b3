"""The eight operations on a merged graph file. Each is refused, with place and fix, where its precondition fails.

    {set: pbr.chroma_weight, to: 0}               a parameter of a node or of the graph, `seed`, `rounds.repeat`
    {replace: rounds.uv, type: uv.regenerate}   another type; ports: {old: new} where names differ; more parameters
    {insert: {name: n, type: t}, on: pbr.carrier} a new node on the wire into a port, or behind "@settle.state"
    {bypass: rounds.merge}                        what used its output gets its input; via: the input's name
    {remove: usd}                                 a node or block, or a list, that nothing links to
    {add: {name: rounds.look, type: t, ...}}      a new node, in the block that its name begins with
    {connect: pbr.transport, to: "@light.transport"}
    {disconnect: pbr.transport}                   an optional input, or a published output

Without a round an operation holds in every round, as `--set` does; `rounds[3].merge.views` is round 3 alone (`set`,
`connect`, `replace`, `insert`, `bypass`). `p.refine` lies in the sub-graph `p`, which is a node itself for these.
Repeated, `set`, `connect` and `replace` (without ports) change nothing more; the other five are refused the second
time. Operations on different nodes commute unless one makes, removes or rewires what the other needs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.language.yamlfile import Map, copied
from exmesh_graph.graph.problems import Where, closest
from exmesh_graph.graph.variants.draft import Draft, refuse
from exmesh_graph.graph.variants.rewire import add, bypass, insert, remove, replace
from exmesh_graph.graph.variants.values import connect, disconnect, set_values


def apply_patches(top: Map, patches: Iterable[Any], packs: Packs) -> Map:
    """The merged file after `patches`, in order; `top` stays as it is. Raises GraphErrors at the first refusal."""
    draft = Draft(copied(top), packs)
    for patch in patches:
        name = operation_of(patch)
        _, keys = OPERATIONS[name]
        extra = [key for key in patch if key != name and keys is not None and key not in keys]
        if extra:
            refuse(patch.lines[extra[0]], f"{name} has no {extra[0]!r}", near=closest(extra[0], keys or ()))
        needed, expected = NEEDED.get(name, (name, ""))
        instead = (name == "set" and isinstance(patch[name], Map)) or (name == "replace" and "graph" in patch)
        if needed not in patch and not instead:
            refuse(patch.where, f"{name} needs {needed}:", expected=f"{needed}: {expected}")
        OPERATIONS[name][0](draft, patch)
    return draft.top


def operation_of(patch: Any, place: Where | None = None) -> str:
    """The operation that a patch names; `place` is where its list stands. Raises GraphErrors for anything else."""
    shown = "{set: node.parameter, to: value}, {bypass: node}, ..."
    if not isinstance(patch, Map):
        refuse(place or Where(None), f"a patch is a mapping, not {patch!r}", expected=shown)
    named = [key for key in patch if key in OPERATIONS]
    if len(named) != 1:
        what = f"two operations in one patch: {', '.join(named)}" if named else f"no operation in {dict(patch)!r}"
        refuse(patch.where, what, near=() if named else closest(next(iter(patch), ""), OPERATIONS), expected=shown)
    return str(named[0])


OPERATIONS: Mapping[str, tuple[Callable[[Draft, Map], None], tuple[str, ...] | None]] = {
    "set": (set_values, ("to",)),
    "replace": (replace, None),
    "insert": (insert, ("on", "in", "out")),
    "bypass": (bypass, ("via",)),
    "remove": (remove, ()),
    "add": (add, ()),
    "connect": (connect, ("to",)),
    "disconnect": (disconnect, ()),
}
"""name -> (operation, the keys it takes beside its own; None: parameters of a node)"""

NEEDED = {
    "set": ("to", "a value"),
    "replace": ("type", "a node type, or graph: a file"),
    "insert": ("on", 'a port "pbr.carrier" or a link "@settle.state"'),
    "connect": ("to", 'a link "@node.port"'),
}
"""name -> (a key that the operation cannot do without, what stands there)"""
