"""Nodes and wire types of a script or a notebook cell: registered, checked, run here, cached by their source."""

from __future__ import annotations
import __future__

import itertools
import json
import linecache
import subprocess
import sys
import types
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.errors import GraphError
from exmesh_graph.graph.cache.fingerprint import fingerprint
from exmesh_graph.graph.declare.ports import artifact_types
from exmesh_graph.graph.problems import GraphErrors
from exmesh_graph.graph.run.backends.local import Local
from exmesh_graph.graph.run.rundir import RunFolder
from exmesh_graph.graph.run.runner import NodeFailed, Runner
from exmesh_graph.graph.session import Session
from exmesh_graph.report.reasons import explained as plan

CELL = """
import json
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from exmesh_graph.graph import Component, Context, Params, component, node, param
from exmesh_graph.types import Artifact

class Figure(Artifact):
    type_name = "CellFigure"
    def __init__(self, value): self.value = value
    def save(self, folder): (folder / "figure.json").write_text(json.dumps(self.value))
    @classmethod
    def load(cls, folder): return cls(json.loads((folder / "figure.json").read_text()))

class Out(NamedTuple):
    figure: Figure

class P(Params):
    size: float = param(2.0, doc="x")
"""
HELPER = "FACTOR = 10\ndef helper(x):\n    return x * FACTOR\n"
NODES = """
@node("cell.make", version="1")
def make(ctx: Context, *, p: P) -> Out:
    return Out(Figure(helper(p.size)))

@node("cell.add", version="1")
def add(ctx: Context, a: Figure, b: Figure) -> Out:
    return Out(Figure(a.value + b.value))
"""
GRAPH = """
name: g
nodes:
  a: {type: cell.make, size: 3}
  b: {type: cell.add, a: "@a.figure", b: "@a.figure"}
outputs: {b: "@b.figure"}
"""
count = itertools.count(1)


class Notebook:
    """A session whose `__main__` is filled cell by cell, as IPython does."""

    def __init__(self, folder: Path, main: types.ModuleType) -> None:
        self.folder, self.main, self.session = folder, main, Session([])
        self.flags = 0

    def cell(self, text: str) -> None:
        name = f"<ipython-input-{next(count)}-abc>"
        linecache.cache[name] = (len(text), None, text.splitlines(keepends=True), name)
        with self.session:
            exec(compile(text, name, "exec", self.flags, dont_inherit=True), vars(self.main))

    def digest(self, kind: str = "cell.make") -> str:
        with self.session:
            return fingerprint(self.session.types[kind]).digest

    def node(self, body: str, before: str = "") -> str:
        """The digest of a node with this body after this cell."""
        self.cell(before)
        self.cell(f'@node("cell.one", version="1")\ndef one(ctx: Context, *, p: P) -> Out:\n    {body}\n')
        return self.digest("cell.one")

    def run(self, text: str = GRAPH, backend: Any = None) -> tuple[dict[str, str], float, list[Any]]:
        (self.folder / "g.yaml").write_text(text)
        graph = self.session.check(self.folder / "g.yaml")
        folder, store, events = RunFolder(self.folder / "runs", "g"), self.session.open_store(self.folder / "store"), []
        try:
            record = Runner(graph, store, folder, events.append, backend=backend).run()
        finally:
            folder.close()
        with self.session:
            stored = record["nodes"][-1]["outputs"]["figure"]
            value: Any = store.load(artifact_types()[stored["type"]], stored["digest"])
        self.warnings = [text for row in record["nodes"] for text in row["warnings"]]
        return {row["name"]: row["state"] for row in record["nodes"]}, value.value, events


