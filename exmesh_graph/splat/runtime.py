"""Loading this room's kernels for a float type."""

from __future__ import annotations

import importlib.util
import sys
from functools import cache
from pathlib import Path
from typing import Any, Literal

import torch

from exmesh_graph.raster.warp_runtime import warp


@cache
def kernels(of: Literal["splats", "blend"], dtype: torch.dtype) -> Any:
    """The module of Warp kernels for float32 or float64 (the latter for tests): one file, loaded under two names."""
    wp = warp()
    file = "kernels" if of == "splats" else "kernels_blend"
    real = {torch.float32: wp.float32, torch.float64: wp.float64}[dtype]
    name = f"{__package__}.{file}_{real.__name__}"
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{file}.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    module.REAL = real  # type: ignore[attr-defined]
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module
