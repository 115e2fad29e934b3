"""Finding node packs: every entry point of the group `exmesh.nodes` names a module or a package of modules."""

from __future__ import annotations

import functools
import importlib
import importlib.metadata
import pkgutil
import traceback
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from exmesh_graph.errors import MissingLibraryError
from exmesh_graph.graph.declare.node import REGISTRY, NodeDef

GROUP = "exmesh.nodes"


@dataclass
class Packs:
    """The node types at hand, and the modules that could not be imported: {module: why}."""

    types: dict[str, NodeDef] = field(default_factory=dict)
    broken: dict[str, str] = field(default_factory=dict)


def load_packs() -> Packs:
    """Import all installed node packs. A broken module is noted, so that graphs without it still run."""
    broken: dict[str, str] = {}
    for entry in sorted(importlib.metadata.entry_points(group=GROUP), key=lambda e: (e.value, e.name)):
        for module in _modules(entry.module, broken):
            try:
                importlib.import_module(module)
            except Exception as error:
                broken[module] = _said(error)
    return Packs(dict(sorted(REGISTRY.items())), broken)


@functools.cache
def library_version(name: str) -> str:
    """The version of an installed distribution; MissingLibraryError when there is none."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        raise MissingLibraryError(f"the library {name} is not installed", fix=f"pip install {name}") from None


def _modules(name: str, broken: dict[str, str]) -> Iterator[str]:
    try:
        package = importlib.import_module(name)
    except Exception as error:
        broken[name] = _said(error)
        return
    for info in pkgutil.iter_modules(getattr(package, "__path__", [])):
        if not info.name.startswith("_"):
            yield f"{name}.{info.name}"


def _said(error: Exception) -> str:
    """The error with the last place outside this package and Python's own import machinery."""
    if isinstance(error, SyntaxError):
        return f"{type(error).__name__}: {error}"  # says the place itself
    frames = traceback.extract_tb(error.__traceback__)
    own = str(Path(__file__).parent)
    places = [f for f in frames if not f.filename.startswith((own, "<")) and f.filename != importlib.__file__]
    return f"{type(error).__name__}: {error}" + (f" ({places[-1].filename}:{places[-1].lineno})" if places else "")
