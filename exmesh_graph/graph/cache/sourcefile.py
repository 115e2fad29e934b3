"""Source files of modules, and what of them this process has loaded: an edit must not pass for what runs."""

from __future__ import annotations

import ast
import contextlib
import importlib.util
import marshal
import os
import struct
import sys
from importlib.util import MAGIC_NUMBER
from pathlib import Path
from typing import Any

from exmesh_graph.graph.cache.moduletext import ModuleText
from exmesh_graph.graph.cache.syntax import normalised


def source_file(name: str) -> Path | None:
    top, _, rest = name.partition(".")
    roots: list[str] = []
    if top in sys.modules:
        loaded = sys.modules[top]
        file, roots = getattr(loaded, "__file__", None), list(getattr(loaded, "__path__", []))
    else:
        try:
            spec = importlib.util.find_spec(top)
        except (ImportError, ValueError):
            spec = None
        file = spec.origin if spec else None
        roots = list(spec.submodule_search_locations or []) if spec else []
    if not rest:
        return Path(file) if file and file.endswith(".py") else None
    for root in roots:
        base = os.path.join(root, *rest.split("."))
        for path in (os.path.join(base, "__init__.py"), base + ".py"):
            if os.path.isfile(path):
                return Path(path)
    return None


def spec_of(name: str) -> Any:
    """Stands for one loading of a module: another one after a reload; None where it is not loaded."""
    return getattr(sys.modules.get(name), "__spec__", None)


def stamp_of(path: Path) -> tuple[int, ...] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_ctime_ns, status.st_ino, status.st_size


def is_edited(module: ModuleText) -> bool:
    if module.stale:
        return True
    if module.stamp == stamp_of(module.path):
        return False
    try:
        data = module.path.read_bytes()
    except OSError:
        return True
    return data != module.data and text_of(data) != text_of(module.data)


def drop_stale_bytecode(path: Path, data: bytes) -> bool:
    """Whether Python took, or would take, bytecode of other source for this file, which is removed.

    Python goes by size and whole seconds: a second edit within a second, or one that keeps the time, escapes it.
    """
    with contextlib.suppress(OSError, ValueError, EOFError, TypeError, SyntaxError):
        cache, status = Path(importlib.util.cache_from_source(str(path))), path.stat()
        if cache.stat().st_mtime_ns > status.st_ctime_ns:
            return False
        held = cache.read_bytes()
        taken = struct.pack("<4sLLL", MAGIC_NUMBER, 0, int(status.st_mtime) & 0xFFFFFFFF, len(data) & 0xFFFFFFFF)
        if held[:16] == taken and marshal.loads(held[16:]) != compile(data, str(path), "exec", dont_inherit=True):
            cache.unlink()
            return True
    return False


def bytecode_is_older(path: Path) -> bool:
    """Whether the bytecode that Python wrote when it loaded a module is of an earlier text than the file's.

    Where Python writes none (PYTHONDONTWRITEBYTECODE), what lies there is of an earlier process and says nothing.
    """
    with contextlib.suppress(OSError, NotImplementedError):
        cache, status = Path(importlib.util.cache_from_source(str(path))), path.stat()
        head = cache.read_bytes()[:16]
        written = not sys.dont_write_bytecode and os.access(cache.parent, os.W_OK)
        if written and len(head) == 16 and head[4:8] == bytes(4):
            return head[8:] != struct.pack("<LL", int(status.st_mtime) & 0xFFFFFFFF, status.st_size & 0xFFFFFFFF)
    return False


def text_of(data: bytes) -> str:
    try:
        return normalised(ast.parse(data))
    except SyntaxError:
        return repr(data)
