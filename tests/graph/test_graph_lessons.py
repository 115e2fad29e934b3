"""Ways in which the caches of other frameworks served wrong results, each tried on this one.

Sources edits, files, crashes, leases, gc and moved stores have tests of their own beside this file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exmesh_graph.errors import GraphError
from exmesh_graph.graph.cache import keys
from exmesh_graph.graph.cache.keys import Stored, digest_of
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.declare.ports import artifact_types
from exmesh_graph.report.reasons import explained as plan
from exmesh_graph.types import Metrics


def put(store: Store, value: Any) -> str:
    with store.attempt() as attempt:
        return store.put(value, attempt).digest


def test_shape_and_type_of_an_array_count(tmp_path: Path, packs: Any) -> None:
    """Hamilton served results of a reshaped or recast array."""
    series, store = artifact_types()["Series"], Store(tmp_path)
    base = np.arange(4, dtype=np.float32)
    others = [base, base.reshape(2, 2), base.reshape(4, 1), base.astype(np.float64), base.view(np.int32), base[::-1]]
    others += [np.zeros(0, np.float32), np.zeros((0, 3), np.float32)]
    assert len({put(store, series(data=array)) for array in others}) == len(others)


def test_equal_arrays_have_equal_digests_however_they_lie_in_memory(tmp_path: Path, packs: Any) -> None:
    """The pickles of equal tensors differ; joblib hashed those."""
    series, store = artifact_types()["Series"], Store(tmp_path)
    base = np.arange(6.0).reshape(2, 3)
    same = [base, base.copy(), np.asfortranarray(base), np.arange(12.0).reshape(2, 6)[:, :3] * 0 + base]
    assert len({put(store, series(data=array)) for array in same}) == 1


def test_deep_differences_count(tmp_path: Path) -> None:
    """Hamilton took two models for one that differed only below depth 6."""

    def nested(depth: int, leaf: int) -> Any:
        return {"x": nested(depth - 1, leaf)} if depth else leaf

    store = Store(tmp_path)
    assert put(store, Metrics(nested(12, 1))) != put(store, Metrics(nested(12, 2)))
    assert digest_of(nested(40, 1)) != digest_of(nested(40, 2))


def test_what_has_no_canonical_form_is_an_error() -> None:
    """ComfyUI turned an error of a fingerprint into NaN, Hamilton into a random id: both run for ever."""
    with pytest.raises(GraphError, match="cannot be part of a key"):
        digest_of(np.float32(1))
    with pytest.raises(ValueError, match="JSON"):
        keys.key_of({"x": float("nan")})


def test_another_result_of_the_same_key_replaces_the_record(tmp_path: Path) -> None:
    """DVC kept the record of a lost result of a stage that does not repeat itself, and missed for ever."""
    store, preimage = Store(tmp_path), {"type": "t"}
    with store.attempt() as attempt:
        first, second = (store.put(Metrics({"x": x}), attempt) for x in (1, 2))
    key = store.record(preimage, {"m": first}, {})
    assert store.record(preimage, {"m": second}, {}) == key
    action = store.look_up(key)
    assert action is not None
    assert action.outputs == {"m": second}


def test_downstream_follows_the_recorded_result(bench: Any, states: Any) -> None:
    """What lies below is keyed by what was made, not by what it was made from."""
    graph = 'nodes: {one: {type: toy.const}, sum: {type: toy.add, a: "@one.number"}}'
    first = bench.run(graph)
    row = first["nodes"][0]
    action = bench.store.look_up(row["key"])
    with bench.store.attempt() as attempt:
        other = bench.store.put(artifact_types()["Number"](value=5.0), attempt)
    bench.store.record(action.preimage, {"number": other}, dict(action.info))
    assert [step.state for step in plan(bench.check(graph), bench.store)] == ["hit", "run"]
    assert bench.value(bench.run(graph), "sum") == 5.0


def test_the_epoch_retires_all_keys(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """ccache wants a counter to retire entries that a fault polluted."""
    graph = "nodes: {one: {type: toy.const}}"
    bench.run(graph)
    monkeypatch.setattr(keys, "EPOCH", keys.EPOCH + 1)
    (step,) = plan(bench.check(graph), bench.store)
    assert (step.state, step.reason) == ("run", f"format epoch {keys.EPOCH - 1} -> {keys.EPOCH}")


def test_knobs_that_cannot_change_a_result_stay_out(bench: Any) -> None:
    """Snakemake had to take threads and resources out of what triggers a rerun."""
    bench.run("nodes: {one: {type: toy.const, threads: 1}}")
    (step,) = plan(bench.check("nodes: {one: {type: toy.const, threads: 8}}"), bench.store)
    assert step.state == "hit"


def test_stored_objects_cannot_change_in_place(tmp_path: Path, packs: Any) -> None:
    """Cached objects that others can write to go stale."""
    series, store = artifact_types()["Series"], Store(tmp_path)
    with store.attempt() as attempt:
        stored: Stored = store.put(series(data=np.zeros(3)), attempt)
    loaded = store.load(series, stored.digest)
    assert loaded is not None
    loaded.data[:] = 1
    again = store.load(series, stored.digest)
    assert again is not None
    assert not again.data.any()
    assert all(not path.stat().st_mode & 0o222 for path in store.data(stored.digest).iterdir())
