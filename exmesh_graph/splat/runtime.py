"""Loading this room's kernels for a float type."""

from __future__ import annotations

import importlib.util
import sys
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import torch

from exmesh_graph.gpu.warp_runtime import warp

if TYPE_CHECKING:  # the files are loaded by a computed name: these lines tell the code fingerprints of nodes
    from exmesh_graph.splat import (  # noqa: F401
        kernels_adam,
        kernels_blend,
        kernels_camera,
        kernels_harmonics,
        kernels_project,
    )

_USES = {"project": ("camera", "harmonics")}
"""Files whose functions a file of kernels calls."""

_NUMBERS = {"ZERO": 0.0, "HALF": 0.5, "ONE": 1.0, "TWO": 2.0, "LEAST": 1.0 / 255.0}
"""Constants that several files name; LEAST is the least opacity that is drawn."""


@cache
def kernels(of: Literal["project", "blend", "adam", "camera", "harmonics"], dtype: torch.dtype) -> Any:
    """kernels_<of>.py for float32 or float64 (the latter for tests): one file, loaded under two names."""
    wp = warp()
    real = {torch.float32: wp.float32, torch.float64: wp.float64}[dtype]
    file = f"kernels_{of}"
    name = f"{__package__}.{file}_{real.__name__}"
    # not in the key: the files are named in code=
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{file}.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    names = {"REAL": real, **{f"Vec{n}": wp.types.vector(n, real) for n in (2, 3, 4, 8, 16)}}
    names |= {"Mat23": wp.types.matrix((2, 3), real), "Mat33": wp.types.matrix((3, 3), real)}
    names |= {name: wp.constant(real(value)) for name, value in _NUMBERS.items()}
    for used in _USES.get(of, ()):
        functions = vars(kernels(used, dtype)).items()  # type: ignore[arg-type]
        names |= {name: function for name, function in functions if isinstance(function, wp.Function)}
    vars(module).update(names)
    sys.modules[name] = module  # not in the key: code=
    spec.loader.exec_module(module)  # not in the key: code=
    return module
