"""Where and how wide torch runs, and how arrays become tensors: device, CPU threads for a block, a safe hand-over."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np
import torch

from exmesh_graph.errors import MissingLibraryError

if TYPE_CHECKING:
    from exmesh_graph.gpu.settings import DeviceSettings


@contextmanager
def computing(settings: DeviceSettings) -> Iterator[torch.device]:
    """The device that `settings.device` names, while torch takes `settings.threads` CPU threads."""
    with torch_threads(settings.threads):
        yield pick_device(settings.device)


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Run the block with `count` torch CPU threads (0 = leave as it is), then restore the caller's setting.

    The solvers' tensors are small: one thread is as fast as two on most of their operations, and leaves the second
    core to other nodes of the graph (docs/stage1.md).
    """
    before = torch.get_num_threads()
    if count > 0:
        torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def pick_device(device: str) -> torch.device:
    """The device for "auto", "cpu" or "cuda"; "auto" takes CUDA if torch sees one.

    Raises MissingLibraryError when CUDA is asked for and not there.
    """
    available = torch.cuda.is_available()
    if device == "cuda" and not available:
        raise MissingLibraryError(
            "no CUDA device", where="device: cuda", fix="install a CUDA build of torch, or say device: auto"
        )
    return torch.device("cuda" if available and device != "cpu" else "cpu")


def tensor_of(array: np.ndarray) -> torch.Tensor:
    """The array as a CPU tensor: its own memory where that may be written, else (an artifact on a wire) a copy.

    torch has no read-only tensors; `torch.from_numpy` of a read-only array would let a write through.
    """
    whole = np.ascontiguousarray(array)
    return torch.from_numpy(whole if whole.flags.writeable else whole.copy())


def csr_tensor(start: np.ndarray, index: np.ndarray, value: np.ndarray, shape: tuple[int, int]) -> torch.Tensor:
    """A float32 CSR matrix from its row starts [R + 1], column indices [Z] and values [Z]."""
    with warnings.catch_warnings():  # torch announces on the first CSR tensor that the layout is in beta
        warnings.filterwarnings("ignore", message=".*Sparse CSR tensor support is in beta")
        rows, columns = tensor_of(start.astype(np.int64)), tensor_of(index.astype(np.int64))
        return torch.sparse_csr_tensor(rows, columns, tensor_of(value), shape, check_invariants=False)
