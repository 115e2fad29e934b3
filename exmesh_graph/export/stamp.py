"""Where a USD asset comes from, written into its root layers (`customLayerData`): of a published copy, not of a result
in a store, since equal results have equal bytes.
"""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from exmesh_graph.export.packing import write_usdz

KEY = "exmesh_graph"
_HEAD = "#usda 1.0\n(\n"


def stamp_usd(folder: Path, facts: Mapping[str, Any]) -> list[str]:
    """Write `facts` (texts, truth values, mappings of them) into the root layers of an exported asset in `folder`, and
    pack its package anew; the names of the files that were changed.

    Layers are `.usda` with metadata and none of ours yet. `asset_ar.usdz` holds one binary layer and stays as it is.
    """
    data = f"    customLayerData = {{\n{_dictionary(KEY, facts, 8)}    }}\n"
    changed = []
    for path in sorted(folder.glob("*.usda")):
        text = path.read_text(encoding="utf-8")
        if text.startswith(_HEAD) and "customLayerData" not in text.partition("\n)")[0]:
            whole = _HEAD + data + text[len(_HEAD) :]
            _replace(path, lambda draft, whole=whole: draft.write_text(whole, encoding="utf-8"))
            changed.append(path.name)
    for path in sorted(folder.glob("*.usdz")):
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
        members = [(name, folder / name) for name in names]
        if set(names) & set(changed) and all(file.is_file() for _, file in members):
            _replace(path, lambda draft, members=members: write_usdz(draft, members))
            changed.append(path.name)
    return changed


def _dictionary(name: str, facts: Mapping[str, Any], indent: int) -> str:
    """A dictionary as `.usda` files write it, keys in the order of the alphabet."""
    lines = []
    for key, value in sorted(facts.items()):
        if isinstance(value, Mapping):
            lines.append(_dictionary(key, value, indent + 4))
        elif isinstance(value, bool):
            lines.append(f'{" " * (indent + 4)}bool "{key}" = {int(value)}\n')
        else:
            lines.append(f'{" " * (indent + 4)}string "{key}" = {json.dumps(str(value), ensure_ascii=False)}\n')
    return f'{" " * indent}dictionary "{name}" = {{\n{"".join(lines)}{" " * indent}}}\n'


def _replace(path: Path, write: Any) -> None:
    draft = path.with_name(f".{path.name}.draft")
    write(draft)
    os.replace(draft, path)
