"""Holes that a third party's pack found: each is closed, refused with a message, or told."""

from __future__ import annotations

import importlib
import random
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from exmesh_graph import Session
from exmesh_graph.api import described
from exmesh_graph.api.planning import why_of
from exmesh_graph.errors import ExmeshError
from exmesh_graph.graph import sealed
from exmesh_graph.graph.cache import keys
from exmesh_graph.graph.cache.fingerprint import Sources
from exmesh_graph.graph.declare import packs
from exmesh_graph.graph.run import execute
from exmesh_graph.graph.run.backends.local import Local
from exmesh_graph.graph.run.plan import HIT, RUN
from exmesh_graph.graph.run.runner import NodeFailed
from exmesh_graph.report.reasons import explained as plan
from exmesh_graph.types import Metrics

HEAD = """
from __future__ import annotations
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple
import numpy as np
from exmesh_graph.graph import Component, Context, Params, component, node, param
from exmesh_graph.types import Artifact, Metrics
class Out(NamedTuple):
    metrics: Metrics
"""
Opened = Callable[..., Any]


@pytest.fixture
def pack(bench: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[Opened]:
    """Writes a pack `holes_pack` and gives a bench whose session has it."""
    monkeypatch.syspath_prepend(str(bench.root))
    entered: list[Session] = []

    def opened(text: str, **more: str) -> Any:
        folder = bench.root / "holes_pack"
        for name, words in {"__init__.py": "", "nodes.py": HEAD + text, **more}.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(words)
        importlib.invalidate_caches()
        entered.append(Session("holes_pack").__enter__())
        bench.packs = entered[0].packs()
        return bench

    yield opened
    for session in reversed(entered):
        session.__exit__()
    _forget()


def _forget() -> None:
    """The pack's modules, and what they declared, as in a process that never saw them."""
    for name in [name for name in sys.modules if name.partition(".")[0] == "holes_pack"]:
        del sys.modules[name]
        packs._declared.pop(name, None)


LOSSY = """
@dataclass
class {0}(Artifact):
    type_name: ClassVar[str] = "{0}"
    data: Any
    def save(self, folder):
        np.save(folder / "data.npy", {1})
    @classmethod
    def load(cls, folder):
        return cls(np.load(folder / "data.npy"))
class LossyOut(NamedTuple):
    made: {0}
class P(Params):
    kind: str = param("float64", doc="Of the array.")
@node("holes.lossy", version="1")
def lossy(ctx: Context, *, p: P) -> LossyOut:
    "Makes one."
    return LossyOut({0}(np.array([1 / 3, 2 / 3], p.kind)))
"""


@pytest.mark.reliability("a wire type whose save loses: float64 to float32", "its node fails by name, nothing recorded")
def test_a_save_that_loses_is_found(pack: Opened) -> None:
    bench = pack(LOSSY.format("Lossy", 'self.data.astype("float32")'))
    text = "nodes: {{a: {{type: holes.lossy, kind: {}}}}}"
    with pytest.raises(NodeFailed, match=r"Lossy loses on the way to its files and back: float64 \[2\]"):
        bench.run(text.format("float64"))
    assert list((bench.store.root / "actions").glob("*/*")) == []
    assert bench.run(text.format("float32"))["state"] == "done"


def test_values_come_back_in_other_order_and_in_tuples(bench: Any, packs: Any) -> None:
    from exmesh_graph.types.contents import losses

    assert losses(Metrics({"b": [1, 2.5], "a": (None, True)}), Metrics({"a": [None, True], "b": [1, 2.5]}))[0] == []
    assert losses(Metrics({"a": 1}), Metrics({"a": 1.0}))[0] == ["1"]
    assert losses(Metrics({1: 2}), Metrics({"1": 2}))[0] == ["1"]
    assert losses(Metrics({"a": [1, 2]}), Metrics({"a": [1, 2]})) == ([], True)
    row = [1, 2]  # in two places
    assert losses(Metrics({"a": [row, row]}), Metrics({"a": [[1, 2], [1, 2]]})) == ([], False)
    for again in ({"a": [2, 1]}, {"a": (1, 2)}):
        assert losses(Metrics({"a": [1, 2]}), Metrics(again)) == ([], False), again


SHAPE = """
class Shape(Artifact):
    type_name: ClassVar[str] = "holes.Shape"
    def area(self): raise NotImplementedError
class ShapeOut(NamedTuple):
    out: Shape
@node("holes.area", version="1")
def area(ctx: Context, x: Shape) -> Out:
    "Measures it."
    return Out(Metrics({"area": x.area()}))
"""
SQUARE = """
from typing import ClassVar, NamedTuple
from exmesh_graph.graph import Context, node
import holes_pack.nodes as base
class Square(base.Shape):
    type_name: ClassVar[str] = "holes.Square"
    def save(self, folder): (folder / "side").write_text("3")
    @classmethod
    def load(cls, folder): return cls()
    def area(self): return 3 ** %d
class SquareOut(NamedTuple):
    out: Square
@node("holes.square", version="1")
def square(ctx: Context) -> SquareOut:
    "Makes one."
    return SquareOut(Square())
"""
AREA = "nodes:\n  a: {type: holes.square}\n  b: {type: holes.area, x: '@a.out'}\n"


@pytest.mark.reliability("a method edited of a wire type that a port takes as its base", "runs again")
def test_a_method_of_a_type_that_a_port_takes_as_its_base(pack: Opened, monkeypatch: pytest.MonkeyPatch) -> None:
    areas = []
    for power in (2, 10):
        _forget()
        bench = pack(SHAPE, **{"square.py": SQUARE % power})
        reasons = {step.name: step.reason for step in plan(bench.check(AREA), bench.store)}
        areas.append(bench.value(bench.run(AREA), "b", "metrics").values["area"])
    assert areas == [9, 59049]
    assert why_of(bench.check(AREA), "b", bench.store).depends_on["kinds"] == ["holes.Square"]
    assert {row["state"] for row in bench.run(AREA)["nodes"]} == {"hit"}
    for name, value in (("kinds", {"holes.Square": "e" * 64}), ("libraries", {"numpy": "0.1"})):
        other = {name: value}  # a worker that loaded other code, or libraries, than the run was planned with
        with monkeypatch.context() as patched:
            patched.setattr(execute, "preimage_of", lambda *given, other=other: {**keys.preimage_of(*given), **other})
            row = bench.run(AREA, force={"b"})["nodes"][1]
            assert "its code changed during the run (since the run was planned)" in row["warnings"][0]
    (bench.root / "holes_pack/square.py").write_text(SQUARE % 3)  # edited, not loaded anew
    bench.packs.part(Sources).refresh()
    for _ in range(2):
        rows = {row["name"]: row for row in bench.run(AREA)["nodes"]}
        assert rows["b"]["state"] == "done"
        assert "not remembered: its code changed" in rows["b"]["warnings"][0]
    assert reasons["a"].startswith("code changed")


FILES = """
from pathlib import Path
class P(Params):
    u: Path | None = param(None, doc="A file.")
    v: Path | None = param(None, doc="Another.")
    more: list[Path] = param([], doc="More.")
    by: dict[str, Path] = param({}, doc="By name.")
def listed(p):
    paths = [path for path in (p.u, p.v, *p.more, *p.by.values()) if path]
    return {f.name: f for path in paths for f in (path.iterdir() if path.is_dir() else [path])}
@node("holes.files", version="1", sources=listed)
def files(ctx: Context, *, p: P) -> Out:
    "What is in which."
    def of(path):
        return path and (sorted(f.read_text() for f in path.iterdir()) if path.is_dir() else path.read_text())
    return Out(Metrics({"v": [of(p.u), of(p.v), [of(x) for x in p.more], {k: of(x) for k, x in p.by.items()}]}))
class One(Params):
    path: Path = param(..., doc="One of a folder.")
@node("holes.one", version="1", sources=lambda p: {f.name: f for f in p.path.parent.iterdir()})
def one(ctx: Context, *, p: One) -> Out:
    "One of several files that are all listed."
    return Out(Metrics({"v": p.path.read_text()}))
class Two(Params):
    u: Path = param(..., doc="A file.")
    v: Path = param(..., doc="Another.")
@node("holes.last", version="1", sources=lambda p: {f.name: f for f in (p.u, p.v)})
def last(ctx: Context, *, p: Two) -> Out:
    "Two files of one name, of which the last alone is listed."
    return Out(Metrics({"v": [p.u.read_text(), p.v.read_text()]}))
"""
ROLES = [
    ("files", "u: a.txt", "v: a.txt"),
    ("files", "u: a.txt, v: b.txt", "u: b.txt, v: a.txt"),
    ("files", "more: [a.txt, b.txt]", "more: [b.txt, a.txt]"),
    ("files", "more: [a.txt]", "more: [a.txt, a.txt]"),
    ("files", "by: {k: a.txt, l: b.txt}", "by: {k: b.txt, l: a.txt}"),
    ("files", "u: one, v: two", "u: two, v: one"),
    ("files", "u: none", "v: none"),
    ("one", "path: one/1.txt", "path: one/2.txt"),
    ("last", "u: one/1.txt, v: four/1.txt", "u: three/1.txt, v: four/1.txt"),
]


@pytest.mark.reliability("the same files in another order, or in another path parameter", "another key")
@pytest.mark.parametrize(("kind", "before", "after"), ROLES)
def test_which_path_holds_which_file(pack: Opened, kind: str, before: str, after: str) -> None:
    bench = pack(FILES)
    for name in ("a.txt", "b.txt", "one/1.txt", "one/2.txt", "two/3.txt", "three/1.txt", "four/1.txt"):
        (bench.root / name).parent.mkdir(exist_ok=True)
        (bench.root / name).write_text(name)
    (bench.root / "none").mkdir()
    values = []
    for given in (before, after):
        text = f"nodes: {{a: {{type: holes.{kind}, {given}}}}}"
        values.append(bench.value(bench.run(text), "a", "metrics").values["v"])
        assert bench.run(text)["nodes"][0]["state"] == "hit"
    assert values[0] != values[1]


BACK = """
class P(Params):
    path: Path = param(..., doc="A file.")
@node("holes.back", version="1", sources=lambda p: {"path": p.path})
def back(ctx: Context, *, p: P) -> Out:
    "Reads what somebody wrote meanwhile, and took back."
    before = p.path.read_text()
    p.path.write_text("other")
    found = p.path.read_text()
    p.path.write_text(before)
    return Out(Metrics({"v": found}))
class Q(Params):
    late: str = param(..., doc="A module's file.")
@node("holes.late", version="1")
def late(ctx: Context, *, p: Q) -> Out:
    "Imports what somebody wrote meanwhile, and took back."
    file, before = Path(p.late), Path(p.late).read_text()
    file.write_text("W = 2000")
    import holes_late
    file.write_text(before)
    return Out(Metrics({"v": holes_late.W}))
"""


@pytest.mark.reliability("a file or module is edited while a node runs, and put back before it ends", "not remembered")
@pytest.mark.parametrize(("kind", "given"), [("back", "path: file.txt"), ("late", "late: {root}/holes_late.py")])
def test_what_is_there_and_back_again(pack: Opened, kind: str, given: str, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = pack(BACK)
    (bench.root / "file.txt").write_text("own")
    (bench.root / "holes_late.py").write_text("W = 1")
    monkeypatch.delitem(sys.modules, "holes_late", raising=False)
    text = f"nodes: {{a: {{type: holes.{kind}, {given.format(root=bench.root)}}}}}"
    assert "not remembered" in bench.run(text)["nodes"][0]["warnings"][0]
    assert bench.run(text)["nodes"][0]["state"] == "done"
    monkeypatch.delitem(sys.modules, "holes_late", raising=False)


DRAWS = """
class P(Params):
    number: int = param(0, doc="Which.")
@node("holes.draws", version="1")
def draws(ctx: Context, *, p: P) -> Out:
    "From the global generator, slowly."
    import random, time
    found = []
    for _ in range(5):
        found.append(random.random())
        time.sleep(0.01)
    return Out(Metrics({"v": found}))
"""


@pytest.mark.reliability("runs in two threads of one process, whose nodes draw from global generators", "as if alone")
def test_two_threads_draw_each_its_own(pack: Opened) -> None:
    bench = pack(DRAWS)
    text = "nodes: {{a: {{type: holes.draws, number: {0}, seed: {0}}}}}"
    values = {}

    def run(number: int) -> None:
        root = bench.root / str(number)
        root.mkdir()
        own = type(bench)(root, bench.packs)
        values[number] = own.value(own.run(text.format(number)), "a", "metrics").values["v"]

    threads = [threading.Thread(target=run, args=(number,)) for number in (1, 2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    bound = bench.check(text.format(1)).nodes["a"], bench.check(text.format(2)).nodes["a"]
    for number, one in enumerate(bound, 1):
        dice = random.Random(one.seed)
        assert values[number] == [dice.random() for _ in range(5)]


MAPS = """
class P(Params):
    table: dict[str, int] = param({}, doc="Names.")
@component("holes.table", version="1")
class Table(Component):
    "Names of its own."
    table: dict[str, int] = param({}, doc="Names.")
@node("holes.names", version="1")
def names(ctx: Context, plug: Table, *, p: P) -> Out:
    "In the order that the node sees."
    return Out(Metrics({"names": [*p.table, *plug.table]}))
"""


@pytest.mark.reliability("the order in which a file writes a map of values", "no node sees it")
def test_the_order_of_a_map_is_not_seen(pack: Opened) -> None:
    bench = pack(MAPS)
    for table in ("{b: 1, a: 2}", "{a: 2, b: 1}"):
        text = (
            f"nodes: {{c: {{type: holes.table, table: {table}}}, a: {{type: holes.names, table: {table}, plug: '@c'}}}}"
        )
        assert bench.value(bench.run(text), "a", "metrics").values["names"] == ["a", "b", "a", "b"]


ROWS = """
import json
class Salt(Params):
    salt: int = param(1, doc="Nothing.")
@dataclass(frozen=True, eq=False)
class Rows(Artifact):
    type_name: ClassVar[str] = "holes.Rows"
    rows: Any = None
    def save(self, folder):
        (folder / "x.json").write_text(json.dumps(SAVED, sort_keys=True))
    @classmethod
    def load(cls, folder):
        return cls(json.loads((folder / "x.json").read_text()))
class Made(NamedTuple):
    rows: Rows
@node("holes.rows", version="1")
def rows(ctx: Context) -> Made:
    "Rows."
    return Made(Rows(VALUE))
@node("holes.read", version="1")
def read(ctx: Context, rows: Rows, *, p: Salt) -> Out:
    "What it gets."
    return Out(Metrics({"first": list(rows.rows)[:9], "kind": type(rows.rows).__name__}))
"""


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("value", "saved"),
    [
        ("{'b': 1, 'a': 2}", "self.rows"),
        ("[3, 1, 2]", "sorted(self.rows)"),
        ("(1, 2)", "self.rows"),
        ("[(j + ctx.seed) % 7 for j in range(40000)]", "sorted(self.rows)"),
    ],
    ids=["order of a dict", "a sorted list", "a tuple", "a large one"],
)
@pytest.mark.reliability(
    "a wire type that comes back in another order or in other containers", "in memory it is what the store gives"
)
def test_a_value_in_memory_is_what_the_store_gives(pack: Opened, value: str, saved: str) -> None:
    bench = pack(ROWS.replace("VALUE", value).replace("SAVED", saved))
    text = """
nodes:
  first: {{type: holes.rows}}
  second: {{type: holes.rows, seed: 5}}
  a: {{type: holes.read, rows: "@first.rows", salt: {0}}}
  b: {{type: holes.read, rows: "@second.rows", salt: {0}}}
"""
    in_memory, stored = (bench.run(text.format(salt)) for salt in (1, 2))
    for name in ("a", "b"):
        values = [bench.value(record, name, "metrics").values for record in (in_memory, stored)]
        assert values[0] == values[1]


@pytest.mark.reliability("a node spoils json in its worker", "it is one failed node; the run does not wait for ever")
@pytest.mark.parametrize(
    "how",
    [
        "json.JSONEncoder.item_separator = json.JSONEncoder.key_separator = ';'",
        "json.dumps = lambda *_, **__: 'nothing'",
        "json.encoder.c_make_encoder = None; json.JSONEncoder.encode = lambda *_: 'nothing'",
    ],
)
def test_a_node_that_spoils_json_is_one_failed_node(pack: Opened, how: str) -> None:
    bench = pack(f"""
@node("holes.spoils", version="1")
def spoils(ctx: Context) -> Out:
    "What it says cannot be read."
    import json
    {how}
    return Out(Metrics({{"a": 1, "b": 2}}))
""")
    with pytest.raises(NodeFailed) as caught:
        bench.run("nodes: {a: {type: holes.spoils, limits: {seconds: 30}}}", backend=Local(1))
    assert "limit" not in str(caught.value)
    assert list((bench.store.root / "actions").glob("*/*")) == []


@pytest.mark.reliability("a node reads its name in the graph", "it gets what its key holds: its type")
def test_the_name_in_the_graph_changes_no_result(pack: Opened) -> None:
    bench = pack("""
@node("holes.named", version="1")
def named(ctx: Context) -> Out:
    "Its name."
    return Out(Metrics({"name": ctx.node}))
""")
    record = bench.run("nodes: {a: {type: holes.named}, b: {type: holes.named}}")
    assert [bench.value(record, name, "metrics").values for name in "ab"] == [{"name": "holes.named"}] * 2


ANY = """
class P(Params):
    value: Any = param(None, doc="Anything.")
@node("holes.any", version="1")
def any_(ctx: Context, *, p: P) -> Out:
    "Says what it got."
    return Out(Metrics({"got": repr(p.value)}))
"""


@pytest.mark.parametrize("value", [".nan", ".inf", "-.inf", "[1, {a: .nan}]"])
@pytest.mark.reliability("nan and infinities in a parameter that takes anything", "refused by `check`")
def test_numbers_that_are_none(pack: Opened, value: str) -> None:
    """They reached the node as None."""
    bench = pack(ANY)
    (problem,) = bench.problems(f"nodes: {{a: {{type: holes.any, value: {value}}}}}")
    assert "a: value: infinities and nan are no values" in problem.what
    record = bench.run("nodes: {a: {type: holes.any, value: [1.5, {a: 2}]}}")
    assert bench.value(record, "a", "metrics").values == {"got": "[1.5, {'a': 2}]"}


@pytest.mark.reliability("records and objects of another version's format", "left alone, told as such, made again")
def test_what_another_version_wrote_stays(bench: Any) -> None:
    text = "nodes: {a: {type: toy.const, value: 5}}"
    record = bench.run(text)
    key, digest = record["nodes"][0]["key"], record["nodes"][0]["outputs"]["number"]["digest"]
    note = bench.store.data(digest).parent / "artifact.json"
    action = bench.root / "store" / "actions" / key[:2] / f"{key}.json"
    for moved, path in enumerate((note, action)):  # the object is put aside when its node writes it again
        path.chmod(0o644)
        path.write_text(sealed.seal_text({**sealed.read_sealed(path), "format": keys.FORMAT + 1}))
        store = bench.store
        (step,) = plan(bench.check(text), store)
        assert step.state == RUN
        assert all("left alone: another version of exmesh-graph wrote it (format 2" in said for said in store.notes)
        assert store.notes
        assert path.is_file()
        assert len(list((store.root / "quarantine").glob("*"))) == moved
        assert bench.run(text)["state"] == "done"
        assert plan(bench.check(text), bench.store)[0].state == HIT


@pytest.mark.reliability("a node type that a function makes", "refused by `check`: no key can tell its code")
def test_a_node_made_by_a_factory(pack: Opened) -> None:
    bench = pack("""
def make(n):
    @node(f"holes.made{n}", version="1")
    def made(ctx: Context) -> Out:
        "Made."
        return Out(Metrics({"n": n}))
make(1)
""")
    (problem,) = bench.problems("nodes: {a: {type: holes.made1}}")
    assert "make.<locals>.made is made inside a function" in problem.what


def test_a_package_without_a_file_below_a_pack(pack: Opened) -> None:
    """A namespace sub-package: its nodes run, and its code is in the key."""
    bench = pack(
        """
from holes_pack.deep.inner import answer
import holes_pack.deep
@node("holes.deep", version="1")
def deep(ctx: Context) -> Out:
    "By a package without a file."
    return Out(Metrics({"n": answer()}))
""",
        **{"deep/inner.py": "from . import other\ndef answer():\n    return other.N\n", "deep/other.py": "N = 7\n"},
    )
    record = bench.run("nodes: {a: {type: holes.deep}}")
    assert bench.value(record, "a", "metrics").values == {"n": 7}
    parts = bench.store.read(next((bench.root / "store" / "actions").glob("*/*.json"))).info["code_parts"]
    assert {"holes_pack.deep.inner", "holes_pack.deep.other"} <= set(parts)


@pytest.mark.parametrize("name", ["logs", "failures"])
def test_outputs_called_like_what_a_run_keeps(bench: Any, name: str) -> None:
    text = 'nodes: {a: {type: toy.const}}\noutputs: {%s: "@a.number"}'
    (problem,) = bench.problems(text % name)
    assert "a run keeps its own files there" in problem.what


def test_a_type_declared_wrongly_is_listed_as_such(pack: Opened) -> None:
    pack("""
@node("holes.right", version="1")
def right(ctx: Context) -> Out:
    "Right."
@node("holes.wrong", version="1")
def wrong(ctx: Context, number) -> Out:
    "No annotation."
""")
    assert "holes.right" in described.node_types()
    assert "holes.wrong" not in described.node_types()
    assert "is declared wrongly: wrong: number has no annotation" in described.broken()["holes.wrong"]
    assert described.as_json([])["broken"] == described.broken()
    with pytest.raises(ExmeshError, match=r"holes\.wrong is declared wrongly"):
        described.describe("holes.wrong")


@pytest.mark.parametrize("how", ["extends: {0}", "nodes: {{x: {{graph: '{0}'}}}}"], ids=["extends", "graph"])
@pytest.mark.reliability(
    "an untrusted graph file: bombs, huge repeats, code, endless or far files", "refused at once, with a message"
)
def test_files_that_are_no_graphs_are_not_shown(bench: Any, how: str) -> None:
    """By a name of their own, or behind one that looks like a graph's."""
    secret = bench.root / "shadow"
    secret.write_text("root: $6$secret\nparams: hidden\n")
    (bench.root / "link.yaml").symlink_to(secret)
    for name in (str(secret), "link.yaml"):
        text = "\n".join(map(str, bench.problems(how.format(name))))
        assert "is not the name of a graph file" in text
        assert "secret" not in text
        assert "hidden" not in text
        assert "root" not in text.replace(str(bench.root), "")


def test_writing_that_is_turned_round_is_refused(bench: Any) -> None:
    (problem,) = bench.problems('nodes: {a: {type: toy.const, label: "a\\u202Eb"}}')
    assert "control characters" in problem.what


BLOCK = """
nodes:
  n: {type: toy.const, value: 1}
  rounds:
    repeat: 2
    carry: {state: "@n.number"}
    nodes: {up: {type: toy.step, state: "@carry.state"}}
    next: {state: "@up.state"}
  last: {type: toy.step, state: "@rounds.state"}
variants: {v: [%s]}
"""


def test_what_is_said_of_a_block_that_cannot_be_removed(bench: Any) -> None:
    """The patch that is suggested is one that is taken."""
    from exmesh_graph.graph.variants.checked import check_variant

    with pytest.raises(ExmeshError) as caught:
        check_variant(bench.write(BLOCK % "{remove: rounds}"), (), bench.packs, "v")
    assert "fix: {set: rounds.repeat, to: 0}" in str(caught.value)
    graph = check_variant(bench.write(BLOCK % "{set: rounds.repeat, to: 0}"), (), bench.packs, "v")
    assert set(graph.nodes) == {"n", "last"}


def test_a_round_that_is_not_quoted_in_braces(bench: Any) -> None:
    (problem,) = bench.problems(BLOCK % "{set: rounds[1].up.amount, to: 5}")
    assert "not YAML" in problem.what
    assert 'names with brackets are quoted: {set: "rounds[1].' in problem.fix


@pytest.mark.thorough
def test_check_of_many_dangling_links_is_linear(bench: Any) -> None:
    """Twice the nodes take about twice the work."""
    import cProfile
    import pstats

    def calls(count: int) -> int:
        text = "\n".join(
            f'  n{k}: {{type: toy.step, state: "@m{k}.number", next: "@x.y", amount: 1}}' for k in range(count)
        )
        profile = cProfile.Profile()
        profile.enable()
        bench.problems(f"nodes:\n{text}\n")
        profile.disable()
        return sum(row[0] for row in pstats.Stats(profile).stats.values())  # type: ignore[attr-defined]

    assert calls(400) < 2.5 * calls(200)
