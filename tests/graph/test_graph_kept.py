"""What code keeps from call to call, and what is changed while modules are imported: told, or in the key."""

from __future__ import annotations

import ast
import importlib
import sys
import types
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from exmesh_graph.api.reach import looked_at
from exmesh_graph.api.unseen import unseen
from exmesh_graph.graph.cache import fingerprint as fp
from exmesh_graph.graph.declare.node import NodeDef
from exmesh_graph.graph.declare.packs import current
from exmesh_graph.types import Artifact
from exmesh_graph.types.contents import mark_of

KEPT = {
    "N = 0\ndef f(k):\n    global N\n    N += k": True,
    "N = 0\ndef f(k):\n    global N\n    return N": False,
    "T = []\ndef f(k):\n    T.append(k)": True,
    "T = {}\ndef f(k):\n    T['k'] = k": True,
    "T = {}\ndef f(k):\n    T = {}\n    T['k'] = k": False,
    "T = {}\ndef f(T):\n    T['k'] = 1": False,
    "T = {}\ndef f(k):\n    t = T\n    t['k'] = k": True,
    "T = {}\ndef f(k):\n    t = T.copy()\n    t['k'] = k": False,
    "T = [{}]\ndef f(k):\n    for t in T:\n        t['k'] = k": True,
    "T = {}\ndef table():\n    return T\ndef f(k):\n    table()['k'] = k": True,
    "T = {}\ndef put(t, k):\n    t['k'] = k\ndef f(k):\n    put(T, k)": True,
    "class H:\n    k = 0\ndef f(k):\n    H.k = k": True,
    "class H:\n    def put(self, k):\n        type(self).k = k": True,
    "class H:\n    @classmethod\n    def put(cls, k):\n        cls.k = k": True,
    "class H:\n    def put(self, k):\n        self.k = k": False,
    "class H:\n    def put(self, k):\n        self.k = k\nONE = H()\ndef f(k):\n    ONE.put(k)": True,
    "def f(k):\n    f.k = k": True,
    "def f(k, kept=[]):\n    kept.append(k)": True,
    "def f(k, kept=()):\n    return kept": False,
    "import math\ndef f(k):\n    math.pi = k": True,
    "def f(k):\n    import math\n    setattr(math, 'pi', k)": True,
    "import heapq\nT = []\ndef f(k):\n    heapq.heappush(T, k)": True,
    "import numpy as np\nT = np.zeros(3)\ndef f(k):\n    np.add(1, k, out=T)": True,
    "import numpy as np\nR = np.random.default_rng(5)\ndef f():\n    return R.random()": True,
    "import numpy as np\ndef f():\n    return np.random.default_rng(5).random()": False,
    "import itertools\nIDS = itertools.count()\ndef f():\n    return next(IDS)": True,
    "def make():\n    n = 0\n    def f():\n        nonlocal n\n        n += 1\n    return f\nF = make()": True,
    "def make():\n    n = 0\n    def f():\n        nonlocal n\n        n += 1\n    return f()": False,
    "import functools\n@functools.cache\ndef rows():\n    return []\ndef f(k):\n    rows().append(k)": True,
    "import logging\ndef f(k):\n    logging.getLogger('x').kept = k": True,
    "T = {}\ndef f(k):\n    T['k'] = k  # not in the key: a cache": False,
}


@pytest.mark.parametrize("code", KEPT)
@pytest.mark.reliability("code keeps something from call to call", "told as not in the key")
def test_what_functions_keep_is_found(code: str) -> None:
    found = looked_at(ast.parse(code), code.splitlines(), "some_pack")["keeps"]
    assert bool(found) is KEPT[code], found
    assert all("from call to call" in words for _, words, _ in found)


NODE = """
from kept_pack import tools, table
from kept_pack.table import TABLE
LIMIT = 1
ROWS = [{"k": 1}]
def same(n):
    return lambda f: f
def set_limit(n):
    global LIMIT
    LIMIT = n
def first(ctx):
    return LIMIT, ROWS, TABLE, tools.get()
"""
FILES = {
    "__init__.py": "",
    "table.py": "TABLE = {}\ndef add(f):\n    TABLE[f.__name__] = f\n    return f\n"
    "class Base:\n    found = []\n    def __init_subclass__(cls):\n        Base.found.append(cls)\n",
    "tools.py": "K = 1\ndef get():\n    return K\n",
    "near.py": "from kept_pack import tools\ndef f():\n    return 5\n",
    "far.py": "def g():\n    return 6\n",
}


