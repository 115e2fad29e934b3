"""The open graph with its edits as a file of its own, for a run: all in one, paths leading to the same files."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from exmesh_graph.api.builder import Graph
from exmesh_graph.api.writing import yaml_text
from exmesh_graph.files import writing
from exmesh_graph.graph.language.yamlfile import Map


def written_copy(top: Map, file: Path, folder: Path) -> Path:
    """Write a merged graph, made from `file`, into `folder`; equal graphs become one file."""
    text = text_of(top, file, folder)
    name = str(top.get("name", file.stem))
    plain = "".join(c if c.isalnum() or c in "-_" else "-" for c in name)[:60]
    path = folder / f"{plain}-{hashlib.sha256(text.encode()).hexdigest()[:12]}.yaml"
    if not path.is_file():
        with writing("the graph of a run", path, "--store"):
            folder.mkdir(parents=True, exist_ok=True)
            draft = path.with_name(f".{path.name}.{os.getpid()}")
            draft.write_text(text, encoding="utf-8")
            os.replace(draft, path)
    return path


def text_of(top: Map, file: Path, folder: Path) -> str:
    """A merged graph as the text of a file in `folder`."""
    tree = top.copy()
    tree.pop("extends", None)  # what it extends is merged in already
    graph = Graph.__new__(Graph)
    graph.graph, graph.tree, graph.file = graph, tree, file
    if "name" not in tree:
        tree.put("name", file.stem, top.where)
    graph._begin()
    return yaml_text(graph, folder)
