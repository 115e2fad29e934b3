"""A device that is not the CPU, without hardware: `with elsewhere(): f(torch.device("meta"))`.

Tensors made on it or moved there are real CPU tensors in a wrapper that says it lies elsewhere. Every operation of
torch, forward and backward, is computed on what is inside. As on a GPU, one that takes tensors of both devices fails,
and so do numpy and Warp's launches. So code goes its way for devices other than the CPU, branches on values and all,
and a tensor that was made without `device=` is found. The device is called meta: torch needs no driver for that one.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
import torch
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode, return_and_correct_aliasing
from torch.utils._pytree import tree_leaves, tree_map

from exmesh_graph.gpu import warp_runtime
from exmesh_graph.gpu.cores import cores
from exmesh_graph.splat.render import TILE

DEVICE = torch.device("meta")
_MAY_MIX = {"copy_", "_to_copy", "index", "index_put", "index_put_", "_index_put_impl_", "_unsafe_index"}
"""As on CUDA: copies, and indices that lie on the CPU."""


class Elsewhere(torch.Tensor):
    """A CPU tensor, `inner`, that says it lies on `DEVICE`."""

    @staticmethod
    def __new__(cls, inner: torch.Tensor) -> Any:
        if inner.layout != torch.strided:  # of compressed rows torch has no wrappers: these look dense
            layout = torch.sparse_coo if inner.layout == torch.sparse_coo else torch.strided
            return torch.Tensor._make_wrapper_subclass(
                cls, inner.shape, dtype=inner.dtype, layout=layout, device=DEVICE
            )  # fmt: skip
        return torch.Tensor._make_wrapper_subclass(
            cls, inner.shape, strides=inner.stride(), storage_offset=inner.storage_offset(), dtype=inner.dtype,
            device=DEVICE,
        )  # fmt: skip

    def __init__(self, inner: torch.Tensor) -> None:
        self.inner = inner

    __torch_function__ = torch._C._disabled_torch_function_impl

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        raise AssertionError(f"{func} outside of `with elsewhere()`")


class _Operations(TorchDispatchMode):
    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        there = _agreed(str(func), tree_leaves((args, kwargs)), func.overloadpacket.__name__ in _MAY_MIX)
        asked = kwargs.get("device")
        if asked is not None:
            kwargs["device"] = torch.device("cpu")
        out_there = there if asked is None else torch.device(asked) == DEVICE
        if out_there and isinstance(kwargs.get("generator"), torch.Generator):
            raise RuntimeError(f"{func}: expected a generator of {DEVICE}, found one of the CPU")
        out = func(*tree_map(_inside, args), **tree_map(_inside, kwargs))
        out = tree_map(lambda t: Elsewhere(t) if out_there and isinstance(t, torch.Tensor) else t, out)
        return return_and_correct_aliasing(func, args, kwargs, out) if there else out


class _Makers(TorchFunctionMode):
    """Lists become tensors on the CPU first: on meta itself torch gives them no values."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        if func in (torch.tensor, torch.as_tensor) and kwargs.get("device") is not None:
            device, needs = kwargs.pop("device"), kwargs.pop("requires_grad", False)
            return func(*args, **kwargs).to(device).requires_grad_(needs)
        if func is torch.Tensor.new_tensor and args[0].device == DEVICE:
            return torch.tensor(args[1], dtype=kwargs.pop("dtype", args[0].dtype), **kwargs).to(DEVICE)
        if func in (torch.Tensor.__getitem__, torch.Tensor.__setitem__):
            args = (args[0], _without_lists(args[1]), *args[2:])
        return func(*args, **kwargs)


def _without_lists(index: Any) -> Any:
    if isinstance(index, tuple):
        return tuple(map(_without_lists, index))
    return torch.tensor(index) if isinstance(index, list | np.ndarray) else index


def _inside(value: Any) -> Any:
    return value.inner if isinstance(value, Elsewhere) else value


def _agreed(what: str, values: Any, may_mix: bool = False) -> bool:
    """Whether the tensors lie elsewhere; RuntimeError where only some do. Single numbers may come from the CPU."""
    tensors = [value for value in values if isinstance(value, torch.Tensor)]
    there = [isinstance(tensor, Elsewhere) for tensor in tensors]
    lost = any(t.device == DEVICE and not away for t, away in zip(tensors, there, strict=True))
    assert not lost, f"{what}: a tensor without values, which `elsewhere` should have made"
    here = [tuple(t.shape) for t, away in zip(tensors, there, strict=True) if not away and t.ndim]
    if any(there) and here and not may_mix:
        raise RuntimeError(f"{what}: all tensors must lie on one device, those of {here} lie on the CPU")
    return any(there)


@contextmanager
def elsewhere() -> Iterator[torch.device]:
    """The device, for as long as the block lasts."""
    wp, convert = warp_runtime.warp(), warp_runtime.convert
    from_torch, device_from_torch = wp.from_torch, wp.device_from_torch

    def converted(kernel: Any, arguments: Any) -> Any:
        _agreed(f"the launch of {kernel.key}", arguments)
        return convert(kernel, [_inside(argument) for argument in arguments])

    def cpu_for(device: torch.device) -> Any:
        return wp.get_device("cpu") if device == DEVICE else device_from_torch(device)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(warp_runtime, "convert", converted)
        patch.setattr(wp, "from_torch", lambda tensor, *a, **k: from_torch(_inside(tensor), *a, **k))
        patch.setattr(wp, "device_from_torch", cpu_for)
        patch.setitem(TILE, DEVICE.type, TILE["cuda"])
        with cores(1), _Makers(), _Operations():  # other threads would know nothing of this
            yield DEVICE
