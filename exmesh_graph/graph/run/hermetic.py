"""What nodes share because they share a process: set before each, and put back after it.

A warm worker runs many nodes. Without this a node that sets an environment variable, a seed, torch's default type or
the working folder would change what later nodes compute, and their keys would not know. Warnings filters: `execute`.
"""

from __future__ import annotations

import contextlib
import decimal
import importlib
import importlib.machinery
import locale
import os
import random
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from typing import Any

ALONE = threading.RLock()  # one node at a time in a process, also of runs in several of its threads
_ERRORS = {"divide": "warn", "over": "warn", "under": "ignore", "invalid": "warn"}
_STATES: tuple[tuple[str, str, str, Any], ...] = (  # (module, getter, setter, value where a node imported the module)
    ("sys", "getrecursionlimit", "setrecursionlimit", None),
    ("numpy", "geterr", "seterr", _ERRORS),
    ("numpy", "geterrcall", "seterrcall", None),
    ("numpy", "get_printoptions", "set_printoptions", None),
    ("torch", "get_default_dtype", "set_default_dtype", "float32"),
    ("torch", "get_default_device", "set_default_device", "cpu"),
    ("torch", "get_num_threads", "set_num_threads", None),
    ("torch", "is_grad_enabled", "set_grad_enabled", True),
    ("torch", "get_float32_matmul_precision", "set_float32_matmul_precision", "highest"),
    ("torch", "are_deterministic_algorithms_enabled", "use_deterministic_algorithms", False),
)


@contextlib.contextmanager
def apart(seed: int) -> Iterator[None]:
    """Python's, numpy's and torch's (CPU) global generators start from `seed`.

    They, the environment, the working folder, the locale, the standard streams, the decimal context and what is in
    `_STATES` are afterwards what they were.
    """
    environment, words, streams = dict(os.environ), locale.setlocale(locale.LC_ALL), (sys.stdout, sys.stderr)
    try:
        folder = os.getcwd()
    except OSError:  # it is gone: nothing to come back to
        folder = ""
    states = drawn()
    before = {(m, get): getattr(sys.modules[m], get)() for m, get, _, _ in _STATES if m in sys.modules}
    random.seed(seed)
    for module in filter(None, map(sys.modules.get, ("numpy", "torch"))):  # not imported for this alone
        _seed(module, seed)
    seeding = _Seeding(seed)
    sys.meta_path.insert(0, seeding)
    try:
        with decimal.localcontext():
            yield
    finally:
        if seeding in sys.meta_path:
            sys.meta_path.remove(seeding)
        sys.stdout, sys.stderr = streams
        if dict(os.environ) != environment:
            os.environ.clear()
            os.environ.update(environment)
            time.tzset()
        with contextlib.suppress(OSError):  # gone meanwhile
            os.chdir(folder)
        locale.setlocale(locale.LC_ALL, words)
        draw_on(states)
        for name, get, put, fresh in _STATES:
            if name in sys.modules and ((name, get) in before or fresh is not None):
                _put_back(sys.modules[name], get, put, before.get((name, get), fresh))


class _Seeding:
    """Seeds numpy and torch also where a node is the first in its process to import them."""

    def __init__(self, seed: int) -> None:
        self.seed = seed

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> Any:
        spec = importlib.machinery.PathFinder.find_spec(name, path) if name in ("numpy", "torch") else None
        if spec is not None and spec.loader is not None:
            load = spec.loader.exec_module
            setattr(spec.loader, "exec_module", lambda module: (load(module), _seed(module, self.seed)))  # noqa: B010
        return spec


def _seed(module: Any, seed: int) -> Any:
    return module.manual_seed(seed) if module.__name__ == "torch" else module.random.seed(seed % 2**32)


def _put_back(module: Any, get: str, put: str, value: Any) -> None:
    """Undo what a node set; where it also imported the module, the value is the one that modules begin with."""
    value = getattr(module, "float32", None) if value == "float32" else value
    if str(getattr(module, get)()) != str(value):
        setter = getattr(module, put)
        setter(**value) if isinstance(value, dict) else setter(value)


def drawn() -> dict[str, Any]:
    """How far the global generators of what is imported have been drawn from: what `draw_on` takes."""
    numpy, torch = sys.modules.get("numpy"), sys.modules.get("torch")
    states = {"python": random.getstate(), "numpy": numpy and numpy.random.get_state()}
    return states | {"torch": torch and torch.get_rng_state()}


def draw_on(states: Mapping[str, Any]) -> None:
    """Go on from there."""
    random.setstate(states["python"])
    if states["numpy"]:
        importlib.import_module("numpy").random.set_state(states["numpy"])
    if states["torch"] is not None:
        importlib.import_module("torch").set_rng_state(states["torch"])
