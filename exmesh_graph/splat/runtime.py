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


@cache
def kernels(of: Literal["project", "blend", "adam", "camera", "harmonics"], dtype: torch.dtype) -> Any:
    """kernels_<of>.py for float32 or float64 (the latter for tests): one file, loaded under two names."""
    wp = warp()
    real = {torch.float32: wp.float32, torch.float64: wp.float64}[dtype]
    file = f"kernels_{of}"
    name = f"{__package__}.{file}_{real.__name__}"
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{file}.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    module.REAL = real  # type: ignore[attr-defined]
    for used in _USES.get(of, ()):
        setattr(module, used.upper(), kernels(used, dtype))  # type: ignore[arg-type]
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module