@pytest.fixture
def notebook(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Notebook:
    main = types.ModuleType("__main__")
    monkeypatch.setitem(sys.modules, "__main__", main)
    made = Notebook(tmp_path, main)
    for text in (CELL, HELPER, NODES):
        made.cell(text)
    return made


@pytest.mark.parametrize("flags", [0, __future__.annotations.compiler_flag])
def test_cells_run_and_are_hits(notebook: Notebook, flags: int) -> None:
    notebook.flags = flags  # `from __future__ import annotations` in one cell holds for all later ones
    for text in (CELL, HELPER, NODES):
        notebook.cell(text)
    assert notebook.run()[:2] == ({"a": "done", "b": "done"}, 60.0)
    assert notebook.run()[:2] == ({"a": "hit", "b": "hit"}, 60.0)
    for text in (CELL, HELPER, NODES):  # all cells run again: other objects of the same source
        notebook.cell("# a comment\n" + text)
    assert notebook.run()[:2] == ({"a": "hit", "b": "hit"}, 60.0)


@pytest.mark.thorough
def test_another_cell_changes_what_it_defines(notebook: Notebook) -> None:
    notebook.run()
    notebook.cell("def helper(x):\n    return x + FACTOR\n")
    assert notebook.run()[:2] == ({"a": "done", "b": "done"}, 26.0)
    notebook.cell("FACTOR = 20")
    assert notebook.run()[:2] == ({"a": "done", "b": "done"}, 46.0)
    notebook.cell(HELPER)
    assert notebook.run()[:2] == ({"a": "hit", "b": "hit"}, 60.0)
    notebook.cell(NODES.replace("a.value + b.value", "a.value - b.value"))
    assert notebook.run()[:2] == ({"a": "hit", "b": "done"}, 0.0)
    notebook.cell(NODES.replace("def make", "def make_it"))  # the same type under another function's name
    assert notebook.run()[1] == 60.0


def test_they_run_here_beside_workers_and_the_log_says_why(notebook: Notebook) -> None:
    states, value, events = notebook.run(backend=Local(1))
    assert (set(states.values()), value) == ({"done"}, 60.0)
    said = [event["node"] for event in events if "in the calling process" in event.get("message", "")]
    assert said == ["a", "b"]


def test_plan_says_which_part_changed(notebook: Notebook) -> None:
    notebook.run()
    notebook.cell("FACTOR = 20")
    steps = plan(
        notebook.session.check(notebook.folder / "g.yaml"), notebook.session.open_store(notebook.folder / "store")
    )
    assert steps[0].reason == "code changed: __main__:FACTOR"


MAKER = "def mk(n):\n    return lambda x: x + n\n"
WRAPS = """
from functools import wraps
def deco(f):
    @wraps(f)
    def inner(): return f() + 1
    return inner
@deco
"""
MANAGER = "from contextlib import contextmanager\n@contextmanager\ndef m():\n    "
CHANGES = [
    ("lambda", "f = lambda x: x + 1", "f = lambda x: x + 2", "f(1)"),
    ("lambda in a line", "f, g = lambda x: x, lambda x: -x", "g, f = lambda x: x, lambda x: -x", "f(1)"),
    ("lambda of a table", "F = {'a': lambda x: x}", "F = {'a': lambda x: -x}", "F['a'](1)"),
    ("lambda in a lambda", "f = lambda: lambda x: x", "f = lambda: lambda x: -x", "f()(1)"),
    ("closure", MAKER + "f = mk(1)", MAKER + "f = mk(2)", "f(1)"),
    ("closure of a table", MAKER + "f = mk([1])", MAKER + "f = mk([2])", "f(1)"),
    ("wrapper", WRAPS + "def g(): return 1", WRAPS + "def g(): return 2", "g()"),
    ("its decorator", WRAPS + "def g(): return 1", WRAPS.replace("+ 1", "+ 2") + "def g(): return 1", "g()"),
    ("library's wrapper", MANAGER + "yield 1", MANAGER + "yield 2", "m().__enter__()"),
    ("bound method", "class C:\n    n = 1\n    def f(self): return self.n\nc = C()\nf = c.f",
     "class C:\n    n = 1\n    def f(self): return self.n\nc = C()\nc.n = 2\nf = c.f", "f()"),
    ("default", "N = 1\ndef f(x, n=N): return x + n", "N = 2\ndef f(x, n=N): return x + n", "f(1)"),
    ("class attribute", "class C:\n    n = 1", "class C:\n    n = 2", "C.n"),
    ("method", "class C:\n    def n(self): return 1", "class C:\n    def n(self): return 2", "C().n()"),
    ("static method", "class C:\n    @staticmethod\n    def n(): return 1",
     "class C:\n    @staticmethod\n    def n(): return 2", "C.n()"),
    ("property", "class C:\n    @property\n    def n(self): return 1",
     "class C:\n    @property\n    def n(self): return 2", "C().n"),
    ("base class", "class B:\n    n = 1\nclass C(B): pass", "class B:\n    n = 2\nclass C(B): pass", "C.n"),
    ("set on a class", "class C:\n    n = 1", "class C:\n    n = 1\nC.n = 2", "C.n"),
    ("instance", "class C:\n    pass\nc = C()\nc.n = 1", "class C:\n    pass\nc = C()\nc.n = 2", "c.n"),
    ("dataclass", "@dataclass\nclass D:\n    n: int = 1", "@dataclass\nclass D:\n    n: int = 2", "D().n"),
    ("named tuple", "class T(NamedTuple):\n    n: int = 1", "class T(NamedTuple):\n    n: int = 2", "T().n"),
    ("enum", "import enum\nclass E(enum.Enum):\n    A = 1", "import enum\nclass E(enum.Enum):\n    A = 2",
     "E.A.value"),
    ("array", "import numpy as np\nA = np.ones(3)", "import numpy as np\nA = np.ones(3)\nA[1] = 2", "A.sum()"),
    ("array in a table", "import numpy as np\nT = {'a': [np.ones(3)]}", "import numpy as np\nT = {'a': [np.zeros(3)]}",
     "T['a'][0].sum()"),
    ("dtype", "import numpy as np\nA = np.ones(3, 'f4')", "import numpy as np\nA = np.ones(3)", "A.sum()"),
    ("set", "S = {'a', 'b'}", "S = {'a', 'c'}", "'b' in S"),
    ("number's type", "N = 1", "N = 1.0", "N"),
    ("partial", "from functools import partial\nf = partial(pow, 2)",
     "from functools import partial\nf = partial(pow, 3)", "f(2)"),
    ("cache", "from functools import lru_cache\n@lru_cache\ndef f(x): return x", "from functools import lru_cache\n"
     "@lru_cache\ndef f(x): return -x", "f(2)"),
    ("decorator", "def d(f): return f\n@d\ndef g(): return 1", "def d(f): return lambda: 2\n@d\ndef g(): return 1",
     "g()"),
    ("inner function", "def h(): return 1", "def h(): return 2", "[h() for _ in range(2)][0]"),
    ("shadowed builtin", "def sum(x): return 1", "def sum(x): return 2", "sum([])"),
    ("far helper", "def k(): return 1\ndef h(): return k()", "def k(): return 2\ndef h(): return k()",
     "h()"),
    ("recursion", "def h(n): return n and h(n - 1)", "def h(n): return n and h(n - 2)", "h(4)"),
    ("slots", "class C:\n    __slots__ = ('a',)\nX = C()\nX.a = 1",
     "class C:\n    __slots__ = ('a',)\nX = C()\nX.a = 2", "X.a"),
    ("named tuple's value", "class T(NamedTuple):\n    n: int\nX = T(1)",
     "class T(NamedTuple):\n    n: int\nX = T(2)", "X.n"),
    ("ordered", "from collections import OrderedDict\nX = OrderedDict(a=1)",
     "from collections import OrderedDict\nX = OrderedDict(a=2)", "X['a']"),
    ("defaultdict", "from collections import defaultdict\nX = defaultdict(int)",
     "from collections import defaultdict\nX = defaultdict(float)", "X['a']"),
    ("pattern", "import re\nX = re.compile('a')", "import re\nX = re.compile('a', re.I)", "bool(X.match('A'))"),
    ("numpy scalar", "import numpy as np\nX = np.float32(1)", "import numpy as np\nX = np.float32(2)", "X"),
    ("numpy function", "from numpy.linalg import norm as f", "from numpy.linalg import det as f", "f([[1.0]])"),
    ("dtype object", "import numpy as np\nX = np.dtype('f4')", "import numpy as np\nX = np.dtype('f8')", "X.itemsize"),
    ("model", "class Q(Params):\n    a: int = 1\nX = Q()", "class Q(Params):\n    a: int = 1\nX = Q(a=2)", "X.a"),
    ("random state", "import random\nX = random.Random(1)", "import random\nX = random.Random(2)", "X.random()"),
    ("hint", "X = list[int]", "X = list[float]", "str(X)"),
    ("union", "X = int | str", "X = int | float", "str(X)"),
    ("old union", "import typing\nX = typing.Optional[int]", "import typing\nX = typing.Optional[str]", "str(X)"),
    ("literal", "import typing\nX = typing.Literal['a']", "import typing\nX = typing.Literal['b']", "str(X)"),
    ("path", "F = Path('a')", "F = Path('b')", "str(F)"),
    ("imported name", "from math import sin as f", "from math import cos as f", "f(1)"),
    ("ufunc", "from numpy import sin as f", "from numpy import cos as f", "f(1)"),
]  # fmt: skip


@pytest.mark.thorough
@pytest.mark.parametrize(("before", "after", "body"), [row[1:] for row in CHANGES], ids=[row[0] for row in CHANGES])
def test_whatever_a_node_uses_counts(notebook: Notebook, before: str, after: str, body: str) -> None:
    body = f"return Out(Figure({body}))"
    first = notebook.node(body, before)
    assert notebook.node(body, before) == first  # other objects of equal contents
    assert notebook.node(body, after) != first
    assert notebook.node(body, before) == first


@pytest.mark.parametrize(
    ("cell", "what"),
    [
        ("import threading\nX = threading.Lock()", "X, a _thread.lock"),
        ("import numpy as np\nX = np.array([object()])", "X, a builtins.object"),
        ("X = {'a': open('/dev/null')}", r"X\['a'\], a _io.TextIOWrapper"),
        ("def g():\n    yield 1\nX = g()", "X, a builtins.generator"),
        ("class C(dict): pass\nclass D(C):\n    pass\nX = object()", "X, a builtins.object"),
    ],
)
def test_what_cannot_be_told_by_its_contents_is_refused(notebook: Notebook, cell: str, what: str) -> None:
    with pytest.raises(GraphError, match=what):
        notebook.node("return Out(Figure(bool(X)))", cell)


def test_hidden_names_are_refused(notebook: Notebook) -> None:
    for body in ("return Out(Figure(globals()['FACTOR']))", "return Out(Figure(eval('FACTOR')))"):
        with pytest.raises(GraphError, match="which hides what its result depends on"):
            notebook.node(body)


def test_names_that_are_local_or_only_spelled_do_not_count(notebook: Notebook) -> None:
    body = "unused = 3; return Out(Figure(unused + len('other')))"
    before = notebook.node(body, "unused, other = 1, 1")
    assert notebook.node(body, "unused, other = open('/dev/null'), 2") == before


def test_source_that_is_gone_is_refused(notebook: Notebook) -> None:
    with notebook.session:
        exec(compile(NODES, "<stdin>", "exec"), vars(notebook.main))
    with pytest.raises(GraphError, match="the source of make in <stdin> is not kept"):
        notebook.digest()


def test_a_node_that_changes_what_it_uses_is_not_remembered(notebook: Notebook) -> None:
    notebook.cell("SEEN = []")
    notebook.cell(NODES.replace("return Out(Figure(helper", "SEEN.append(1); return Out(Figure(helper"))
    assert notebook.run()[0]["a"] == "done"
    assert any("not remembered" in text for text in notebook.warnings)
    assert notebook.run()[0]["a"] == "done"


def test_a_node_that_changes_what_another_uses(notebook: Notebook) -> None:
    """Both are planned before either runs: what the second makes belongs to no key."""
    notebook.cell("N = 0")
    notebook.cell("""
@node("cell.one", version="1")
def one(ctx: Context, *, p: P) -> Out:
    global N
    N = 5
    return Out(Figure(1.0))
@node("cell.two", version="1")
def two(ctx: Context, *, p: P) -> Out:
    return Out(Figure(float(N)))
""")
    text = "nodes: {one: {type: cell.one}, two: {type: cell.two}}\noutputs: {a: '@one.figure', b: '@two.figure'}"
    assert notebook.run(text)[:2] == ({"one": "done", "two": "done"}, 5.0)
    notebook.cell("N = 0")
    states, value, _ = notebook.run(text)
    assert (states["two"], value) == ("done", 0.0)


def test_a_wire_type_that_was_defined_again(notebook: Notebook) -> None:
    """The value of an earlier run is read back as the class that stands now."""
    notebook.run()
    notebook.cell(CELL.replace("self.value = value", "self.value = value; self.more = 1"))
    notebook.cell(NODES)
    with notebook.session:
        assert artifact_types()["CellFigure"] is notebook.main.Figure
    assert notebook.run()[1] == 60.0


SCRIPT = (
    "import near\n"
    + CELL
    + HELPER.replace("x * FACTOR", "near.times(x, FACTOR)")
    + NODES
    + """
if __name__ == "__main__":
    from exmesh_graph.graph.run.backends.local import Local
    from exmesh_graph.graph.run.rundir import RunFolder
    from exmesh_graph.graph.run.runner import NodeFailed, Runner
    from exmesh_graph.graph.session import current_session
    session = current_session()
    graph = session.check("g.yaml")
    folder, store = RunFolder(Path("runs"), "g"), session.open_store("store")
    record = Runner(graph, store, folder, lambda e: None, backend=Local(1)).run()
    value = session.store.load(Figure, record["nodes"][-1]["outputs"]["figure"]["digest"]).value
    print(json.dumps([[row["state"] for row in record["nodes"]], value]))
"""
)


@pytest.mark.thorough
def test_a_script(tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_text(GRAPH)
    near, script = tmp_path / "near.py", tmp_path / "script.py"
    near.write_text("def times(a, b):\n    return a * b\n")
    script.write_text(SCRIPT)

    def run() -> Any:
        done = subprocess.run([sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    assert run() == [["done", "done"], 60.0]
    script.write_text(SCRIPT.replace('"r"', '"r2"').replace("print(", "print(end='', *[]) or print("))  # not the nodes
    assert run() == [["hit", "hit"], 60.0]
    near.write_text("def times(a, b):\n    return a * b + 1\n")  # a module beside the script
    assert run() == [["done", "done"], 62.0]


def test_a_wire_type_that_was_defined_again_for_one_node_only(notebook: Notebook) -> None:
    notebook.run()
    notebook.cell(CELL)
    notebook.cell(NODES.partition('@node("cell.add"')[0])
    with pytest.raises(GraphErrors, match="Figure was defined again: also run again what declares the two nodes"):
        notebook.session.check(notebook.folder / "g.yaml")
    notebook.cell(NODES)
    assert set(notebook.run()[0].values()) == {"hit"}


def test_a_module_of_yours_that_is_edited_and_reloaded(notebook: Notebook, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is still loaded as it was must not pass for what the file says now; nor a name taken from it before."""
    path = notebook.folder / "mine_near.py"
    path.write_text("def times(a):\n    return a * 2\n")
    monkeypatch.syspath_prepend(str(notebook.folder))
    cell = (
        '@node("cell.near", version="1")\ndef near(ctx: Context, *, p: P) -> Out:\n    return Out(Figure(%s(p.size)))\n'
    )
    text = "nodes: {one: {type: cell.near}}\noutputs: {a: '@one.figure'}"
    notebook.cell("import importlib, mine_near")
    notebook.cell(cell % "mine_near.times")
    assert notebook.run(text)[:2] == ({"one": "done"}, 4.0)
    assert notebook.run(text)[:2] == ({"one": "hit"}, 4.0)
    path.write_text("def times(a):\n    return a * 30\n")
    for _ in range(2):  # not reloaded: the old code runs, and what it makes belongs to no key
        assert notebook.run(text)[:2] == ({"one": "done"}, 4.0)
        assert any("not remembered" in text for text in notebook.warnings)
    notebook.cell("importlib.reload(mine_near)")
    assert notebook.run(text)[:2] == ({"one": "done"}, 60.0)
    assert notebook.run(text)[:2] == ({"one": "hit"}, 60.0)
    notebook.cell("from mine_near import times")
    notebook.cell(cell % "times")
    assert notebook.run(text)[:2] == ({"one": "done"}, 60.0)
    path.write_text("def times(a):\n    return a * 400\n")
    notebook.cell("importlib.reload(mine_near)")
    with pytest.raises(NodeFailed, match="times is not what the module mine_near calls so now"):
        notebook.run(text)
    notebook.cell("from mine_near import times")
    assert notebook.run(text)[:2] == ({"one": "done"}, 800.0)
    del sys.modules["mine_near"]


def test_a_pack_whose_helper_is_reloaded_alone(notebook: Notebook, monkeypatch: pytest.MonkeyPatch) -> None:
    """`from mine_low import times` in the pack still holds the old function."""
    low, pack = notebook.folder / "mine_low.py", notebook.folder / "mine_pack.py"
    low.write_text("def times(a):\n    return a * 2\n")
    pack.write_text(
        CELL.replace("CellFigure", "PackFigure") + "from mine_low import times\n" + NODES.replace("helper", "times")
    )
    monkeypatch.syspath_prepend(str(notebook.folder))
    notebook.session = Session(["mine_pack"])
    notebook.cell("import importlib, mine_pack, mine_low")
    text = "nodes: {a: {type: cell.make}}\noutputs: {a: '@a.figure'}"
    assert notebook.run(text)[:2] == ({"a": "done"}, 4.0)
    low.write_text("def times(a):\n    return a * 30\n")
    notebook.cell("importlib.reload(mine_low)")
    assert notebook.run(text)[1] == 4.0
    assert any("not remembered" in text for text in notebook.warnings)
    notebook.cell("importlib.reload(mine_pack)")
    assert notebook.run(text)[:2] == ({"a": "done"}, 60.0)
    assert notebook.run(text)[:2] == ({"a": "hit"}, 60.0)
    for name in ("mine_low", "mine_pack"):
        del sys.modules[name]


def test_an_interrupt_in_a_node_of_a_cell_stops_the_run(notebook: Notebook) -> None:
    notebook.cell(NODES.replace("return Out(Figure(a.value", "raise KeyboardInterrupt\n    return Out(Figure(a.value"))
    with pytest.raises(KeyboardInterrupt):
        notebook.run(backend=Local(1))
    notebook.cell(NODES)
    assert notebook.run(backend=Local(1))[:2] == ({"a": "hit", "b": "done"}, 60.0)


@pytest.mark.parametrize(
    "line", ["from mine_space.low import times", "from mine_space import low", "import mine_space.low"]
)
def test_modules_of_a_folder_without_init(notebook: Notebook, monkeypatch: pytest.MonkeyPatch, line: str) -> None:
    """A namespace package is as good a place for helpers as any other, for cells and for packs."""
    home = notebook.folder / "mine_space"
    home.mkdir()
    use = {"from mine_space.low import times": "times", "from mine_space import low": "low.times"}
    made = CELL + line + "\n" + NODES.replace("helper(", use.get(line, "mine_space.low.times") + "(")
    (home / "nodes.py").write_text(made)
    monkeypatch.syspath_prepend(str(notebook.folder))
    digests = []
    for factor in (2, 3):
        (home / "low.py").write_text(f"def times(a):\n    return a * {factor}\n")
        notebook.cell(made.replace("cell.", "other."))
        with Session(["mine_space.nodes"]) as session:
            digests.append([notebook.digest("other.make"), fingerprint(session.types["cell.make"]).digest])
        notebook.session.packs().parts.clear()
        for name in [name for name in sys.modules if name.startswith("mine_space")]:
            del sys.modules[name]
    assert not set(digests[0]) & set(digests[1])