@pytest.fixture
def pack(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    root = tmp_path / "kept_pack"
    root.mkdir()
    for name, text in {**FILES, "nodes.py": NODE}.items():
        (root / name).write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    importlib.invalidate_caches()
    yield root
    for name in [name for name in sys.modules if name.partition(".")[0] == "kept_pack"]:
        del sys.modules[name]
    current().parts.pop(fp.Sources, None)


def taken() -> NodeDef:
    current().parts.pop(fp.Sources, None)
    return NodeDef("t", types.FunctionType((lambda: None).__code__, {"__name__": "kept_pack.nodes"}, "first"), "1")


@pytest.mark.reliability("a file of the user's own that hides a module of Python's", "its text is in the key")
def test_a_module_named_as_one_of_pythons(pack: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "tabnanny", raising=False)
    (pack / "nodes.py").write_text("import tabnanny\ndef first(ctx):\n    return tabnanny.check('x')\n")
    digests = [fp.fingerprint(taken()).digest]
    for value in (1, 2):
        (pack.parent / "tabnanny.py").write_text(f"def check(name):\n    return {value}\n")
        importlib.invalidate_caches()
        digests.append(fp.fingerprint(taken()).digest)
    assert len(set(digests)) == 3


RE_EXPORTS = [  # the texts that functions stand in are the same before and after
    ("from kept_pack.far import g\n", "from kept_pack.far import h as g\n"),
    ("from kept_pack.far import g, h\n", "from kept_pack.far import g as h, h as g\n"),
    ("from kept_pack.more import g\n", "from kept_pack.more import h as g\n"),
    ("from math import sin as g\n", "from math import cos as g\n"),
    ("from kept_pack.far import g as tools\n", "from kept_pack.far import h as tools\n"),
]


@pytest.mark.reliability("another function is chosen under a name that a package only re-exports", "another key")
@pytest.mark.parametrize(("one", "two"), RE_EXPORTS)
def test_what_is_re_exported_is_in_the_key(pack: Path, one: str, two: str) -> None:
    (pack / "far.py").write_text("def g():\n    return 6\ndef h():\n    return 7\n")
    (pack / "more.py").write_text("from kept_pack.far import g, h\n")
    (pack / "api").mkdir()
    (pack / "api/tools.py").write_text("")
    name = "tools" if "tools" in one else "g"
    (pack / "nodes.py").write_text(f"from kept_pack.api import {name}\ndef first(ctx):\n    return {name}()\n")
    digests = []
    for text in (one, two):
        (pack / "api/__init__.py").write_text(text)
        digests.append(fp.fingerprint(taken()).digest)
    assert digests[0] != digests[1]


@pytest.mark.parametrize(
    "line",
    [
        "def other(x=(LIMIT := 301)):\n    pass",
        "@same(LIMIT := 301)\ndef other():\n    pass",
        "class Extra:\n    ROWS[0]['k'] = 301",
        "class Extra:\n    global LIMIT\n    LIMIT = 301",
        "ALIAS = ROWS[0]\nALIAS['k'] = 301",
        "ALIAS = ROWS\nALIAS += [301]",
        "for row in ROWS:\n    row['k'] = 301",
        "for one in (first, same):\n    one.limit = 301",
        "_x = list(map(set_limit, [301]))",
        "_x = dict.update(ROWS[0], k=301)",
        "_x = setattr(tools, 'K', 301)",
    ],
)
@pytest.mark.reliability("a module changes what has another name, in a loop, a class, a default", "another key")
def test_what_a_module_does_to_others_is_in_the_key(pack: Path, line: str) -> None:
    (pack / "nodes.py").write_text(f"{NODE}{line}\n")
    before = fp.fingerprint(taken()).digest
    (pack / "nodes.py").write_text(f"{NODE}{line.replace('301', '302')}\n")
    assert fp.fingerprint(taken()).digest != before


def test_a_package_that_calls_while_it_re_exports(pack: Path) -> None:
    text = "from kept_pack.tools import get\n__begun__ = get({})\n"
    (pack / "__init__.py").write_text(text.format(1))
    before = fp.fingerprint(taken()).digest
    (pack / "__init__.py").write_text(text.format(2))
    assert fp.fingerprint(taken()).digest != before


@pytest.mark.parametrize(
    "line",
    [
        "from kept_pack.table import add\n@add\ndef k():\n    pass",
        "from kept_pack import table\ntable.add(len)",
        "from kept_pack import tools\ntools.K = 2",
        "from kept_pack import tools\nsetattr(tools, 'K', 2)",
        "from kept_pack.table import TABLE\nTABLE.update(k=1)",
        "from kept_pack.table import Base\nclass Sub(Base):\n    pass",
        "import math\nmath.tau = 2",
    ],
)
@pytest.mark.reliability("a module that no key holds registers, patches or derives on import", "told as not in the key")
def test_strangers_are_told(pack: Path, line: str) -> None:
    assert unseen([taken()]) == []
    (pack / "stranger.py").write_text(f"{line}\n")
    importlib.import_module("kept_pack.stranger")
    found = unseen([taken()])
    assert [text.partition(" (")[0] for text in found] == ["kept_pack.stranger:2: what it changes when it is imported"]


def test_strangers_are_told_by_another_road_and_for_what_is_in_the_key_alone(pack: Path) -> None:
    (pack / "__init__.py").write_text("from kept_pack.tools import K\nfrom kept_pack.table import TABLE\n")
    (pack / "nodes.py").write_text(NODE.replace("from", "import kept_pack\nfrom", 1))
    (pack / "stranger.py").write_text("from kept_pack import far\nfar.K = 2\n")
    importlib.import_module("kept_pack.stranger")
    assert unseen([taken()]) == []
    (pack / "nearby.py").write_text("import kept_pack\nkept_pack.TABLE.update(k=1)\n")
    importlib.import_module("kept_pack.nearby")
    assert [text.partition(" ")[0] for text in unseen([taken()])] == ["kept_pack.nearby:2:"]


def test_a_stranger_that_only_uses_is_not_told(pack: Path) -> None:
    text = "from kept_pack import tools\nfrom kept_pack.table import TABLE\nN = tools.get()\nM = TABLE.get('k')\n"
    text += "from exmesh_graph.types import Artifact\nclass Own(Artifact):\n    type_name = 'kept.Own'\n"
    (pack / "nodes.py").write_text(f"{NODE}    return Artifact\n{text}".replace("tools.N", "tools.K"))
    (pack / "stranger.py").write_text(text)
    importlib.import_module("kept_pack.stranger")
    assert unseen([taken()]) == []


def test_filling_a_table_on_import_is_not_told_but_from_a_function_it_is(pack: Path) -> None:
    (pack / "nodes.py").write_text(NODE + "table.add(first)\n")
    assert unseen([taken()]) == []
    (pack / "nodes.py").write_text(NODE.replace("    return LIMIT", "    table.add(len)\n    return LIMIT"))
    assert unseen([taken()]) == ["kept_pack.table:3: what is kept from call to call (TABLE)"]


@pytest.mark.parametrize("use", ["tools.RNG.random()", "tools.KEPT.append(1)", "tools.ONE.put(1)"])
def test_what_another_module_keeps_is_told_where_it_is_used(pack: Path, use: str) -> None:
    kept = "import random\nRNG = random.Random(5)\nKEPT = []\n"
    kept += "class H:\n    def put(self, k):\n        self.k = k\nONE = H()\n"
    (pack / "tools.py").write_text(FILES["tools.py"] + kept)
    assert unseen([taken()]) == []
    (pack / "nodes.py").write_text(NODE.replace("tools.get()", use))
    assert any("from call to call" in text for text in unseen([taken()]))


def test_a_module_that_somebody_else_imported_is_told(pack: Path) -> None:
    (pack / "nodes.py").write_text(
        NODE.replace("tools.get()", "kept_pack.far.g()").replace("from", "import kept_pack\nfrom", 1)
    )
    assert unseen([taken()]) == []
    importlib.import_module("kept_pack.far")
    (found,) = unseen([taken()])
    assert "a module that nothing here imports (kept_pack.far)" in found


@dataclass(frozen=True, eq=False)
class Box(Artifact):
    type_name: ClassVar[str] = "kept.Box"
    inner: Any = None


class Plain:
    def __init__(self) -> None:
        self.rows = [1]


class Slots:
    __slots__ = ("rows",)

    def __init__(self) -> None:
        self.rows = [1]


def counting(kept: list[int]) -> Callable[[], Any]:
    return lambda: kept.append(1)


@pytest.mark.parametrize(
    ("make", "change"),
    [
        (Plain, lambda box: box.inner.rows.append(2)),
        (Slots, lambda box: box.inner.rows.append(2)),
        (lambda: deque([1]), lambda box: box.inner.append(2)),
        (lambda: bytearray(b"a"), lambda box: box.inner.extend(b"b")),
        (lambda: np.random.default_rng(5), lambda box: box.inner.random()),
        (lambda: iter([1, 2]), lambda box: next(box.inner)),
        (lambda: memoryview(bytearray(b"abc")), lambda box: box.inner.__setitem__(0, 5)),
        (lambda: counting([]), lambda box: box.inner()),
        (lambda: Fraction(1, 2), lambda box: object.__setattr__(box, "seen", 1)),
    ],
)
def test_marks_see_into_objects_of_any_kind(make: Callable[[], Any], change: Callable[[Any], Any]) -> None:
    box = Box(make())
    before = mark_of(box)
    assert mark_of(box) == before
    change(box)
    assert mark_of(box) != before
