"""verify sees all that a store holds."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from exmesh_graph.api.upkeep import shown_bytes, to_bytes, to_seconds
from exmesh_graph.errors import ExmeshError
from exmesh_graph.graph.cache.lease import Lease, Leases
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.run.checkpoint import Checkpoints
from exmesh_graph.graph.upkeep.collect import verify
from exmesh_graph.graph.upkeep.pins import pin
from exmesh_graph.types import Metrics

KEY = "ab" * 32


def test_everything_is_looked_at(tmp_path: Path) -> None:
    store = Store(tmp_path)
    with store.attempt() as attempt:
        stored = store.put(Metrics({"x": 1}), attempt)
    key = store.record({"type": "t"}, {"m": stored}, {})
    pin(store, "good", "x", [key])
    pin(store, "poor", "x", [key])
    Checkpoints(tmp_path, KEY).save(1, {})
    Checkpoints(tmp_path, KEY).save(2, {})
    lease = Leases(tmp_path).acquire(KEY)
    assert isinstance(lease, Lease)
    assert list(verify(store)) == []

    latest = Checkpoints(tmp_path, KEY).steps()[0]
    (latest / "meta.json").write_text("{}")
    (tmp_path / "pins" / "poor.json").write_text("{}")
    store.data(stored.digest).joinpath("metrics.json").unlink()
    assert lease.handle is not None
    os.close(lease.handle)  # as when its process dies
    found = dict(verify(store))
    assert set(found) == {
        f"object {stored.digest}", f"action {key}", f"checkpoint {KEY}/{latest.name}",
        "pin good", "pin poor", "lease",
    }  # fmt: skip
    assert "1 of its results are gone" in found["pin good"]
    assert {path.name.partition(".")[0] for path in (tmp_path / "quarantine").iterdir()} >= {stored.digest}
    assert set(dict(verify(store))) == {"pin good", "pin poor"}
    assert Checkpoints(tmp_path, KEY).load() == (1, {})


@pytest.mark.parametrize(("text", "size"), [("5GB", 5e9), ("1.5 MiB", 1.5 * 2**20), ("7", 7), ("2kB", 2000)])
def test_sizes(text: str, size: float) -> None:
    assert to_bytes(text) == size


def test_units_and_their_faults() -> None:
    assert to_seconds("30d") == 30 * 86400
    assert to_seconds("1.5 h") == 5400
    assert [shown_bytes(n) for n in (999, 1500, 2_000_000, 3 * 10**12)] == ["999 B", "1.5 kB", "2.0 MB", "3.0 TB"]
    for text in ("5 parsecs", "-1GB", "x"):
        with pytest.raises(ExmeshError, match="is no size"):
            to_bytes(text)
    with pytest.raises(ExmeshError, match="is no span of time"):
        to_seconds("3")
