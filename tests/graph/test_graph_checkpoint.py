"""Checkpoints: what comes back is what was saved, or an older one, or nothing."""

from __future__ import annotations

import enum
import math
import os
import random
import sys
from collections import Counter, OrderedDict, defaultdict, namedtuple
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from exmesh_graph.errors import GraphError, StoreError
from exmesh_graph.graph.run import checkpoint
from exmesh_graph.graph.run.checkpoint import Checkpoints
from exmesh_graph.graph.run.hermetic import apart

KEY = "ab" * 32


def same(one: Any, two: Any) -> bool:
    if type(one) is not type(two):
        return False
    if isinstance(one, dict):
        return list(one) == list(two) and all(same(one[key], two[key]) for key in one)
    if isinstance(one, list | tuple):
        return len(one) == len(two) and all(map(same, one, two))
    if isinstance(one, torch.Tensor):
        bits = one.dtype == two.dtype and one.shape == two.shape
        return bits and torch.equal(*(x.contiguous().reshape(-1).view(torch.uint8) for x in (one, two)))
    if isinstance(one, np.ndarray | np.generic):
        return one.dtype == two.dtype and one.shape == two.shape and one.tobytes() == two.tobytes()
    return one == two or (one != one and two != two)


def test_everything_a_solver_keeps(tmp_path: Path) -> None:
    parameter = torch.nn.Parameter(torch.randn(3, 2))
    optimiser = torch.optim.Adam([parameter], lr=1e-3)
    parameter.sum().backward()
    optimiser.step()
    generator = np.random.default_rng(1)
    state = {
        "tensor": torch.randn(4, 5).T,
        "half": torch.randn(3).bfloat16(),
        "mask": torch.tensor([True, False]),
        "scalar": torch.tensor(2.5),
        "empty": torch.empty(0, 3),
        "array": np.arange(6, dtype=np.uint16).reshape(2, 3),
        "zero_d": np.array(1.5),
        "number": np.float32(0.1),
        "double": np.float64(0.1),  # not a float: float32 times it is float64
        "columns": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "plain": [1, 2.5, math.nan, -math.inf, None, True, "ä", (1, [2])],
        "optimiser": optimiser.state_dict(),
        "torch_rng": torch.get_rng_state(),
        "numpy_rng": generator.bit_generator.state,
        "float": -0.0,
    }
    checkpoints = Checkpoints(tmp_path, KEY)
    checkpoints.save(7, state)
    loaded = Checkpoints(tmp_path, KEY).load()
    assert loaded is not None
    step, found = loaded
    assert step == 7
    state["optimiser"]["param_groups"][0]["betas"] = tuple(state["optimiser"]["param_groups"][0]["betas"])
    assert same(found, state)
    torch.optim.Adam([parameter]).load_state_dict(found["optimiser"])
    assert type(found["double"]) is np.float64
    assert found["columns"].flags.f_contiguous


class Adding(list[int]):
    """Its + is another one."""


class Wrapped(torch.Tensor):
    """Not one of torch's own."""


Point = namedtuple("Point", "x y")
ODD = [
    np.ma.masked_equal([1, 2], 2), enum.IntEnum("E", "a").a, np.matrix([[1]]), Adding([1]), Point(1, 2),
    defaultdict(int), MappingProxyType({}), torch.ones(2).as_subclass(Wrapped),
]  # fmt: skip


@pytest.mark.parametrize("odd", ODD)
def test_what_would_come_back_as_another_kind_is_refused(odd: Any, tmp_path: Path) -> None:
    with pytest.raises(GraphError, match="a checkpoint cannot hold a"):
        Checkpoints(tmp_path, KEY).save(1, {"odd": odd})


leaves = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3)
leaves |= st.lists(st.floats(width=32), max_size=3).map(lambda v: np.array(v, np.float32))
states = st.dictionaries(
    st.text(max_size=3) | st.integers(),
    st.recursive(leaves, lambda x: st.lists(x, max_size=2) | st.dictionaries(st.text(max_size=2), x, max_size=2)),
    max_size=3,
)


@pytest.mark.thorough
@settings(max_examples=25, deadline=None)
@given(states)
def test_any_state_comes_back(tmp_path_factory: pytest.TempPathFactory, state: dict[Any, Any]) -> None:
    checkpoints = Checkpoints(tmp_path_factory.mktemp("c"), KEY)
    checkpoints.save(1, state)
    assert same(checkpoints.load(), (1, state))


@pytest.mark.parametrize("value", [object(), {1, 2}, b"x", np.array(["x"]), {1.5: 2}, torch.zeros(1) * 1j])
def test_other_values_are_refused_by_name(tmp_path: Path, value: Any) -> None:
    checkpoints = Checkpoints(tmp_path, KEY)
    with pytest.raises(GraphError, match="state\\['x'\\]"):
        checkpoints.save(1, {"x": value})
    assert checkpoints.load() is None


def test_the_latest_two_stay(tmp_path: Path) -> None:
    checkpoints = Checkpoints(tmp_path, KEY, keep=2)
    for step in (5, 100, 20, 100):
        checkpoints.save(step, {"step": step})
    assert [path.name.split("-")[0] for path in checkpoints.steps()] == ["000000000100"] * 2
    assert checkpoints.load() == (100, {"step": 100})
    checkpoints.clear()
    assert checkpoints.load() is None
    assert list((tmp_path / "work").iterdir()) == []


