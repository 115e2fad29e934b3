"""For all tests: one thread for torch, before anything loads it, and bytecode that is kept.

Tests run beside one another; OpenMP's threads, which spin for one another, made some of
them 20 times slower. And where PYTHONDONTWRITEBYTECODE is set, as container images like
to, every process that a test starts would compile the package anew.

A shell that puts a job into the background lets it ignore Ctrl-C, and so would the commands
that tests start: they are interrupted there as anywhere.
"""

import os
import signal
import sys
from pathlib import Path

import pytest

LONGEST = (
    "test_end_to_end.py",
    "stage2/test_probe_scene.py",
    "stability/test_stability_rows.py",
    "nodes/test_nodes_evaluate.py",
    "graph/test_graph_limits.py",
    "io/test_io_checks.py",
    "cli/test_cli_commands.py",
    "stage1/test_stage1_appearance.py",
    "uv/test_unwrap_hard.py",
    "graph/test_graph_remote.py",
    "graph/conformance/test_backends_agree.py",
    "graph/backends/test_backend_local.py",
    "graph/reliability/test_reliability.py",
    "test_architecture.py",
    "priors/test_priors_patch_match.py",
)
"""Files of this folder that take longest, first in the run, so that its end waits for no single one."""

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

from hypothesis import HealthCheck, settings  # noqa: E402 - torch comes with some strategies: after the above

# how long an example takes to draw says something of the machine's load, not of the code
settings.register_profile("busy", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("busy")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """The longest files first; all else in its order. A run of everything leaves out what is thorough."""
    if _is_of_everything(config):
        left_out = [item for item in items if "thorough" in item.keywords]
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if "thorough" not in item.keywords]
    place = {Path(__file__).parent / name: row for row, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path, len(place)))


def _is_of_everything(config: pytest.Config) -> bool:
    """Whether neither files, words nor marks were asked for."""
    root, here = config.rootpath, Path(__file__).parent
    whole = {root / path for path in config.args} <= {root, here}
    return whole and not config.option.keyword and config.option.markexpr in ("", "not slow")


@pytest.fixture(autouse=True)
def _short_launches_are_shared_too(monkeypatch):
    """What is small in a test stands for what is large: its launches take the way of large ones."""
    cores = sys.modules.get("exmesh_graph.gpu.cores")
    if cores is not None:
        monkeypatch.setattr(cores, "HANDING", 1e-12)
