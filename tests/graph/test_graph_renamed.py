"""Old names of types, ports and parameters work for one release, with a note, and change no key."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, NamedTuple

import pytest

from exmesh_graph.graph import Component, Context, Params, component, node, param, was
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.declare.ports import signature
from exmesh_graph.graph.language.check import Checked, check_file
from exmesh_graph.graph.problems import GraphErrors
from exmesh_graph.graph.session import Session
from exmesh_graph.graph.variants.checked import check_variant, check_variants
from exmesh_graph.report.reasons import explained as plan
from exmesh_graph.types import Metrics


class Out(NamedTuple):
    figures: Annotated[Metrics, was("metrics")]


class MakeParams(Params):
    size: int = param(1, doc="x", was="count")
    width: float = param(1.0, doc="x", was=("w", "breadth"))


class Rule(Component):
    pass


NEW = """
name: g
nodes:
  rule: {type: new.rule, factor: 3}
  a: {type: new.make, size: 2, width: 0.5}
  b: {type: new.use, figures: "@a.figures", rule: "@rule"}
outputs: {b: "@b.figures"}
"""
OLD = """
name: g
nodes:
  rule: {type: old.rule, strength: 3}
  a: {type: old.make, count: 2, breadth: 0.5}
  b: {type: new.use, metrics: "@a.metrics", rule: "@rule"}
outputs: {b: "@b.metrics"}
"""


SESSION = Session([])
with SESSION:

    @component("new.rule", version="1", was="old.rule")
    class Sum(Rule):
        factor: float = param(1.0, doc="x", was="strength")

    @node("new.make", version="1", was=("old.make", "older.make"))
    def make(ctx: Context, *, p: MakeParams) -> Out:
        """Make."""
        return Out(Metrics({"size": p.size}))

    @node("new.use", version="1")
    def use(ctx: Context, figures: Annotated[Metrics | None, was("metrics")], rule: Rule) -> Out:
        """Use."""
        return Out(figures or Metrics({}))


@pytest.fixture
def packs() -> Packs:
    return SESSION.packs()


@pytest.fixture
def checked(tmp_path: Path, packs: Packs) -> Any:
    def check(text: str, *sets: str, name: str = "g.yaml") -> Checked:
        (tmp_path / name).write_text(text)
        return check_file(tmp_path / name, sets, packs)

    return check


def test_a_graph_in_old_names_is_the_same_graph(checked: Any, tmp_path: Path) -> None:
    new, old = checked(NEW), checked(OLD)
    assert new.resolved() == old.resolved()
    keys = [plan(graph, Store(tmp_path / "s"))[0].key for graph in (new, old)]
    assert keys[0] == keys[1] is not None
    assert new.notes == ()
    shown = [note.partition("; ")[0].partition("g.yaml:")[2] for note in old.notes]
    assert sorted(shown) == [
        "4: new.rule: 'strength' is now called 'factor'",
        "4: the node type 'old.rule' is now called 'new.rule'",
        "5: new.make: 'breadth' is now called 'width'",
        "5: new.make: 'count' is now called 'size'",
        "5: the node type 'old.make' is now called 'new.make'",
        "6: new.use: 'metrics' is now called 'figures'",
        "6: the output of new.make 'metrics' is now called 'figures'",
        "7: the output of new.use 'metrics' is now called 'figures'",
    ]


def test_both_names_at_once(checked: Any) -> None:
    with pytest.raises(GraphErrors, match="size is given twice, as 'size' and as 'count'") as caught:
        checked("nodes: {a: {type: new.make, size: 2, count: 3}}")
    assert [problem.code for problem in caught.value.problems] == ["renamed"]
    with pytest.raises(GraphErrors, match="figures is given twice"):
        checked(OLD.replace('metrics: "@a.metrics",', 'metrics: "@a.metrics", figures: "@a.metrics",'))


def test_the_wrong_value_is_told_under_the_present_name(checked: Any) -> None:
    with pytest.raises(GraphErrors, match="a: size: Input should be a valid integer"):
        checked("nodes: {a: {type: new.make, count: x}}")


def test_what_stands_closer_to_the_run_counts(checked: Any) -> None:
    def sizes(text: str, *sets: str, name: str = "g.yaml") -> list[int]:
        return [bound.params.size for bound in checked(text, *sets, name=name).nodes.values()]

    assert sizes("nodes: {a: {type: new.make, size: 2}}", "a.count=7") == [7]
    assert sizes("nodes: {a: {type: old.make, count: 2}}", "a.size=7") == [7]
    assert sizes("extends: g.yaml\nnodes: {a: {size: 4}}", name="child.yaml") == [4]
    sizes("nodes: {a: {type: new.make, size: 2}}")
    assert sizes("extends: g.yaml\nnodes: {a: {count: 4}}", name="child.yaml") == [4]
    assert sizes("extends: child.yaml\nnodes: {a: {size: 5}}", name="grandchild.yaml") == [5]
    rounds = "nodes: {r: {repeat: 3, nodes: {a: {type: new.make, %s: 1, at: {2: {%s: 9}}}}}}"
    assert sizes(rounds % ("size", "count")) == sizes(rounds % ("count", "size")) == [1, 9, 1]
    assert len(checked(rounds % ("count", "size")).notes) == 1  # once, not in each round


def test_variants(checked: Any, packs: Packs, tmp_path: Path) -> None:
    variants = """
variants:
  new: [{set: a.size, to: 5}]
  old: [{set: a.count, to: 5}]
  off: [{disconnect: b.figures}]
  link: [{connect: b.metrics, to: "@a.metrics"}]
"""
    for text in (NEW, OLD):
        checked(text + variants)
        rows = {row.name: row.checked for row in check_variants(tmp_path / "g.yaml", [], packs)}
        assert [row.nodes["a"].params.size for row in rows.values()] == [2, 5, 5, 2, 2]
        assert not rows["off"].nodes["b"].inputs
        assert [str(link) for link in rows["link"].nodes["b"].inputs.values()] == ["@a.figures"]
        assert (
            check_variant(tmp_path / "g.yaml", [], packs, "old").resolved()["nodes"] == rows["new"].resolved()["nodes"]
        )


class BadParams(Params):
    size: int = param(1, doc="x", was="seed")


def bad(ctx: Context, *, p: BadParams) -> Out:
    return Out(Metrics({}))


def test_declarations_that_cannot_be() -> None:
    with Session([]) as session:
        node("x.bad", version="1", was="x.worse")(bad)
        with pytest.raises(TypeError, match="old names in use: seed"):
            signature(session.types["x.bad"])
        for name, old in (("x.other", "x.bad"), ("x.other", "x.worse"), ("x.worse", ())):
            with pytest.raises(ValueError, match="is that of another type, or was"):
                node(name, version="1", was=old)(make)
