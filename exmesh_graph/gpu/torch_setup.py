"""Where and how wide torch runs, and how arrays become tensors: device, CPU threads for a block, a safe hand-over."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np
import torch

from exmesh_graph.errors import ExmeshError, MissingLibraryError
from exmesh_graph.gpu.cores import cores
from exmesh_graph.gpu.verdict import cuda_fault

if TYPE_CHECKING:
    from exmesh_graph.gpu.settings import DeviceSettings


@contextmanager
def computing(settings: DeviceSettings) -> Iterator[torch.device]:
    """The device that `settings.device` names, while CPU kernels share `settings.threads` cores.

    Raises ExmeshError, with the parameters that help, where the device's memory does not suffice.
    """
    try:
        with sharing(settings.threads):
            yield pick_device(settings.device)
    except torch.OutOfMemoryError as error:
        raise ExmeshError(
            f"the GPU's memory does not suffice ({str(error).splitlines()[0]})", where=f"device: {settings.device}",
            fix="raise `downscale`, lower `texture_size` or `max_gaussians`, or say device: cpu",
        ) from error  # fmt: skip


@contextmanager
def sharing(count: int) -> Iterator[None]:
    """Let the kernels share `count` CPU cores within the block (0: all that the process may use), torch and numpy's
    products take one.

    The solvers' tensors and matrices are small, and these threads spin for one another: beside other work two of torch
    took up to eight times as long as one, and two of OpenBLAS thirty times.
    """
    from threadpoolctl import threadpool_limits

    with torch_threads(1), threadpool_limits(1, user_api="blas"), cores(count):
        yield


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Run the block with `count` torch CPU threads (0 = leave as it is), then restore the caller's setting."""
    before = torch.get_num_threads()
    if count > 0:
        torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def pick_device(device: str) -> torch.device:
    """The device for "auto", "cpu" or "cuda"; "auto" takes CUDA if torch sees one and it computes as the CPU does.

    Raises MissingLibraryError when CUDA is asked for and not there.
    """
    available = torch.cuda.is_available()
    if device == "cuda" and not available:
        raise MissingLibraryError(
            "no CUDA device", where="device: cuda", fix="install a CUDA build of torch, or say device: auto"
        )
    if device == "auto":
        device = "cuda" if available and not cuda_fault() else "cpu"
    return torch.device(device)


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
