"""The state of a long computation as files: nested dicts, lists and tuples of arrays, tensors and plain values.

Arrays and tensors go to one safetensors file, bit for bit; the rest to a JSON-like tree. No pickle.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exmesh_graph.errors import GraphError
from exmesh_graph.types.artifact import load_arrays, save_arrays

if TYPE_CHECKING:
    import numpy as np

_AS_BITS = {"bfloat16": "int16", "float8_e4m3fn": "uint8", "float8_e5m2": "uint8"}


def save_state(folder: Path, state: Mapping[str, Any]) -> None:
    """Write `state` into `folder`. Values: numpy arrays, torch tensors (kept by value, on the CPU), numbers, strings,
    None, and dicts (str or int keys), lists and tuples of these. Raises GraphError for anything else.
    """
    arrays: dict[str, np.ndarray] = {}
    tree = _packed(state, arrays, "state")
    save_arrays(folder, arrays, {"tree": tree})


def load_state(folder: Path) -> dict[str, Any]:
    """Read what `save_state` wrote; tensors come back on the CPU without gradient."""
    arrays, meta = load_arrays(folder)
    return dict(_unpacked(meta["tree"], arrays))


def _packed(value: Any, arrays: dict[str, np.ndarray], where: str) -> Any:
    if value is None or type(value) in (bool, str, int):  # not what derives from them
        return value
    if type(value) is float:
        return float(value) if math.isfinite(value) else {"float": str(float(value))}
    if isinstance(value, Mapping):
        if not all(type(key) in (str, int) for key in value):
            raise GraphError(f"a checkpoint's {where} has keys other than str and int")
        return {"dict": [[key, _packed(item, arrays, f"{where}[{key!r}]")] for key, item in value.items()]}
    if isinstance(value, list | tuple):
        items = [_packed(item, arrays, f"{where}[{index}]") for index, item in enumerate(value)]
        return items if isinstance(value, list) else {"tuple": items}
    name = f"{len(arrays):06d}"
    torch, numpy = sys.modules.get("torch"), sys.modules.get("numpy")
    if torch is not None and isinstance(value, torch.Tensor) and not value.is_complex():
        kind = str(value.dtype).removeprefix("torch.")
        tensor = value.detach().cpu().contiguous()
        flat = tensor.reshape(-1)
        arrays[name] = (flat.view(getattr(torch, _AS_BITS[kind])) if kind in _AS_BITS else flat).numpy()
        return {"tensor": name, "dtype": kind, "shape": list(tensor.shape)}
    is_plain = numpy is not None and (type(value) is numpy.ndarray or isinstance(value, numpy.generic))
    if numpy is not None and is_plain and value.dtype.kind in "biuf":
        array = numpy.asarray(value)
        order = "F" if array.flags.f_contiguous and not array.flags.c_contiguous else "C"  # sums are taken in it
        arrays[name] = array.astype(array.dtype.newbyteorder("="), copy=False).reshape(-1, order=order)
        return {"array": name, "shape": list(array.shape), "scalar": isinstance(value, numpy.generic), "order": order}
    kind = f"{type(value).__name__} of {value.dtype}" if hasattr(value, "dtype") else type(value).__name__
    raise GraphError(
        f"a checkpoint cannot hold a {kind}, as its {where} does",
        expected="real arrays, tensors, numbers, strings, None, and dicts and lists of them",
    )


def _unpacked(value: Any, arrays: dict[str, Any]) -> Any:
    if isinstance(value, list):
        return [_unpacked(item, arrays) for item in value]
    if not isinstance(value, dict):
        return value
    if "dict" in value:
        return {key: _unpacked(item, arrays) for key, item in value["dict"]}
    if "tuple" in value:
        return tuple(_unpacked(item, arrays) for item in value["tuple"])
    if "float" in value:
        return float(value["float"])
    if "array" in value:
        array = arrays[value["array"]].reshape(value["shape"], order=value.get("order", "C"))
        return array[()] if value["scalar"] else array
    import torch

    flat = torch.from_numpy(arrays[value["tensor"]])
    kind = value["dtype"]
    return (flat.view(getattr(torch, kind)) if kind in _AS_BITS else flat).reshape(value["shape"])
