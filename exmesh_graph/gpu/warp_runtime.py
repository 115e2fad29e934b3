"""One place where Warp is set up: quiet, lazily, with a kernel cache that can be written."""

from __future__ import annotations

import copy
import ctypes
import os
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import torch


class _Recorded(threading.local):
    def __init__(self) -> None:
        self.launches: dict[Any, tuple[Any, Any]] = {}
        """Of each kernel: Warp's recorded launch, and its size."""


_recorded = _Recorded()
_first: dict[Any, Any] = {}
_loading = threading.RLock()
_NO_DRIVER = b"Warp CUDA warning: Could not find or load the NVIDIA CUDA driver"


def warp() -> Any:
    """The initialised `warp` module. Nothing is compiled yet: each module of kernels does so on its first launch."""
    with _loading:  # a cached function runs twice when two threads call it first
        return _initialised()


@cache
def _initialised() -> Any:
    import warp as wp

    if hasattr(wp.config, "log_level"):
        wp.config.log_level = wp.LOG_WARNING  # not in the key: what it prints
    else:  # earlier versions of Warp have a switch
        wp.config.quiet = True  # type: ignore[attr-defined]  # not in the key: what it prints
    if not _cache_is_writable():
        # a read-only home would make every first launch fail: fall back to a private folder of this user
        home = Path(tempfile.gettempdir())  # not in the key: a cache
        wp.config.kernel_cache_dir = str(home / f"exmesh-warp-{os.getuid()}")  # not in the key: a cache
    with _without_driver_notice():
        wp.init()
    return wp


def launch(kernel: Any, size: int | tuple[int, ...], *arguments: Any) -> None:
    """Launch `kernel` over `size` threads on the device of its first tensor argument.

    Contiguous tensors are handed over as they lie, without a copy: a float32 [N, 3] fills an array of `vec3`, an
    int32 [N, 3] one of `vec3i`, as the kernel's signature says. On CUDA the launch joins torch's current stream.
    """
    wp = warp()
    device = next(a.device for a in arguments if isinstance(a, torch.Tensor))
    converted = convert(kernel, arguments)
    if device.type == "cpu":
        launch_converted(kernel, size, converted)
        return
    stream = wp.stream_from_torch(torch.cuda.current_stream(device)) if device.type == "cuda" else None
    with _loading:
        wp.launch(kernel, dim=size, inputs=converted, device=wp.device_from_torch(device), stream=stream)


def launch_adjoint(kernel: Any, size: int, arguments: Sequence[Any], adjoints: Sequence[Any]) -> None:
    """Launch the adjoint that Warp has derived of `kernel`, on a CPU, on this thread.

    `adjoints` has for each argument the tensor that its gradient is added to (for what the kernel writes: the gradient
    that comes in), None for those that none is wanted of, and a zero for what is no array.
    """
    given, wanted = convert(kernel, arguments), convert(kernel, adjoints)
    with _loading:
        warp().launch(kernel, dim=size, inputs=given, adj_inputs=wanted, adjoint=True, device="cpu")


def launch_converted(kernel: Any, size: int | tuple[int, ...], converted: Sequence[Any]) -> None:
    """Launch on the CPU with arguments of `convert`.

    `warp.launch` takes some 60 us to look at its arguments, as long as many kernels of a small picture take. Its
    recorded launches take new arguments as they are: each thread has one of each kernel, copied from the first.
    """
    if size == 0 or (isinstance(size, tuple) and 0 in size):  # Warp records nothing then
        return
    if kernel.is_generic:  # its types may be others next time
        _record(kernel, size, converted).launch()
        return
    if kernel not in _recorded.launches:
        _recorded.launches[kernel] = (_copy_of_first(kernel, size, converted), None)  # not in the key: a cache
    command, before = _recorded.launches[kernel]
    params = command.params  # after the bounds, the arguments as ctypes has them
    for index, value in enumerate(converted, 1):
        if isinstance(value, ctypes.Structure):
            params[index] = value
        elif isinstance(value, (int, float)):
            params[index].value = value
        else:
            command.set_param_at_index(index - 1, value)
    if size != before:
        command.set_dim(size)
    _recorded.launches[kernel] = (command, size)  # not in the key: a cache
    command.launch()


