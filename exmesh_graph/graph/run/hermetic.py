"""What nodes share because they share a process: set before each, and put back after it.

A warm worker runs many nodes. Without this a node that sets an environment variable, a seed, torch's default type or
the working folder would change what later nodes compute, and their keys would not know.
"""

from __future__ import annotations

import contextlib
import locale
import os
import random
import sys
from collections.abc import Iterator
from typing import Any


@contextlib.contextmanager
def apart(seed: int) -> Iterator[None]:
    """Python's, numpy's and torch's (CPU) global generators start from `seed`.

    They, the environment, the working folder, the locale, torch's default type and numpy's treatment of errors are
    afterwards what they were.
    """
    environment, words = dict(os.environ), locale.setlocale(locale.LC_ALL)
    try:
        folder = os.getcwd()
    except OSError:  # it is gone: nothing to come back to
        folder = ""
    drawn = random.getstate()
    random.seed(seed)
    numpy: Any = sys.modules.get("numpy")  # not imported for this alone
    torch: Any = sys.modules.get("torch")
    if numpy is not None:
        numpys, errors = numpy.random.get_state(), numpy.geterr()
        numpy.random.seed(seed % 2**32)
    if torch is not None:
        torchs, dtype = torch.get_rng_state(), torch.get_default_dtype()
        torch.manual_seed(seed)
    try:
        yield
    finally:
        if dict(os.environ) != environment:
            os.environ.clear()
            os.environ.update(environment)
        with contextlib.suppress(OSError):  # gone meanwhile
            os.chdir(folder)
        locale.setlocale(locale.LC_ALL, words)
        random.setstate(drawn)
        if numpy is not None:
            numpy.random.set_state(numpys)
            numpy.seterr(**errors)
        if torch is not None:
            torch.set_rng_state(torchs)
            torch.set_default_dtype(dtype)
        elif (torch := sys.modules.get("torch")) is not None:
            torch.set_default_dtype(torch.float32)
