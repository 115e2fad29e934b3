"""One node as a function."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import exmesh_graph as ex
from exmesh_graph.errors import ExmeshError
from exmesh_graph.graph.problems import GraphErrors


def number(value: float) -> Any:
    return ex.call("toy.const", value=value).number


def test_a_node_as_a_function() -> None:
    assert ex.call("toy.step", state=number(1), amount=2.5).state.value == 3.5
    steps: list[tuple[int, int]] = []
    assert ex.call(
        "toy.count", number=number(0), seed=3, steps=2, progress=lambda step, total, **f: steps.append((step, total))
    )
    assert steps[-1] == (2, 2)
    assert len(ex.call("init.sphere", faces=80).mesh.faces) == 80


def test_the_function_itself_stands_for_its_type() -> None:
    from toy_pack.nodes import const  # type: ignore[import-not-found]

    assert ex.call(const, value=2).number.value == 2
    graph = ex.Graph("g")
    assert graph.add("two", const, value=2).number.node == "two"


def test_components_by_name_and_with_parameters() -> None:
    from toy_pack.curves import Line  # type: ignore[import-not-found]

    line = ex.component("curve.line", slope=3)
    for curve, value in (("curve.line", 2), (line, 6), (Line(slope=4), 8), (ex.component("curve.sum", first=line), 6)):
        assert ex.call("toy.evaluate", number=number(2), curve=curve).number.value == value
    with pytest.raises(GraphErrors, match="less than or equal to 10"):
        ex.call("toy.evaluate", number=number(2), curve=ex.component("curve.line", slope=30))
    with pytest.raises(GraphErrors, match="cannot be"):
        ex.call("toy.evaluate", number=number(2), curve="noise.none")


def test_files_go_where_they_are_told(folder: Path) -> None:
    made = ex.call("toy.folder", number=number(3), folder=folder / "out").files
    assert made.root.is_relative_to(folder / "out")
    kept = ex.call("toy.folder", number=number(3)).files
    assert (kept.root / kept.main).is_file()


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({}, "the input state is not given"),
        ({"state": 3}, "cannot be a int"),
        ({"state": np.zeros((4, 3))}, r"shape \(4, 3\) and type float64"),
        ({"state": "one", "amount": 1}, "cannot be a str"),
        ({"amount": "much"}, "unable to parse string as a number"),
        ({"amout": 1}, "no parameter 'amout'"),
    ],
)
def test_what_a_node_does_not_take(values: dict[str, Any], words: str) -> None:
    with pytest.raises(GraphErrors, match=words) as caught:
        ex.call("toy.step", **{"amount": 1.0, **values})
    assert "test_api_call.py:" in str(caught.value)


def test_all_faults_at_once_and_unknown_types() -> None:
    with pytest.raises(GraphErrors) as caught:
        ex.call("toy.step", state=1, amount="x", by=2)
    assert len(caught.value.problems) == 3
    with pytest.raises(GraphErrors, match=r"toy\.step"):
        ex.call("toy.stp")
    with pytest.raises(GraphErrors, match="is a component"):
        ex.call("curve.line")


def test_a_whole_result_is_no_output() -> None:
    with pytest.raises(GraphErrors, match=r"\.number"):
        ex.call("toy.step", state=ex.call("toy.const", value=1), amount=1)


def test_facets_and_contracts_hold() -> None:
    with pytest.raises(ExmeshError, match="changed its input series in place"):
        ex.call("toy.scribble", series=ex.call("toy.series", number=number(1)).series)
    with pytest.raises(ExmeshError, match="promises"):
        ex.call("toy.liar", number=number(1))


def test_old_names_are_warned_of() -> None:
    with pytest.warns(UserWarning, match="the node type 'toy.constant' is now called 'toy.const'"):
        assert ex.call("toy.constant", value=2).number.value == 2
