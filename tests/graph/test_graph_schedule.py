"""Tokens and priorities."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from exmesh_graph.api.runs import parse_tokens
from exmesh_graph.errors import GraphError
from exmesh_graph.graph.run.schedule import Pool, remaining_seconds
from exmesh_graph.resources import machine_tokens

CHAIN = """
nodes:
  a: {type: toy.const}
  b: {type: toy.step, state: "@a.number"}
  c: {type: toy.step, state: "@b.state"}
  d: {type: toy.sign, number: "@a.number"}
"""


def asking(bench: Any, **resources: float) -> Any:
    bound = bench.check(CHAIN).nodes["a"]
    return replace(bound, definition=replace(bound.definition, resources=resources))


def test_the_longest_remaining_path_counts(bench: Any) -> None:
    nodes = bench.check(CHAIN).nodes
    assert remaining_seconds(nodes, {}) == {"a": 3.0, "b": 2.0, "c": 1.0, "d": 1.0}
    found = remaining_seconds(nodes, {"d": 9.0, "b": 2.0})
    assert found == {"c": 2.0, "b": 4.0, "d": 9.0, "a": 10.0}  # c as the other toy.step; a never ran: 1 s


def test_wishes_are_cut_or_refused(bench: Any) -> None:
    pool = Pool({"cpu": 4, "jobs": 4, "gpu": 1})
    assert pool.wanted(asking(bench))["cpu"] == 1
    assert Pool({"cpu": 8, "jobs": 8}, {"cpu": 4}).wanted(asking(bench, cpu=0))["cpu"] == 4  # of several machines
    assert pool.wanted(asking(bench, cpu=64))["cpu"] == 4
    assert pool.wanted(asking(bench, **{"gpu?": 9}))["gpu"] == pool.most["gpu"]
    assert "gpu" not in Pool({"cpu": 4, "gpu": 0, "jobs": 9}).wanted(asking(bench, **{"gpu?": 1}))
    with pytest.raises(GraphError, match="asks for gpu=2, licence=1, and there is gpu=1, licence=0"):
        pool.wanted(asking(bench, gpu=2, licence=1))


def test_any_number_of_cores_is_what_others_leave(bench: Any) -> None:
    """On one machine: a few to begin with, all while nothing else runs, a fair part beside others."""
    any_number = {name: replace(asking(bench, cpu=0), name=name) for name in "xyz"}
    for cpus, least in ((1, 1), (2, 1), (4, 2), (8, 4), (64, 4)):
        assert Pool({"cpu": cpus, "jobs": 9}).wanted(any_number["x"])["cpu"] == least
    pool = Pool({"cpu": 9, "jobs": 9})
    for name in "xy":
        pool.take(name, pool.wanted(any_number[name]))
    assert pool.cores() == {"x": 5, "y": 4}
    assert not pool.fits(pool.wanted(any_number["z"]))
    pool.take("a", pool.wanted(asking(bench)))
    assert pool.cores() == {"x": 4, "y": 4, "a": 0}
    pool.give_back("x")
    assert pool.cores() == {"y": 8, "a": 0}
    pool.give_back("a")
    assert pool.cores() == {"y": 9}


def test_large_nodes_run_beside_one_another_where_memory_allows(bench: Any) -> None:
    any_number = {name: replace(asking(bench, cpu=0), name=name) for name in "xyz"}
    pool = Pool({"cpu": 64, "jobs": 9, "ram_gb": 16}, None, {"x": 7e9, "y": 5e9, "z": 7e9})
    for name in "xyz":
        pool.wanted(any_number[name])
    assert pool.roomy("x")
    pool.take("x", pool.wanted(any_number["x"]))
    assert pool.roomy("y")
    assert not pool.roomy("z")
    assert pool.roomy("a")  # of one core
    alone = Pool({"cpu": 64, "jobs": 9, "ram_gb": 1})
    alone.wanted(any_number["x"])
    assert alone.roomy("x")  # alone it may try


def test_gpus_are_lent_whole_or_in_parts() -> None:
    pool = Pool({"gpu": 3, "vram_gb": 40})
    assert pool.take("a", {"gpu": 1.0}) == (0,)
    assert pool.take("b", {"gpu": 0.5}) == (1,)
    assert pool.take("c", {"gpu": 0.5}) == (1,)
    assert pool.fits({"gpu": 1.0})
    assert not pool.fits({"gpu": 2.0})
    assert not pool.fits({"gpu": 1.0, "vram_gb": 41})
    assert pool.take("d", {"gpu": 0.4}) == (2,)
    assert not pool.fits({"gpu": 1.0})
    pool.give_back("b")
    assert pool.take("e", {"gpu": 0.5}) == (1,)
    for name in "acde":
        pool.give_back(name)
    assert pool.take("f", {"gpu": 3.0}) == (0, 1, 2)


@given(st.lists(st.tuples(st.sampled_from("xyz"), st.floats(0, 5)), max_size=30))
def test_tokens_are_never_given_out_twice(wishes: list[tuple[str, float]]) -> None:
    pool = Pool({"x": 5, "y": 2, "z": 0})
    held: dict[str, dict[str, float]] = {}
    for number, (token, count) in enumerate(wishes):
        name = f"n{number}"
        if pool.fits({token: count}):
            pool.take(name, {token: count})
            held[name] = {token: count}
        elif held:
            gone = next(iter(held))
            pool.give_back(gone)
            del held[gone]
        for each, capacity in (("x", 5), ("y", 2), ("z", 0)):
            assert sum(wish.get(each, 0.0) for wish in held.values()) <= capacity + 1e-6
    for name in held:
        pool.give_back(name)
    assert pool.free == pytest.approx(pool.capacity)


def test_the_command_line_s_tokens() -> None:
    assert parse_tokens("cpu=4, gpu=1,licence=0.5") == {"cpu": 4, "gpu": 1, "licence": 0.5}
    assert parse_tokens("") == {}
    for text in ("cpu", "cpu=many", "=3", "cpu=-1", "cpu=inf", "cpu=nan"):
        with pytest.raises(GraphError, match="cannot read --tokens"):
            parse_tokens(text)


def test_the_machine_s_tokens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "0,1")
    found = machine_tokens()
    assert found["cpu"] >= 1
    assert found["ram_gb"] > 0.5
    assert found["gpu"] == 2
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    assert machine_tokens()["gpu"] == 0


def test_gpu_memory_is_asked_for_where_a_node_needs_it(
    bench: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    tool = tmp_path / "nvidia-smi"
    tool.write_text("#!/bin/sh\necho 24564\necho 24564\n")
    tool.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    pool = Pool({"cpu": 4, "jobs": 4, "gpu": 2})
    assert pool.wanted(asking(bench, gpu=1, vram_gb=40))["vram_gb"] == 40
    assert pool.capacity["vram_gb"] == pytest.approx(51.5, abs=0.1)
    tool.unlink()
    with pytest.raises(GraphError, match="asks for vram_gb=1"):
        Pool({"cpu": 4, "jobs": 4, "gpu": 2}).wanted(asking(bench, vram_gb=1))
