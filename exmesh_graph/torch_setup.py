"""Where and how wide torch runs: the device a user names, and CPU threads for the length of a block only."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from exmesh_graph.errors import MissingLibraryError


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


def pick_device(wish: str) -> torch.device:
    """The device for "auto", "cpu" or "cuda"; "auto" takes CUDA if torch sees one.

    Raises MissingLibraryError when CUDA is asked for and not there.
    """
    available = torch.cuda.is_available()
    if wish == "cuda" and not available:
        raise MissingLibraryError(
            "no CUDA device", where="device: cuda", fix="install a CUDA build of torch, or say device: auto"
        )
    return torch.device("cuda" if available and wish != "cpu" else "cpu")
