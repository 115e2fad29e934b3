"""`exmesh new-node`: a working node with parameters, documentation and a passing test, in a pack that installs."""

from __future__ import annotations

import keyword
import re
from pathlib import Path

from exmesh_graph.errors import GraphError

_NODE = '''"""{type}: describe the node here."""

from __future__ import annotations

from typing import NamedTuple

from exmesh_graph.graph import node
from exmesh_graph.graph import Context, Params, param
from exmesh_graph.types import Mesh


class {Class}Params(Params):
    steps: int = param(10, ge=0, le=1000, doc="Smoothing steps.")
    strength: float = param(0.5, ge=0, le=1, doc="How far a vertex moves towards the mean of its neighbours.")


class {Class}Out(NamedTuple):
    mesh: Mesh


@node("{type}", version="1")
def {function}(ctx: Context, mesh: Mesh, *, p: {Class}Params) -> {Class}Out:
    """Move every vertex towards the mean of its neighbours."""
    import numpy as np  # heavy libraries are imported here, so that checks and plans stay quick

    ends = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    ends = np.unique(np.concatenate([ends, ends[:, ::-1]]), axis=0)
    count = np.maximum(np.bincount(ends[:, 0], minlength=len(mesh.vertices)), 1)
    points = mesh.vertices.astype(np.float64)
    for step in range(p.steps):
        total = np.zeros_like(points)
        np.add.at(total, ends[:, 0], points[ends[:, 1]])
        points += p.strength * (total / count[:, None] - points)
        ctx.progress(step + 1, p.steps)
    return {Class}Out(Mesh(points.astype(np.float32), mesh.faces))
'''

_TEST = '''"""Tests of the node {type}."""

import numpy as np
import pytest

from exmesh_graph.graph import load_packs
from exmesh_graph.graph.declare.ports import signature
from exmesh_graph.testing import FakeContext, mesh
from {package}.{module} import {Class}Params, {function}


def test_ports_and_parameters():
    ports = signature(load_packs().types["{type}"])
    assert list(ports.inputs) == ["mesh"]
    assert list(ports.outputs) == ["mesh"]
    with pytest.raises(ValueError, match="less than or equal"):
        {Class}Params(strength=2)


def test_it_smooths():
    ball, context = mesh(levels=1), FakeContext()
    out = {function}(context, ball, p={Class}Params(steps=3)).mesh
    assert out.vertices.dtype == np.float32
    assert np.array_equal(out.faces, ball.faces)
    assert np.ptp(out.vertices, axis=0).max() < np.ptp(ball.vertices, axis=0).max()
    assert context.steps == [(1, 3), (2, 3), (3, 3)]


def test_no_steps_change_nothing():
    ball = mesh(levels=1)
    out = {function}(FakeContext(), ball, p={Class}Params(steps=0)).mesh
    assert np.array_equal(out.vertices, ball.vertices)
'''

_PROJECT = """[build-system]
requires = ["setuptools>=77"]
build-backend = "setuptools.build_meta"

[project]
name = "{project}"
version = "0.1.0"
dependencies = ["exmesh-graph"]

[project.entry-points."exmesh.nodes"]
{package} = "{package}"

[tool.setuptools]
packages = ["{package}"]

[tool.pytest.ini_options]
pythonpath = ["."]
"""


def write_node(kind: str, folder: Path) -> list[Path]:
    """Write the node type `kind` into the node pack `folder`; returns the new files. Raises GraphError."""
    match = re.fullmatch(r"([a-z][a-z0-9_]*)\.([a-z][a-z0-9_]*)", kind)
    if match is None or keyword.iskeyword(match[2]):
        raise GraphError(
            f"{kind!r} cannot name a node type",
            expected="family.name in small letters, no word of Python: geometry.smooth",
        )
    package, root = folder.resolve().name, folder.resolve().parent
    if not package.isidentifier():
        raise GraphError(f"the folder {package!r} cannot be a Python package", fix="--into my_nodes")
    names = {
        "type": kind, "module": f"{match[1]}_{match[2]}", "function": match[2], "package": package,
        "project": package.replace("_", "-"), "Class": "".join(word.capitalize() for word in match[2].split("_")),
    }  # fmt: skip
    texts = {
        folder / f"{names['module']}.py": _NODE,
        root / "tests" / f"test_{names['module']}.py": _TEST,
        folder / "__init__.py": '"""Nodes for exmesh graphs; every module here is found by itself."""\n',
        root / "pyproject.toml": _PROJECT,
    }
    taken = [path for path in list(texts)[:2] if path.exists()]
    if taken:
        raise GraphError(f"{taken[0]} is there already", fix="choose another name, or remove it")
    made = [path for path in texts if not path.exists()]
    for path in made:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(_filled(texts[path], names), encoding="utf-8")
    return made


def offered(project: Path, package: str) -> bool:
    """Whether the pyproject.toml `project` names the `package` as one of node types."""
    import tomllib

    try:
        said = tomllib.loads(project.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise GraphError(f"{project} cannot be read: {error}") from None
    return package in said.get("project", {}).get("entry-points", {}).get("exmesh.nodes", {}).values()


def _filled(text: str, names: dict[str, str]) -> str:
    return re.sub(r"\{(\w+)\}", lambda match: names.get(match[1], match[0]), text)