def test_other_keys_see_nothing(tmp_path: Path) -> None:
    Checkpoints(tmp_path, KEY).save(3, {})
    other = Checkpoints(tmp_path, "cd" * 32)
    assert other.load() is None
    os.rename(tmp_path / "checkpoints" / KEY, other.folder)
    assert other.load() is None
    assert "another key" in other.notes[0]


def test_another_format_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as before:
        before.setattr(checkpoint, "FORMAT", checkpoint.FORMAT - 1)
        Checkpoints(tmp_path, KEY).save(3, {})
    assert Checkpoints(tmp_path, KEY).load() is None


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-9])


@pytest.mark.parametrize("name", ["arrays.safetensors", "meta.json", "checkpoint.json"])
@pytest.mark.parametrize("spoil", [flip, cut, Path.unlink])
def test_doubt_means_the_one_before(tmp_path: Path, name: str, spoil: Any) -> None:
    checkpoints = Checkpoints(tmp_path, KEY)
    checkpoints.save(1, {"x": torch.ones(100)})
    checkpoints.save(2, {"x": torch.zeros(100)})
    spoil(checkpoints.steps()[0] / name)
    loaded = checkpoints.load()
    assert loaded is not None
    assert same(loaded[1], {"x": torch.ones(100)})
    assert "is not used" in checkpoints.notes[0]
    spoil(checkpoints.steps()[0] / name)
    assert checkpoints.load() is None


def test_a_full_disk_says_so_and_keeps_the_last_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from exmesh_graph.graph.run import checkpoint

    checkpoints = Checkpoints(tmp_path, KEY)
    checkpoints.save(1, {"x": 1})

    def full(folder: Path, *_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checkpoint, "save_state", full)
    with pytest.raises(StoreError, match="No space left"):
        checkpoints.save(2, {"x": 2})
    assert checkpoints.load() == (1, {"x": 1})
    assert list((tmp_path / "work").iterdir()) == []


def test_plain_states_load_no_torch() -> None:
    import subprocess

    code = "import sys, exmesh_graph.graph.run.checkpoint; assert not {'torch', 'numpy'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def come_back(tmp_path: Path, state: dict[str, Any]) -> dict[str, Any]:
    Checkpoints(tmp_path, KEY).save(1, state)
    loaded = Checkpoints(tmp_path, KEY).load()
    assert loaded is not None
    return loaded[1]


def strides(value: Any) -> Any:
    return value.stride() if isinstance(value, torch.Tensor) else getattr(value, "strides", None)


@pytest.mark.reliability("a checkpoint of views, of one array under two names, of read-only ones", "as it was")
def test_what_shares_memory_still_does(tmp_path: Path) -> None:
    array, rows = np.arange(12.0).reshape(3, 4), [1, 2]
    tensor = torch.arange(6.0).reshape(2, 3)
    fixed = np.arange(3)
    fixed.flags.writeable = False
    state = {
        "array": array, "again": array, "column": array[:, 1], "back": array[::-1, ::2], "rows": [rows, rows],
        "tensor": tensor, "detached": tensor.detach(), "part": tensor[:, 1:], "turned": tensor.T.bfloat16().T,
        "lone": torch.arange(20)[::3], "wide": torch.ones(1).expand(4), "of": torch.from_numpy(array), "fixed": fixed,
        "apart": list(torch.arange(6).chunk(2)), "none": array[:0],
    }  # fmt: skip
    before = {name: strides(value) for name, value in state.items()}
    found = come_back(tmp_path, state)
    assert same(found, state)
    assert found["array"] is found["again"]
    assert found["rows"][0] is found["rows"][1]
    assert not found["fixed"].flags.writeable
    assert found["array"].flags.writeable
    for name in ("column", "back", "lone", "turned", "part"):
        assert strides(found[name]) == before[name], name
    found["array"][:] = 7
    found["tensor"][:] = 8
    for name, value in (("column", 7), ("back", 7), ("of", 7), ("detached", 8), ("part", 8)):
        assert (found[name] == value).all(), name


def test_a_state_that_holds_itself_and_counters(tmp_path: Path) -> None:
    state: dict[str, Any] = {"n": Counter(a=2), "order": OrderedDict(b=1, a=2), "size": torch.ones(2, 3).shape}
    state["own"] = state
    found = come_back(tmp_path, state)
    assert found["own"] is found
    found["n"].update(["a"])
    assert found["n"] == Counter(a=3)
    assert found["order"] != OrderedDict(a=2, b=1)
    assert found["size"] == (2, 3)


def test_a_gradient_is_not_lost_in_silence(tmp_path: Path) -> None:
    parameter = torch.nn.Parameter(torch.ones(2))
    assert come_back(tmp_path, {"x": parameter})["x"].tolist() == [1, 1]
    parameter.sum().backward()
    with pytest.warns(UserWarning, match=r"does not keep the gradient of its state\['x'\]"):
        come_back(tmp_path, {"x": parameter})


@pytest.mark.reliability("a node that draws from the global generators goes on from a checkpoint", "it draws on")
def test_global_generators_go_on(tmp_path: Path) -> None:
    def draw() -> list[float]:
        return [random.random(), float(np.random.random()), float(torch.rand(1))]  # noqa: NPY002

    with apart(1):
        draw()
        Checkpoints(tmp_path, KEY).save(1, {})
        expected = draw()
    with apart(1):
        Checkpoints(tmp_path, KEY).load()
        assert draw() == expected
