"""Edits as text: the patch, the file with the edits in it, a variant of the file, a child that extends it.

A file says only what differs from those that it extends, so a change of an inherited node becomes an entry over it;
what cannot be said that way (another type, a key taken away) writes the whole entry. Every text is parsed and merged
again and must mean what the edited graph means, else it is refused.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePath
from typing import Any

from exmesh_graph.errors import GraphError
from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.declare.ports import signature_of
from exmesh_graph.graph.language.extends import over_base
from exmesh_graph.graph.language.yamlfile import Map, parse_yaml
from exmesh_graph.graph.problems import Problems
from exmesh_graph.studio.edits import Op
from exmesh_graph.studio.renaming import check_rows, with_name
from exmesh_graph.studio.textedit import one_line, renamed, with_block, with_value, without
from exmesh_graph.studio.values import EDIT, plain

GONE = object()
_ENTRY = ("type", "repeat", "graph")  # keys that make an entry one of its own
_VARIANT = "elsewhere: save the edits as a variant, or change the text by hand"


def ops_text(ops: Sequence[Op]) -> str:
    """Patches as a graph file would hold them, one a line."""
    return "".join(f"- {one_line(dict(op))}\n" for op in ops)


def edited_text(text: str, file: Path, before: Map, after: Map, packs: Packs) -> str:
    """The text of `file` with the edits that lead from the merged graph `before` to `after` in it.

    Raises GraphError where the file cannot say it.
    """
    own = _own(text, file)
    base = _base(own, file)
    result, todo = text, list(changes(before, after))
    for path, value in todo:
        if path[-1] == "graph" and isinstance(value, Mapping):
            raise GraphError(f"nodes were added, removed or swapped inside the sub-graph {path[-2]}", fix=_VARIANT)
    renames = list(_renames(todo, before, own, base))
    for old, new in renames:
        result = with_name(renamed(result, old, new[-1]), old, new[-1])
        todo = [(path, value) for path, value in todo if path not in (old, new)]
    if renames:
        check_rows(before, _merged(result, file), packs)
    for path, value in todo:
        result = _said(result, _own(result, file), base, after, path, value, file, packs)
    try:
        meant = _merged(result, file)
    except GraphError as error:
        raise GraphError(f"the edits cannot be written into {file.name}: {error.what}", fix=_VARIANT) from error
    odd = next((one for one in changes(after, meant) if not _says_nothing(one, after, packs)), None)
    if odd is not None:
        place = ".".join(map(str, odd[0]))
        raise GraphError(f"{file.name} cannot say what {place} becomes", fix=_VARIANT)
    return result


def variant_text(text: str, file: Path, name: str, ops: Sequence[Op], doc: str = "") -> str:
    """The text of `file` with a variant of these patches, in the place of one that it has already."""
    if doc:
        result = with_value(text, ("variants", name), {"doc": doc, "patches": [dict(op) for op in ops]})
    else:
        result = with_block(text, ("variants", name), [one_line(dict(op)) for op in ops])
    told = _own(result, file).get("variants")
    entry = told.get(name) if isinstance(told, Map) else None
    patches = entry.get("patches") if isinstance(entry, Map) else entry
    if plain(patches) != plain(list(ops)):
        raise GraphError(f"the variant {name} cannot be written into {file.name}", fix="change the text by hand")
    return result


def child_text(file: Path, name: str, before: Map, after: Map, child: Path, packs: Packs) -> str:
    """The text of a new file beside `file` that extends it and has the edits in it."""
    text = f"extends: {one_line(file.name)}\nname: {one_line(name)}\n"
    named = before.copy()
    named.put("name", name, before.where)
    meant = after.copy()
    meant.put("name", name, after.where)
    return edited_text(text, child, named, meant, packs)


def difference(before: str, after: str, name: str) -> str:
    """A unified diff."""
    old, new = before.splitlines(keepends=True), after.splitlines(keepends=True)
    return "".join(difflib.unified_diff(old, new, f"a/{name}", f"b/{name}", n=2))


def changes(before: Any, after: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """(path of keys, new value or GONE) of all that differs between two merged files."""
    for key in dict.fromkeys([*before, *after]):
        here = (*path, key)
        if len(here) == 1 and key in ("extends", "variants", "matrix", "repeats"):
            continue
        if key not in after:
            yield here, GONE
        elif key not in before:
            yield here, plain(after[key])
        elif isinstance(before[key], Map) and isinstance(after[key], Map):
            yield from changes(before[key], after[key], here)
        elif plain(before[key]) != plain(after[key]):
            yield here, plain(after[key])


def _said(
    text: str, own: Map, base: Map, after: Map, path: tuple[Any, ...], value: Any, file: Path, packs: Packs
) -> str:
    """The text with one change in it."""
    if path[0] == "params":
        return _parameter(text, own, base, path, value)
    entry = _entry_of(path, after)
    if path[0] == "nodes" and entry is not None:
        inherited, present = _at(base, entry), _at(after, entry)
        if value is GONE and inherited is not None and _says_nothing((path, None), after, packs):
            return with_value(text, path, None)
        if value is GONE and len(path) == len(entry):
            return with_value(text, entry, None) if inherited is not None else without(text, entry)
        if inherited is not None and isinstance(present, Map) and (value is GONE or path[len(entry)] in _ENTRY):
            _check_paths(present, entry, file, packs)
            return with_value(text, entry, plain(present))
    if value is GONE:
        return without(text, path) if _at(base, path) is None else with_value(text, path, None)  # of outputs
    return with_value(text, path, value)


def _says_nothing(change: tuple[tuple[Any, ...], Any], after: Map, packs: Packs) -> bool:
    """Whether a change is a null at an optional input or output, which means the same as nothing."""
    path, value = change
    if value is not None:
        return False
    if path[0] == "outputs":
        return True
    entry = _entry_of(path, after)
    holder = None if entry is None else _at(after, entry)
    if not isinstance(holder, Map) or entry is None or len(path) != len(entry) + 1:
        return False
    kind = signature_of(packs, holder.get("type"))
    return kind is not None and path[-1] in kind.inputs and kind.inputs[path[-1]].optional


def _renames(
    todo: Sequence[tuple[tuple[Any, ...], Any]], before: Map, own: Map, base: Map
) -> Iterator[tuple[tuple[Any, ...], tuple[Any, ...]]]:
    """(old path, new path) of nodes of this very file that are gone and stand there again under another name."""
    added = {path: value for path, value in todo if value is not GONE and len(path) > 1 and path[-2] == "nodes"}
    for path, value in todo:
        if value is GONE and len(path) > 1 and path[-2] == "nodes" and _at(base, path) is None:
            was = plain(_at(before, path))
            new = next((other for other in added if other[:-1] == path[:-1] and added[other] == was), None)
            if new is not None and _at(own, path) is not None:
                yield path, new


def _parameter(text: str, own: Map, base: Map, path: tuple[Any, ...], value: Any) -> str:
    """A changed graph parameter: a declaration in this file changes, one of another file gets a value over it."""
    mine = _at(own, path[:2])
    if len(path) > 2 and not isinstance(mine, Map):
        if path[2] != "default":
            return text  # what choices say is forgotten when the file gives a value itself
        return with_value(text, path[:2], value)
    if value is GONE:
        return without(text, path) if _at(own, path) is not None else text
    return with_value(text, path, value)


def _entry_of(path: tuple[Any, ...], after: Map) -> tuple[Any, ...] | None:
    """The path of the innermost node that a path leads into: of `nodes x nodes y key` that of y."""
    if len(path) < 2 or path[0] != "nodes":
        return None
    length = 2
    while len(path) >= length + 2 and path[length] == "nodes":
        length += 2
    return path[:length]


def _check_paths(entry: Map, path: tuple[Any, ...], file: Path, packs: Packs) -> None:
    """Refuse to copy an entry whose relative paths start from another folder."""
    kind = signature_of(packs, entry.get("type"))
    for name in kind.path_fields if kind is not None else ():
        value, where = entry.get(name), entry.lines.get(name)
        far = where is not None and where.file is not None and where.file.name != EDIT and (
            where.file.parent.resolve() != file.parent.resolve()
        )  # fmt: skip
        if far and isinstance(value, str) and not PurePath(value).is_absolute() and "${" not in value:
            raise GraphError(f"{'.'.join(map(str, path))} has a path that starts from another folder: {value}",
                             fix="give it an absolute path, or " + _VARIANT)  # fmt: skip


def _own(text: str, file: Path) -> Map:
    value = parse_yaml(text, file)
    if not isinstance(value, Map):
        raise GraphError(f"{file.name} is no mapping", fix="change the text by hand")
    return value


def _base(own: Map, file: Path) -> Map:
    if "extends" not in own:
        return Map(own.where)
    only, problems = Map(own.where), Problems()
    only.put("extends", own["extends"], own.lines["extends"])
    merged = over_base(only, file, problems)
    problems.raise_if_any()
    return merged


def _merged(text: str, file: Path) -> Map:
    problems = Problems()
    merged = over_base(_own(text, file), file, problems)
    problems.raise_if_any()
    return merged


def _at(tree: Any, path: Sequence[Any]) -> Any:
    for key in path:
        if not isinstance(tree, Mapping) or key not in tree:
            return None
        tree = tree[key]
    return tree
