"""Graph files from strangers: nothing runs, nothing is read but what they name, and nothing grows without bound."""

from __future__ import annotations

import os
import tracemalloc
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.graph.language import wires
from exmesh_graph.graph.language.yamlfile import load_yaml, parse_yaml
from exmesh_graph.graph.problems import GraphErrors

DOUBLING = "".join(f", p{i}: '${{p{i - 1}}}${{p{i - 1}}}'" for i in range(1, 60))
LISTS = "".join(f", p{i}: ['${{p{i - 1}}}', '${{p{i - 1}}}']" for i in range(1, 60))


def nest(*counts: int, inner: str = "") -> str:
    """Blocks in blocks, by their rounds from the outside in."""
    for count in reversed(counts):
        inner = f"x: {{repeat: {count}, nodes: {{{inner}}}}}"
    return f"nodes: {{{inner}}}"


def refused(bench: Any, text: str, *, traced: bool = True) -> str:
    """The message; graphs that take more than 64 MiB of Python's memory to refuse are no good (slow to watch)."""
    if not traced:
        return "\n".join(map(str, bench.problems(text)))
    tracemalloc.start()
    try:
        shown = "\n".join(map(str, bench.problems(text)))
        assert tracemalloc.get_traced_memory()[1] < 64 << 20
    finally:
        tracemalloc.stop()
    return shown


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"params: {{p0: {'x' * 50}{DOUBLING}}}\nnodes: {{x: {{type: toy.const, label: '${{p59}}'}}}}", "grows beyond"),
        (f"params: {{p0: [1]{LISTS}}}\nnodes: {{x: {{type: toy.const}}}}", "grows beyond"),
        (f"params: {{p0: [1]{LISTS.replace('[', '{a: ', 1)}}}", "not YAML"),
        ("params: {a: '${b}', b: '${a}'}\nnodes: {x: {type: toy.const}}", "refer to each other"),
        ("params: {a: [1]}\nnodes: {x: {type: toy.const, label: 'x${a}'}}", "cannot be a part of a text"),
        ("a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
            f"{c}: &{c} [{', '.join(['*' + p] * 10)}]\n" for p, c in zip("abcdefgh", "bcdefghi", strict=True)
        ), "more than 100000 values"),
        ("a: &a {b: *a}", "contains itself"),
        ("a: " + "[" * 500, "nest deeper than 64 levels"),
        ("a0: &a0 [1]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}]\n" for i in range(1, 70)), "nest deeper than 64 levels"),
        ("a: " + "{b: " * 100 + "1" + "}" * 100, "nest deeper than 64 levels"),
        ("nodes: {x: {repeat: 1000000}}", "whole number from 0 to 1000"),
        (nest(1000, 10, inner="y: {type: toy.const}"), "more than 5000 nodes"),
        (nest(1000, 1000, 1000), "more than 10000 rounds"),
        ("nodes: {x: {type: toy.const}}\na: !!python/object/apply:os.system [ls]", "is not allowed"),
        ("nodes: !!set {a, b}", "is not allowed"),
        ("a: !!binary aGVsbG8=", "is not allowed"),
        ("%YAML 1.1\n---\nnodes: {x: {type: toy.const, label: no}}", "no directives"),
        ("# hello\n\n%TAG ! tag:x,2000:\n---\nnodes: {}", "no directives"),
        ("a: " + "9" * 6000, "cannot read the number"),
        ("nodes: {a: {type: toy.const, value: 0x" + "9" * 9000 + "}}", "needs more than 64 bits"),
        ('params: {n: {type: int, default: 1, doc: "\\e]0;title\\a"}}\nnodes: {}', "control characters"),
    ],
    ids=lambda value: value[:18],
)  # fmt: skip
@pytest.mark.reliability(
    "an untrusted graph file: bombs, huge repeats, code, endless or far files",
    "refused at once, with a message",
)
def test_bombs(bench: Any, text: str, words: str) -> None:
    assert words in refused(bench, text)


@pytest.mark.reliability(
    "an untrusted graph file: bombs, huge repeats, code, endless or far files",
    "refused at once, with a message",
)
def test_only_the_first_dangling_links_are_compared_with_all_nodes(bench: Any, monkeypatch: Any) -> None:
    compared = []
    monkeypatch.setattr(wires, "nearest", lambda name, names: compared.extend(names := list(names)) or names[:1])
    text = "\n".join(f'  n{k}: {{type: toy.step, state: "@m{k}.number", amount: 1}}' for k in range(400))
    problems = bench.problems(f"nodes:\n{text}\n")
    assert len(problems) == 400
    assert problems[0].nearest
    assert not problems[-1].nearest
    assert len(compared) <= 50 * 400