def _record(kernel: Any, size: Any, converted: Sequence[Any]) -> Any:
    """Warp compiles and loads modules while it records, one thread at a time: two unload each other's code."""
    with _loading:
        return warp().launch(kernel, dim=size, inputs=converted, device="cpu", record_cmd=True)


def _copy_of_first(kernel: Any, size: Any, converted: Sequence[Any]) -> Any:
    with _loading:
        if kernel not in _first:
            _first[kernel] = _record(kernel, size, converted)  # not in the key: a cache
    command = copy.copy(_first[kernel])
    # numbers are changed in place, so each copy needs its own
    command.params = [type(p)(p.value) if isinstance(p, ctypes._SimpleCData) else p for p in command.params]
    command.fwd_args = None  # which Warp keeps for the capture of graphs
    return command


def convert(kernel: Any, arguments: Sequence[Any]) -> list[Any]:
    """`arguments` as `warp.launch` takes them: tensors as descriptors of their memory, the rest as it is.

    Tensors must outlive the launch.
    """
    converted = []
    for argument, slot in zip(arguments, kernel.adj.args, strict=True):
        if isinstance(argument, torch.Tensor):
            argument = _descriptor(argument, slot.type)
        converted.append(argument)
    return converted


def _descriptor(tensor: torch.Tensor, slot: Any) -> Any:
    """Where a tensor lies and how, for a parameter of type `slot`. Steps bring tensors of the same few layouts: each is
    described once, and told where it lies."""
    layout = (tensor.shape, tensor.stride(), tensor.dtype, tensor.device, slot.dtype, slot.ndim)
    known = _layouts.get(layout)
    if known is None:
        shaped = tensor
        if slot.ndim == 1:  # pictures as lists of pixels
            shaped = tensor.view(-1, *getattr(slot.dtype, "_shape_", ()))
        known = warp().from_torch(shaped.detach(), dtype=slot.dtype, requires_grad=False, return_ctype=True)
        known._ref = None  # Warp's hold on the tensor would keep its memory as long as the layout is known
        if len(_layouts) >= _MOST_LAYOUTS:
            _layouts.clear()  # not in the key: a cache
        _layouts[layout] = known  # not in the key: a cache
    described = type(known).from_buffer_copy(known)
    described.data = tensor.data_ptr()
    return described


_layouts: dict[Any, Any] = {}
_MOST_LAYOUTS = 1 << 14


def _cache_is_writable() -> bool:
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"  # not in the key: a cache
    root = os.environ.get("WARP_CACHE_PATH") or home  # not in the key: a cache
    try:
        Path(root).mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(root, os.W_OK)


@contextmanager
def _without_driver_notice() -> Iterator[None]:
    """Warp's native library writes to file descriptor 2 that there is no CUDA driver; on a CPU that is no news.

    Whatever else is written meanwhile is passed on.
    """
    try:
        sys.stderr.flush()
        saved = os.dup(2)
    except (OSError, ValueError, AttributeError):  # no usable stderr: nothing to keep quiet
        yield
        return
    with tempfile.TemporaryFile() as held:
        os.dup2(held.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(saved, 2)
            os.close(saved)
            held.seek(0)
            lines = [line for line in held if not line.startswith(_NO_DRIVER)]
            if lines:
                os.write(2, b"".join(lines))


def _unlock() -> None:
    """A forked child has none of its parent's threads, so nobody would give back what they hold."""
    global _loading  # not in the key: a lock
    _loading = threading.RLock()


os.register_at_fork(after_in_child=_unlock)
