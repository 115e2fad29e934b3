"""Unions and facets: what breaks chains of 3-D nodes is refused before a run, or when it arrives."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, NamedTuple

import pytest

from exmesh_graph.graph import Component, Context, NodeDef, facets
from exmesh_graph.graph.declare.ports import Port, signature
from exmesh_graph.graph.run.runner import NodeFailed
from exmesh_graph.types import Asset, Carrier, Files, Mesh, Metrics, Stage1State, Views

GRAPH = """
nodes:
  good: {type: foreign.common}
  bad: {type: foreign.make}
  use: {type: foreign.use, %s}
"""


def only(problems: list[Any]) -> Any:
    assert len(problems) == 1, "\n".join(map(str, problems))
    return problems[0]


@pytest.mark.parametrize(
    ("port", "wrong", "right", "facet"),
    [
        ("views", "opengl", "views", "camera='opengl'"),
        ("views", "encoded", "views", "color='srgb'"),
        ("mesh", "z_up", "mesh", "up='z'"),
        ("mesh", "scene", "mesh", "units='scene'"),
        ("carrier", "linear", "carrier", "color='linear'"),
        ("depths", "rays", "depths", "depth='ray'"),
        ("sky", "probe", "sky", "environment='angular'"),
        ("asset", "painted", "asset", "maps='srgb'"),
        ("usd", "z_usd", "usd", "up='z'"),
        ("either", "opengl", "views", "camera='opengl'"),
        ("either", "rays", "depths", "depth='ray'"),
        ("opengl", "encoded", "views", "camera='opencv'"),
    ],
)
def test_wrong_conventions_are_refused(bench: Any, port: str, wrong: str, right: str, facet: str) -> None:
    problem = bench.problems(GRAPH % f'{port}: "@bad.{wrong}"')[0]
    assert problem.code == "facet"
    assert facet in problem.what or port == "opengl"
    assert facet in problem.found
    assert "graph.yaml:4) -> use." in problem.wire
    if port == "opengl":
        assert bench.check(GRAPH % 'opengl: "@bad.opengl"')
    else:
        assert f"@good.{right}" in problem.nearest
        assert bench.check(GRAPH % f'{port}: "@good.{right}"')


def test_carriers_have_uvs_and_fit_where_meshes_do(bench: Any) -> None:
    assert bench.check(GRAPH % 'unwrapped: "@good.carrier", mesh: "@good.asset"')
    assert "wrong-type" in str(only(bench.problems(GRAPH % 'carrier: "@good.mesh"')))


def test_unions(bench: Any) -> None:
    problem = only(bench.problems(GRAPH % 'either: "@good.mesh"'))
    assert problem.expected == "Views | DepthMaps"
    assert problem.found == "Mesh"
    graph = bench.check(
        "nodes: {w: {type: toy.whole}, e: {type: toy.either, item: '@w.number'}, n: {type: toy.either}}"
    )
    assert set(graph.nodes["e"].inputs) == {"item"}
    text = "nodes: {w: {type: toy.whole, value: 3}, e: {type: toy.either, item: '@w.number'}}"
    assert bench.value(bench.run(text), "e") == 3


def failure(bench: Any, text: str) -> str:
    with pytest.raises(NodeFailed) as caught:
        bench.run(text)
    return str(caught.value)


def test_what_is_not_promised_is_measured(bench: Any) -> None:
    text = "nodes: {m: {type: foreign.mesh, scale: %s}, u: {type: foreign.use, %s: '@m.mesh'}}"
    assert bench.run(text % (1, "mesh"))["state"] == "done"
    shown = failure(bench, text % (30, "mesh"))
    assert "carries Mesh with units='unknown'" in shown
    assert "units='normalised'" in shown
    assert "uv=False" in failure(bench, text % (1, "unwrapped"))


def test_a_foreign_value_behind_a_common_output_is_the_node_s_fault(bench: Any) -> None:
    text = "nodes: {v: {type: foreign.%s, foreign: true}, u: {type: foreign.use, %s}}"
    assert "promises views with camera='opencv' but made one with camera='opengl'" in failure(
        bench, text % ("views", "views: '@v.views'")
    )
    assert "promises mesh with up='y' but made one with up='z'" in failure(bench, text % ("mesh", "mesh: '@v.mesh'"))


def test_subclasses_keep_what_their_bases_promise() -> None:
    for kind, base in ((Stage1State, Carrier), (Asset, Carrier), (Carrier, Mesh)):
        assert kind.conventions.items() >= base.conventions.items()
        assert Port("a", (base,)).takes(Port("b", (kind,)))


class _Out(NamedTuple):
    files: Files


class _Two(NamedTuple):
    files: Files | Metrics


class _Loss(Component):
    pass


def test_declarations_of_unions() -> None:
    def good(ctx: Context, a: Annotated[Views | Mesh | None, facets(up="y")], b: Mesh | Carrier) -> _Out: ...

    def mixed(ctx: Context, a: Views | _Loss) -> _Out: ...

    def number(ctx: Context, a: Views | int) -> _Out: ...

    def two(ctx: Context) -> _Two: ...

    found = signature(NodeDef("t", good, "1")).inputs
    assert (str(found["a"]), found["a"].optional) == ("Views | Mesh[up='y']", True)
    assert found["b"].types == (Mesh, Carrier)
    both = signature(NodeDef("t", mixed, "1")).inputs["a"]
    assert (both.mixed, both.plugged, both.types) == (True, False, (Views, _Loss))
    for function, word in ((number, "not an Artifact type"), (two, "must be one Artifact type")):
        with pytest.raises(TypeError, match=word):
            signature(NodeDef("t", function, "1"))


def test_measured_facets(tmp_path: Path) -> None:
    import numpy as np

    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.int32)
    points = np.concatenate([np.zeros((1, 3)), np.eye(3)]).astype(np.float32)
    mesh = Mesh(points, faces)
    assert mesh.facets() == {"manifold": True, "closed": True, "uv": False, "units": "normalised"}
    assert Mesh(points * 9, faces[:3]).facets() == {"manifold": True, "closed": False, "uv": False, "units": "unknown"}
    texture = np.zeros((2, 2, 3), np.float32)
    assert Carrier(points, faces, points[:, :2], faces, texture).facets()["uv"]
    assert not Carrier(points, faces, points[:0, :2], faces[:0], texture).facets()["uv"]
    assert Mesh(points[:0], faces[:0]).facets()["units"] == "normalised"
