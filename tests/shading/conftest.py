"""Shared by the tests of the shading room."""

import pytest

from exmesh_graph.gpu.torch_setup import torch_threads


@pytest.fixture
def one_thread():
    """Small tensors: more threads only wait for each other."""
    with torch_threads(1):
        yield
