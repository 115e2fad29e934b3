"""Pictures of graphs: boxes apart, frames around their own, every wire whole and downwards; SVG, page, Mermaid."""

from __future__ import annotations

import itertools
import re
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from exmesh_graph.report.drawing.formats import mermaid, page, render
from exmesh_graph.report.drawing.layout import BlockFrame, arrange
from exmesh_graph.report.drawing.svg import Box, GraphPicture, draw

SIZE = (120.0, 50.0)


def scopes_of(names: list[str]) -> dict[str, tuple[str, ...]]:
    return {name: tuple(name.split(".")[:-1]) for name in names}


def holds(frame: BlockFrame, x: float, y: float) -> bool:
    return 0 <= x - frame.x <= frame.width and 0 <= y - frame.y <= frame.height


@st.composite
def graphs(draw: st.DrawFn) -> tuple[list[str], list[tuple[str, str]]]:
    """Nodes in a fixed order, some in frames that are contiguous in it, some of these nested; edges point forwards."""
    names: list[str] = []
    for index in range(draw(st.integers(1, 5))):
        inner = draw(st.integers(0, 3))
        names += [f"b{index}.n{k}" for k in range(inner)] or [f"n{index}"]
        names += [f"b{index}.c{index}.n{k}" for k in range(draw(st.integers(0, 2)) if inner else 0)]
    pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
    return names, draw(st.lists(st.sampled_from(pairs), max_size=16, unique=True)) if pairs else []


@pytest.mark.thorough
@given(graphs())
def test_boxes_stay_apart_and_inside_their_frames(graph: tuple[list[str], list[tuple[str, str]]]) -> None:
    names, edges = graph
    layout = arrange(dict.fromkeys(names, SIZE), edges, scopes_of(names))
    boxes = list(layout.boxes.items())
    assert len(boxes) == len(names)
    for index, (name, (x0, y0)) in enumerate(boxes):
        assert SIZE[0] / 2 <= x0 <= layout.width - SIZE[0] / 2
        assert SIZE[1] / 2 <= y0 <= layout.height - SIZE[1] / 2
        for _, (x1, y1) in boxes[index + 1 :]:
            assert abs(x0 - x1) >= SIZE[0] or abs(y0 - y1) >= SIZE[1]
        for frame in layout.frames:
            corners = [holds(frame, x0 + sx * SIZE[0] / 2, y0 + sy * SIZE[1] / 2) for sx in (-1, 1) for sy in (-1, 1)]
            own = name.startswith(frame.name + ".")
            assert all(corners) if own else not any(corners)


@pytest.mark.thorough
@given(graphs())
def test_every_wire_is_whole_and_runs_down(graph: tuple[list[str], list[tuple[str, str]]]) -> None:
    names, edges = graph
    layout = arrange(dict.fromkeys(names, SIZE), edges, scopes_of(names))
    for a, b in edges:
        pieces = sorted((p for p in layout.pieces if p.source == a and b in p.to), key=lambda p: p.y0)
        (x0, y0), (x1, y1) = layout.boxes[a], layout.boxes[b]
        assert pieces[0].x0 == pytest.approx(x0)
        assert pieces[0].y0 == pytest.approx(y0 + SIZE[1] / 2)
        assert pieces[-1].arrow
        assert abs(pieces[-1].x1 - x1) < SIZE[0] / 2
        assert pieces[-1].y1 == pytest.approx(y1 - SIZE[1] / 2)
        for upper, lower in itertools.pairwise(pieces):
            assert (upper.x1, upper.y1) == pytest.approx((lower.x0, lower.y0))
        assert all(p.y1 >= p.y0 for p in pieces)


def test_wires_between_frames_that_feed_each_other_are_all_drawn() -> None:
    names = ["f.a", "x", "f.b", "g.a"]
    edges = [("f.a", "x"), ("x", "f.b"), ("f.b", "g.a"), ("f.a", "g.a")]
    layout = arrange(dict.fromkeys(names, SIZE), edges, scopes_of(names))
    for a, b in edges:
        pieces = [piece for piece in layout.pieces if piece.source == a and b in piece.to]
        assert any(piece.arrow for piece in pieces), (a, b)
        assert min(piece.y0 for piece in pieces) == pytest.approx(layout.boxes[a][1] + SIZE[1] / 2), (a, b)


def test_a_chain_stands_upright() -> None:
    names = [f"n{k}" for k in range(6)]
    layout = arrange(dict.fromkeys(names, SIZE), list(itertools.pairwise(names)), scopes_of(names))
    assert len({x for x, _ in layout.boxes.values()}) == 1


PICTURE = GraphPicture(
    [
        Box("views", "data.blender", "hit", 2.0, 1, 3_000_000, hover=("out  train: Views",)),
        Box("rounds.refine", "stage1.refine", "done", 40.0, 4),
        Box("rounds.uv", "uv.maintain / uv.<regen>", "failed", None, 4),
        Box("end", "evaluate", "changed", note="iterations 4 -> 5"),
    ],
    [("views", "rounds.refine"), ("rounds.refine", "rounds.uv"), ("rounds.uv", "end"), ("views", "end")],
    [("rounds.uv", "rounds.refine")],
    {("views", "end"): "added"},
    "quick & small",
)


def test_the_svg_is_well_formed_and_says_what_it_knows() -> None:
    svg = draw(PICTURE)
    root = ElementTree.fromstring(svg)
    texts = [node.text for node in root.iter("{http://www.w3.org/2000/svg}text")]
    assert {"views", "refine", "uv.maintain / uv.<regen>", "iterations 4 -> 5", "quick & small"} <= set(texts)
    assert "rounds  ×4" in texts
    assert "2.00 s · 3.0 MB" in texts
    titles = [node.text or "" for node in root.iter("{http://www.w3.org/2000/svg}title")]
    assert any("out  train: Views" in title for title in titles)
    assert re.search(r'class="gp-wire added" data-from="views" data-to="end"', svg)
    assert svg.count('class="gp-wire gp-loop"') == 1
    assert "var(" not in svg  # which many viewers of SVG files do not know
    assert "$" not in svg


def test_the_page_stands_alone() -> None:
    text = page(draw(PICTURE), PICTURE.title)
    assert "quick &amp; small" in text
    assert not re.search(r'(src|href)="(?!#)', text)
    assert "wheel" in text


def test_mermaid_text() -> None:
    assert (
        mermaid(PICTURE)
        == render(PICTURE, ".mmd")
        == """flowchart TD
  views["<b>views</b><br>data.blender<br>2.00 s · 3.0 MB"]
  end_["<b>end</b><br>evaluate<br>iterations 4 -&gt; 5"]
  subgraph rounds_block ["rounds ×4"]
    rounds_refine["<b>refine</b><br>stage1.refine<br>40.0 s"]
    rounds_uv["<b>uv</b><br>uv.maintain / uv.&lt;regen&gt;"]
  end
  views --> rounds_refine
  rounds_refine --> rounds_uv
  rounds_uv --> end_
  views --> end_
  rounds_uv -. next round .-> rounds_refine
  classDef changed stroke:#b7791f,stroke-width:3px
  classDef hit stroke:#7fa9b8
  classDef done stroke:#1f6f8b
  classDef failed stroke:#b3261e,stroke-width:3px
  class views hit
  class rounds_refine done
  class rounds_uv failed
  class end_ changed
"""
    )
