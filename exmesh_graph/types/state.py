"""The state of a long computation as files: nested dicts, lists and tuples of arrays, tensors and plain values.

Arrays and tensors go to one safetensors file, bit for bit; the rest to a JSON-like tree. No pickle. How arrays lie in
memory is kept, since sums are taken in that order, and so is which of them share it: a view stays a view.
"""

from __future__ import annotations

import math
import sys
import warnings
from collections import Counter, OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exmesh_graph.errors import GraphError
from exmesh_graph.types.artifact import load_arrays, save_arrays

if TYPE_CHECKING:
    import numpy as np

_AS_BITS = {"bfloat16": "int16", "float8_e4m3fn": "uint8", "float8_e5m2": "uint8"}
_KINDS: dict[str, Any] = {"dict": dict, "OrderedDict": OrderedDict, "Counter": Counter}


def save_state(folder: Path, state: Mapping[str, Any], beside: Mapping[str, Any] | None = None) -> None:
    """Write `state` into `folder`. Values: numpy arrays, torch tensors (kept by value, on the CPU), numbers, strings,
    None, and dicts (str or int keys; also OrderedDict and Counter), lists and tuples of these. Raises GraphError for
    anything else, also for what derives from these, since it would come back without its own ways; warns of a tensor
    that has a gradient, which is not kept. `beside` is a second state in the same files.
    """
    packer = _Packer()
    trees = [packer.packed(state, "state"), packer.packed(beside or {}, "state")]
    packer.share()
    save_arrays(folder, packer.arrays, {"trees": trees})


def load_state(folder: Path) -> dict[str, Any]:
    """Read what `save_state` wrote; tensors come back on the CPU without gradient."""
    return load_states(folder)[0]


