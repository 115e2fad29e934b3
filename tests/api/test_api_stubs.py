"""What editors complete: the stub that is shipped is that of the node types."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.api.described import node_types
from exmesh_graph.api.opening import packs
from exmesh_graph.api.stubs import SHIPPED, stub_text


def test_the_shipped_stub_is_that_of_the_node_types() -> None:
    assert SHIPPED.read_text(encoding="utf-8") == stub_text(builtin=True), "exmesh stubs --install writes it"


@pytest.mark.thorough
def test_every_type_has_its_method_with_ports_and_parameters() -> None:
    classes = {item.name: item for item in ast.parse(SHIPPED.read_text()).body if isinstance(item, ast.ClassDef)}
    families = {
        item.target.id: item.annotation.id for item in classes["Families"].body if isinstance(item, ast.AnnAssign)
    }  # type: ignore[union-attr,attr-defined]
    for kind, info in node_types().items():
        family, _, name = kind.partition(".")
        if family not in families:
            assert packs().types[kind].function.__module__.startswith("toy_pack"), kind
            continue
        method: Any = next(item for item in classes[families[family]].body if getattr(item, "name", "") == name)
        arguments = {argument.arg for argument in method.args.kwonlyargs}
        assert {port.name for port in info.inputs} | {one.name for one in info.parameters} <= arguments
        assert ast.get_docstring(method)


def test_the_command_writes_the_stub(folder: Path) -> None:
    text = stub_text()
    assert "class _Toy(Family):" in text
    compile(text, "families.pyi", "exec")