@pytest.mark.reliability(
    "an untrusted graph file: bombs, huge repeats, code, endless or far files",
    "refused at once, with a message",
)
def test_giant_files(bench: Any) -> None:
    assert "at most 256 KiB" in refused(bench, "a: 1\n" * ((1 << 18) // 5 + 1))
    assert parse_yaml("a: " + "x" * 200_000, None) == {"a": "x" * 200_000}


@pytest.mark.reliability(
    "an untrusted graph file: bombs, huge repeats, code, endless or far files",
    "refused at once, with a message",
)
def test_endless_files_are_not_read_to_their_end() -> None:
    with pytest.raises(GraphErrors, match="at most 256 KiB"):
        load_yaml(Path("/dev/zero"))


@pytest.mark.parametrize("key", ["extends: {0}", "nodes: {{x: {{graph: '{0}'}}}}"], ids=["extends", "graph"])
@pytest.mark.reliability(
    "an untrusted graph file: bombs, huge repeats, code, endless or far files",
    "refused at once, with a message",
)
def test_only_plain_files_are_named(bench: Any, key: str) -> None:
    os.mkfifo(bench.root / "pipe.yaml")  # reading it would wait for ever
    (bench.root / "dir.yaml").mkdir()
    for name in ("pipe.yaml", "dir.yaml", "/dev/zero", "gone.yaml"):
        assert "no such graph file" in refused(bench, key.format(name))


@pytest.mark.parametrize("key", ["extends: {0}", "nodes: {{x: {{graph: {0}}}}}"], ids=["extends", "graph"])
@pytest.mark.reliability(
    "an untrusted graph file: bombs, huge repeats, code, endless or far files",
    "refused at once, with a message",
)
def test_symlink_loops(bench: Any, key: str) -> None:
    (bench.root / "loop.yaml").symlink_to("loop.yaml")
    assert "no such graph file" in refused(bench, key.format("loop.yaml"))
    (bench.root / "again").symlink_to(".")  # ever longer names for one file
    assert "each other" in refused(bench, key.format("again/graph.yaml"))


@pytest.mark.reliability(
    "an untrusted graph file: bombs, huge repeats, code, endless or far files",
    "refused at once, with a message",
)
def test_long_chains_of_files(bench: Any) -> None:
    for index in range(50):
        bench.write(f"extends: e{index + 1}.yaml", f"e{index}.yaml")
        bench.write(f"nodes: {{x: {{graph: g{index + 1}.yaml}}}}", f"g{index}.yaml")
    assert "more than 32 files extend" in refused(bench, "extends: e0.yaml")
    assert "nest deeper than 16 files" in refused(bench, "nodes: {x: {graph: g0.yaml}}")


@pytest.mark.thorough
@pytest.mark.reliability(
    "an untrusted graph file: bombs, huge repeats, code, endless or far files",
    "refused at once, with a message",
)
def test_sub_graphs_that_multiply(bench: Any) -> None:
    """Ten files, each using the next ten times: 10^10 uses, none of them with a node."""
    for index in range(10):
        uses = ", ".join(f"x{i}: {{graph: m{index + 1}.yaml}}" for i in range(10))
        bench.write(f"nodes: {{{uses}}}", f"m{index}.yaml")
    bench.write("nodes: {x: {repeat: 0, carry: {}, next: {}, nodes: {}}}", "m10.yaml")
    assert "more than 10000 rounds and sub-graphs" in refused(bench, "nodes: {x: {graph: m0.yaml}}", traced=False)


@pytest.mark.thorough
@pytest.mark.reliability(
    "an untrusted graph file: bombs, huge repeats, code, endless or far files",
    "refused at once, with a message",
)
def test_long_lines_of_blocks(bench: Any) -> None:
    """Values handed through thousands of sub-graphs: an answer, not a crash."""
    bench.write('inputs: {x: Number}\nnodes: {c: {type: toy.const}}\noutputs: {y: "@inputs.x"}', "pass.yaml")
    uses = ["  p0: {graph: pass.yaml, x: '@one.number'}"]
    uses += [f"  p{i}: {{graph: pass.yaml, x: '@p{i - 1}.y'}}" for i in range(1, 600)]
    text = "nodes:\n  one: {type: toy.const}\n" + "\n".join(uses) + "\n  end: {type: toy.sign, number: '@p599.y'}\n"
    assert "pass through too many blocks or sub-graphs" in refused(bench, text, traced=False)


@pytest.mark.reliability(
    "an untrusted graph file: bombs, huge repeats, code, endless or far files",
    "refused at once, with a message",
)
def test_values_stay_text(bench: Any) -> None:
    """What looks like code is a text, or an error; `${...}` looks up names and nothing else."""
    text = "nodes: {x: {type: toy.const, label: \"{{''.__class__}} $(ls) `ls` __import__('os')\"}}"
    assert "__import__" in bench.check(text).nodes["x"].params.label
    assert "is not a parameter here" in refused(bench, "nodes: {x: {type: toy.const, label: '${x.__class__}'}}")


@pytest.mark.reliability(
    "an untrusted graph file: bombs, huge repeats, code, endless or far files",
    "refused at once, with a message",
)
def test_checking_reads_only_what_is_named(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every file opened below the working folder is the graph, what it extends and uses, or a named source."""
    import sys

    for name in ("secret.yaml", "other.txt"):
        bench.write("nodes: {x: {type: toy.const}}", name)
    bench.write("1.5", "number.txt")
    bench.write("nodes: {n: {type: toy.file, path: number.txt}}", "base.yaml")
    opened: set[str] = set()
    active = [True]

    def hook(event: str, args: tuple[Any, ...]) -> None:
        if active and event == "open" and str(args[0]).startswith(str(bench.root)):
            opened.add(os.path.relpath(args[0], bench.root))

    sys.addaudithook(hook)
    bench.check("extends: base.yaml")
    active.clear()
    assert opened <= {"graph.yaml", "base.yaml", "number.txt"}
    assert {"graph.yaml", "base.yaml"} <= opened