def load_states(folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """The state and the one beside it."""
    arrays, meta = load_arrays(folder)
    unpacker = _Unpacker(arrays)
    state, beside = map(unpacker.unpacked, meta["trees"])
    return state, beside


class _Packer:
    """What has been packed so far. `seen`: the number of each list, dict, array and tensor, by identity."""

    def __init__(self) -> None:
        self.arrays: dict[str, np.ndarray] = {}
        self.seen: dict[int, tuple[int, Any]] = {}
        self.placed: list[
            tuple[tuple[str, int], list[int], dict[str, Any]]
        ] = []  # (device and first byte, extent, note)

    def packed(self, value: Any, where: str) -> Any:
        if value is None or type(value) in (bool, str, int):  # not what derives from them
            return value
        if type(value) is float:
            return float(value) if math.isfinite(value) else {"float": str(float(value))}
        if type(value) is tuple or (hasattr(value, "numel") and isinstance(value, tuple)):  # torch.Size
            return {"tuple": [self.packed(item, f"{where}[{index}]") for index, item in enumerate(value)]}
        if id(value) in self.seen:
            return {"same": self.seen[id(value)][0]}
        self.seen[id(value)] = len(self.seen), value
        if type(value) in _KINDS.values():
            if not all(type(key) in (str, int) for key in value):
                raise GraphError(f"a checkpoint's {where} has keys other than str and int")
            pairs = [[key, self.packed(item, f"{where}[{key!r}]")] for key, item in value.items()]
            return {"dict": pairs} | ({} if type(value) is dict else {"kind": type(value).__name__})
        if type(value) is list:
            return [self.packed(item, f"{where}[{index}]") for index, item in enumerate(value)]
        return self._packed_array(value, where)

    def _packed_array(self, value: Any, where: str) -> dict[str, Any]:
        name = f"{len(self.arrays):06d}"
        torch, numpy = sys.modules.get("torch"), sys.modules.get("numpy")
        if (
            torch is not None
            and type(value) in (torch.Tensor, torch.nn.Parameter)
            and not value.is_complex()
            and not value.is_sparse
        ):
            if value.is_leaf and value.grad is not None:
                warnings.warn(f"a checkpoint does not keep the gradient of its {where}", stacklevel=2)
            kind = str(value.dtype).removeprefix("torch.")
            flat = value.detach().cpu().contiguous().reshape(-1)
            self.arrays[name] = (flat.view(getattr(torch, _AS_BITS[kind])) if kind in _AS_BITS else flat).numpy()
            size = value.element_size()
            note: dict[str, Any] = {"tensor": name, "dtype": kind, "shape": list(value.shape)}
            return self._placed(
                note, str(value.device), value.data_ptr(), [step * size for step in value.stride()], size
            )
        is_plain = numpy is not None and (type(value) is numpy.ndarray or isinstance(value, numpy.generic))
        if numpy is not None and is_plain and value.dtype.kind in "biuf":
            array = numpy.asarray(value)
            self.arrays[name] = array.astype(array.dtype.newbyteorder("="), order="C", copy=False).reshape(-1)
            note = {"array": name, "shape": list(array.shape), "scalar": isinstance(value, numpy.generic)}
            if note["scalar"]:
                return note
            note |= {} if array.flags.writeable else {"fixed": True}
            return self._placed(note, "cpu", array.ctypes.data, list(array.strides), array.itemsize)
        kind = f"{type(value).__name__} of {value.dtype}" if hasattr(value, "dtype") else type(value).__name__
        raise GraphError(
            f"a checkpoint cannot hold a {kind}, as its {where} does",
            expected="real arrays, tensors, numbers, strings, None, and dicts and lists of them",
        )

    def _placed(self, note: dict[str, Any], device: str, at: int, steps: list[int], size: int) -> dict[str, Any]:
        """Note how an array lies in memory."""
        if math.prod(note["shape"]):
            reach = [(count - 1) * step for count, step in zip(note["shape"], steps, strict=True)]
            low, high = at + sum(min(r, 0) for r in reach), at + sum(max(r, 0) for r in reach) + size
            self.placed.append(((device, low), [high, at, size, *steps], note))
        return note

    def share(self) -> None:
        """Give arrays whose memory overlaps one buffer, and those that do not lie densely in their order one each."""
        groups: list[list[Any]] = []
        for (device, low), (high, at, size, *steps), note in sorted(self.placed, key=lambda row: row[0]):
            if not groups or groups[-1][0] != device or low >= groups[-1][2]:
                groups.append([device, low, high, []])
            groups[-1][2] = max(high, groups[-1][2])
            groups[-1][3].append((at, size, steps, note))
        for number, (_, low, high, members) in enumerate(groups):
            for at, size, steps, note in members:
                dense = [size * math.prod(note["shape"][axis + 1 :]) for axis in range(len(steps))]
                alike = [a for a, b, n in zip(steps, dense, note["shape"], strict=True) if a != b and n > 1]
                if len(members) > 1 or alike:
                    note["lies"] = [number, high - low, at - low, steps]


class _Unpacker:
    """What has been unpacked so far, in the order in which it was packed; buffers by number."""

    def __init__(self, arrays: dict[str, Any]) -> None:
        self.arrays, self.seen, self.buffers = arrays, [], {}  # type: ignore[var-annotated]

    def unpacked(self, value: Any) -> Any:
        if isinstance(value, list):
            self.seen.append(items := [])
            items += [self.unpacked(item) for item in value]
            return items
        if not isinstance(value, dict):
            return value
        if "dict" in value:
            table = _KINDS[value.get("kind", "dict")]()
            self.seen.append(table)
            for key, item in value["dict"]:  # no `update`, which adds to a Counter
                table[key] = self.unpacked(item)
            return table
        if "tuple" in value:
            return tuple(self.unpacked(item) for item in value["tuple"])
        if "float" in value:
            return float(value["float"])
        if "same" in value:
            return self.seen[value["same"]]
        array = self.arrays[value["array"] if "array" in value else value["tensor"]].reshape(value["shape"])
        if "lies" in value:
            array = self._laid(array, *value["lies"])
        if "array" in value:
            found = array[()] if value["scalar"] else array
            if value.get("fixed"):
                found.flags.writeable = False
        else:
            import torch

            kind = value["dtype"]
            found = torch.from_numpy(array)
            found = found.view(getattr(torch, kind)) if kind in _AS_BITS else found
        self.seen.append(found)
        return found

    def _laid(self, array: np.ndarray, number: int, size: int, at: int, steps: list[int]) -> np.ndarray:
        """The array as it lay, in a buffer that it may share with others."""
        import numpy as np

        buffer = self.buffers.setdefault(number, np.zeros(size, np.uint8))
        laid = np.ndarray(array.shape, array.dtype, buffer, at, tuple(steps))
        laid[...] = array
        return laid
