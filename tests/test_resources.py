"""How much memory a process may still take: what the machine has free, or less where a control group limits it."""

import platform

import psutil
import pytest

from exmesh_graph import resources
from exmesh_graph.resources import memory_to_spare


def test_no_more_than_the_machine_has():
    assert 0 < memory_to_spare() <= psutil.virtual_memory().total


@pytest.mark.parametrize(
    ("controller", "files"),
    [
        ("", {"memory.max": "3000000\n", "memory.current": "1000000\n"}),
        ("memory", {"memory.limit_in_bytes": "3000000\n", "memory.usage_in_bytes": "1000000\n"}),
    ],
)
def test_a_control_group_leaves_less(monkeypatch, tmp_path, controller, files):
    monkeypatch.setattr(resources, "_own_groups", lambda: iter([(controller, tmp_path)]))
    without = memory_to_spare()
    assert without > 2_000_000
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    assert memory_to_spare() == 2_000_000


def test_a_control_group_without_a_limit_or_overdrawn(monkeypatch, tmp_path):
    monkeypatch.setattr(resources, "_own_groups", lambda: iter([("", tmp_path)]))
    (tmp_path / "memory.current").write_text("5000\n")
    (tmp_path / "memory.max").write_text("max\n")
    assert memory_to_spare() > 5000
    (tmp_path / "memory.max").write_text("4000\n")
    assert memory_to_spare() == 0


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries keep little, or say nothing")
def test_what_was_freed_goes_back_to_the_system() -> None:
    blocks = [bytearray(100_000) for _ in range(600)]  # small enough to lie on the heap, which the last one holds up
    full = resources.memory_in_use()
    del blocks[:-1]
    resources.return_memory()
    assert full - resources.memory_in_use() > 50e6
