"""For all tests: one thread for torch, before anything loads it, and bytecode that is kept.

Tests run beside one another; OpenMP's threads, which spin for one another, made some of
them 20 times slower. And where PYTHONDONTWRITEBYTECODE is set, as container images like
to, every process that a test starts would compile the package anew.
"""

import os
import sys

import pytest

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

from hypothesis import HealthCheck, settings  # noqa: E402 - torch comes with some strategies: after the above

# how long an example takes to draw says something of the machine's load, not of the code
settings.register_profile("busy", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("busy")


@pytest.fixture(autouse=True)
def _short_launches_are_shared_too(monkeypatch):
    """What is small in a test stands for what is large: its launches take the way of large ones."""
    cores = sys.modules.get("exmesh_graph.gpu.cores")
    if cores is not None:
        monkeypatch.setattr(cores, "WORTH", 0.0)
