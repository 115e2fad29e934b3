"""The code fingerprint: a helper's edit changes it, a comment does not."""

from __future__ import annotations

import importlib
import os
import py_compile
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.graph.cache import fingerprint as fp
from exmesh_graph.graph.cache.moduletext import is_ignored
from exmesh_graph.graph.declare.node import NodeDef
from exmesh_graph.graph.declare.packs import current
from exmesh_graph.graph.sealed import Memo

FILES = {
    "__init__.py": "",
    "nodes.py": '''
"""Nodes."""
from __future__ import annotations
import math
from exmesh_graph.graph.declare.node import node
from exmesh_graph.params import param
from .helpers import used
from . import other
from .api import exported
LIMIT = 3
UNUSED = 4
TABLE = {}
TABLE["x"] = 1

class P:
    """Params."""
    size: int = param(3, doc="Size.")
    def total(self): return self.size + LIMIT

class Out:
    pass

def local(x):
    # a comment
    return used(x) + TABLE["x"]

def bystander(x):
    return UNUSED

@node("t.a", version="1", resources={"gpu": 1})
def first(ctx, a: "Out", *, p: P) -> Out:
    """Doc."""
    from .late import thing
    return local(thing(a)) + exported()

@node("t.b", version="1")
def second(ctx, *, p: P):
    return 1
''',
    "helpers.py": "from .deep import base\ndef used(x):\n    return base(x)\ndef spare(x):\n    return 0\n",
    "deep.py": "def base(x):\n    return x\n",
    "late.py": "def thing(x):\n    return x * 2\n",
    "other.py": "def f():\n    return 1\n",
    "api/__init__.py": '"""Exports."""\nfrom .one import exported\nfrom .two import hidden\n__all__ = ["exported"]\n',
    "api/one.py": "def exported():\n    return 1\n",
    "api/two.py": "def hidden():\n    return 1\n",
    "dynamic.py": "X = 1\n",
}

Take = Callable[..., str]


@pytest.fixture
def pack(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Path, Take]]:
    root = tmp_path / "fp_pack"
    for name, text in FILES.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))

    def take(function: str = "first", code: tuple[str, ...] = (), memo: Memo | None = None) -> str:
        current().parts.pop(fp.Sources, None)
        monkeypatch.setattr(fp, "_facts", {})  # as in a new process
        if memo is not None:
            fp.remember_in(memo)
        fake = lambda: None  # noqa: E731
        fake.__module__, fake.__name__ = "fp_pack.nodes", function
        return fp.fingerprint(NodeDef("t", fake, "1", code=code)).digest

    importlib.invalidate_caches()
    yield root, take
    sys.modules.pop("fp_pack", None)
    current().parts.pop(fp.Sources, None)


def edit(root: Path, name: str, old: str, new: str) -> None:
    path = root / name
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("nodes.py", "# a comment", "# another comment\n    # of two lines"),
        ("nodes.py", '"""Doc."""', '"""Other doc."""'),
        ("nodes.py", '"""Nodes."""', ""),
        ("nodes.py", "UNUSED = 4", "UNUSED = 5"),
        ("nodes.py", "return UNUSED", "return 7"),
        ("nodes.py", 'param(3, doc="Size.")', 'param(4, doc="How large.", unit="m")'),
        ("nodes.py", 'resources={"gpu": 1}', "resources={}"),
        ("nodes.py", "used(x) + TABLE", "used( x )  +  TABLE"),
        ("nodes.py", "return 1\n", "return 2\n"),
        ("deep.py", "return x", "return x  # same"),
        ("api/two.py", "return 1", "return 2"),
        ("api/__init__.py", "Exports", "What it exports"),
        ("dynamic.py", "X = 1", "X = 2"),
    ],
)
def test_edits_that_do_not_matter(pack: tuple[Path, Take], name: str, old: str, new: str) -> None:
    root, take = pack
    before = take()
    edit(root, name, old, new)
    assert take() == before


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("nodes.py", "LIMIT = 3", "LIMIT = 4"),
        ("nodes.py", 'TABLE["x"] = 1', 'TABLE["x"] = 2'),
        ("nodes.py", "self.size + LIMIT", "self.size - LIMIT"),
        ("nodes.py", "size: int", "size: float"),
        ("nodes.py", "used(x) + TABLE", "used(x) - TABLE"),
        ("nodes.py", "class Out:\n    pass", "class Out:\n    x = 1"),
        ("nodes.py", "TABLE = {}", "TABLE = {}\nprint('side effect')"),
        ("helpers.py", "return base(x)", "return base(x) + 1"),
        ("deep.py", "return x", "return -x"),
        ("late.py", "x * 2", "x * 3"),
        ("other.py", "return 1", "return 2"),  # imported, used by nothing: perhaps for its effect
        ("api/one.py", "return 1", "return 2"),
        ("api/__init__.py", "from .one import exported", "from .two import hidden as exported"),
        ("__init__.py", "", "import os"),
    ],
)
def test_edits_that_matter(pack: tuple[Path, Take], name: str, old: str, new: str) -> None:
    root, take = pack
    before = take()
    edit(root, name, old, new)
    assert take() != before


@pytest.mark.parametrize(
    ("name", "old", "new", "matters"),
    [
        ("nodes.py", "self.size + LIMIT", "self.size - LIMIT", True),
        ("nodes.py", "LIMIT = 3", "LIMIT = 4", True),
        ("nodes.py", '"""Params."""', '"""Other words."""', False),
        ("nodes.py", 'param(3, doc="Size.")', "param(4)", False),
        ("nodes.py", "used(x) + TABLE", "used(x) - TABLE", False),
        ("helpers.py", "return base(x)", "return base(x) + 1", False),
    ],
)
def test_edits_of_a_component_s_class(pack: tuple[Path, Take], name: str, old: str, new: str, matters: bool) -> None:
    """A component is fingerprinted like a node: its class, what its methods use, and nothing else of the module."""
    root, take = pack
    before = take("P")
    edit(root, name, old, new)
    assert (take("P") != before) is matters


def test_declared_code(pack: tuple[Path, Take]) -> None:
    root, take = pack
    before = take(code=("fp_pack.dynamic",))
    assert before != take()
    edit(root, "dynamic.py", "X = 1", "X = 2")
    assert take(code=("fp_pack.dynamic",)) != before


def test_nodes_of_one_module_are_apart(pack: tuple[Path, Take]) -> None:
    root, take = pack
    second = take("second")
    edit(root, "late.py", "x * 2", "x * 3")
    assert take("second") == second


def test_an_edit_during_the_run_is_noticed(pack: tuple[Path, Take]) -> None:
    root, take = pack
    take()
    fake = lambda: None  # noqa: E731
    fake.__module__, fake.__name__ = "fp_pack.nodes", "first"
    definition = NodeDef("t", fake, "1")
    assert fp.sources_changed(definition) == []
    edit(root, "helpers.py", "return base(x)", "return base(x)  # only a comment")
    assert fp.sources_changed(definition) == []
    edit(root, "deep.py", "return x", "return x + 100")
    assert fp.sources_changed(definition) == ["fp_pack.deep"]


def test_every_library_module_that_a_node_imports_counts(packs: Any) -> None:
    """A walk over the imports of each built-in node's module finds nothing that its nodes' fingerprints all miss."""
    import ast

    covered: dict[str, set[str]] = {}
    for definition in list(current().types.values()):
        module = definition.function.__module__
        if module.startswith("exmesh_nodes."):
            covered.setdefault(module, set()).update(fp.fingerprint(definition).modules)
    assert len(covered) >= 5
    for module, found in covered.items():
        tree = ast.parse(Path(sys.modules[module].__file__ or "").read_text())
        wanted = {
            item.module
            for item in ast.walk(tree)
            if isinstance(item, ast.ImportFrom) and (item.module or "").startswith("exmesh_graph.")
        }
        wanted = {name for name in wanted if current().part(fp.Sources).module(name).exports is None}
        assert {name for name in wanted if not is_ignored(name)} <= found, module


def test_types_package_is_followed_by_name(packs: Any) -> None:
    from toy_pack import nodes

    parts = fp.fingerprint(current().types["toy.sign"]).parts
    assert nodes.sign.__module__ + ":sign" in parts
    assert "toy_pack.helpers" in parts
    assert "exmesh_graph.types.artifact" in parts
    assert not any(name.startswith("exmesh_graph.graph") for name in parts)
    assert "exmesh_graph.types.views" not in parts


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("helpers.py", "return base(x)", "return base(x) + 1"),
        ("deep.py", "return x", "return -x"),
        ("late.py", "x * 2", "x * 3"),
        ("api/__init__.py", "from .one import exported", "from .two import hidden as exported"),
        ("nodes.py", "LIMIT = 3", "LIMIT = 4"),
    ],
)
def test_the_memo_never_hides_an_edit(pack: tuple[Path, Take], tmp_path: Path, name: str, old: str, new: str) -> None:
    """A helper of a helper is edited, its times and size kept: the remembered facts of the old bytes do not count."""
    root, take = pack
    plain = take()

    def remembered() -> str:
        memo = Memo(tmp_path / "code.json", tmp_path / "work")
        digest = take(memo=memo)
        memo.save()
        return digest

    assert remembered() == remembered() == plain
    times = (root / name).stat()
    edit(root, name, old, new)
    os.utime(root / name, ns=(times.st_atime_ns, times.st_mtime_ns))
    changed = remembered()
    assert changed != plain
    assert take() == changed
    edit(root, name, new, old)
    assert remembered() == plain


def test_with_the_memo_nothing_is_parsed(
    pack: tuple[Path, Take], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, take = pack
    memo = Memo(tmp_path / "code.json", tmp_path / "work")
    before = take(memo=memo)
    memo.save()
    monkeypatch.setattr("ast.parse", lambda *_: pytest.fail("parsed again"))
    assert take(memo=Memo(tmp_path / "code.json", tmp_path / "work")) == before


def test_in_one_process_nothing_is_parsed_again_and_every_store_learns_it(
    pack: tuple[Path, Take], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root, take = pack
    before, facts = take(), fp._facts
    assert facts
    memo = Memo(tmp_path / "code.json", tmp_path / "work")

    def fresh() -> str:
        current().parts.pop(fp.Sources, None)
        fp.remember_in(memo)
        fake = lambda: None  # noqa: E731
        fake.__module__, fake.__name__ = "fp_pack.nodes", "first"
        return fp.fingerprint(NodeDef("t", fake, "1")).digest

    with monkeypatch.context() as patch:
        patch.setattr("ast.parse", lambda *_: pytest.fail("parsed again"))
        assert fresh() == before
    assert memo.known == facts
    edit(root, "deep.py", "return x", "return x + 1")
    assert fresh() != before


def test_a_spoilt_memo_is_not_believed(pack: tuple[Path, Take], tmp_path: Path) -> None:
    _, take = pack
    path = tmp_path / "code.json"
    memo = Memo(path, tmp_path / "work")
    before = take(memo=memo)
    memo.save()
    text = path.read_text()
    path.write_text(text[:100] + text[100:].replace("a", "b"))
    assert take(memo=Memo(path, tmp_path / "work")) == before


SLY = {
    "__init__.py": "",
    "nodes.py": """
from __future__ import annotations
import json
from exmesh_graph.graph.declare.node import node
from .far import FarParams, hidden
from . import twice
from .fill import register_far
from .both import same
TABLE = {}
BASES = []
NAMES = ["a", "b"]

def register(name):
    return lambda function: TABLE.setdefault(name, function)

@register("sly")
def by_decorator(x):
    return x + 11

for name in NAMES:
    TABLE.update({name: lambda x: x + 12})

_first = TABLE.setdefault("first", lambda x: x + 13)

class Base:
    def __init_subclass__(cls):
        BASES.append(cls)

class Sub(Base):
    value = 14

class Item:
    size = 15

def helper(x: "list[Item]", y=16):
    return x

@node("t.a", version="1")
def first(ctx):
    return [f(1) for f in TABLE.values()], Base.__subclasses__(), helper(1), FarParams(), twice.f(), same()

class Stranger:
    value = 17
""",
    "far.py": "from exmesh_graph.params import Params, param\nclass FarParams(Params):\n"
    "    steps: int = param(18, doc='Words.')\ndef hidden(): return 0\n",
    "fill.py": "def register_far(): return 0\n",
    "twice.py": "def f():\n    return 19\n",
    "twice/__init__.py": "def f():\n    return 20\n",
    "both/__init__.py": "from .other import same\n",
    "both/other.py": "def same():\n    return 21\n",
    "both/same.py": "def same():\n    return 22\n",
}


@pytest.mark.parametrize(
    ("name", "number", "matters"),
    [
        ("nodes.py", 11, True),  # filled by a decorator
        ("nodes.py", 12, True),  # by a loop
        ("nodes.py", 13, True),  # by an assignment
        ("nodes.py", 14, True),  # found from its base
        ("nodes.py", 15, True),  # named in a quoted annotation
        ("nodes.py", 16, True),
        ("nodes.py", 17, False),
        ("far.py", 18, True),  # a default of parameters that code builds itself
        ("twice/__init__.py", 20, True),  # Python takes the package
        ("both/other.py", 21, True),  # a package's name for it is that of another module
    ],
)
def test_code_that_no_name_leads_to(
    pack: tuple[Path, Take], tmp_path: Path, name: str, number: int, matters: bool
) -> None:
    root, take = pack
    for file, text in SLY.items():
        (root / file).parent.mkdir(parents=True, exist_ok=True)
        (root / file).write_text(text)
    before = take()
    edit(root, name, str(number), str(number + 100))
    assert (take() != before) is matters
    if name == "far.py":
        before = take()
        edit(root, name, "Words", "Other words")
        assert take() == before


def test_bytecode_of_other_source_is_noticed(pack: tuple[Path, Take], monkeypatch: pytest.MonkeyPatch) -> None:
    """Python takes it for the source's own, as size and second agree: old code would be recorded as the new."""
    root, take = pack
    deep = root / "deep.py"
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    os.utime(deep, (1_700_000_000, 1_700_000_000))
    first = importlib.import_module("fp_pack.deep")
    assert first.base(5) == 5
    deep.write_text(deep.read_text().replace("return x", "return 7"))
    os.utime(deep, (1_700_000_000, 1_700_000_000))
    sys.modules.pop("fp_pack.deep")
    assert importlib.import_module("fp_pack.deep").base(5) == 5  # the trap
    fake = lambda: None  # noqa: E731
    fake.__module__, fake.__name__ = "fp_pack.nodes", "first"
    take()
    assert fp.sources_changed(NodeDef("t", fake, "1")) == ["fp_pack.deep"]
    sys.modules.pop("fp_pack.deep")
    assert importlib.import_module("fp_pack.deep").base(5) == 7
    take()
    assert fp.sources_changed(NodeDef("t", fake, "1")) == []
    sys.modules.pop("fp_pack.deep")


@pytest.mark.reliability("bytecode that Python takes unchecked is of another text", "told, and removed")
def test_bytecode_that_python_never_checks(pack: tuple[Path, Take]) -> None:
    root, take = pack
    deep = root / "deep.py"
    made = py_compile.compile(str(deep), invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH)
    deep.write_text(deep.read_text().replace("return x", "return 7"))
    os.utime(made)  # copied later, say
    assert importlib.import_module("fp_pack.deep").base(5) == 5  # the trap
    fake = lambda: None  # noqa: E731
    fake.__module__, fake.__name__ = "fp_pack.nodes", "first"
    take()
    assert fp.sources_changed(NodeDef("t", fake, "1")) == ["fp_pack.deep"]
    assert not Path(made).exists()
    sys.modules.pop("fp_pack.deep")
    assert importlib.import_module("fp_pack.deep").base(5) == 7
    take()
    assert fp.sources_changed(NodeDef("t", fake, "1")) == []
    sys.modules.pop("fp_pack.deep")


def test_bytecode_that_nobody_writes_anew_says_nothing(
    pack: tuple[Path, Take], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With PYTHONDONTWRITEBYTECODE old files stay beside newer sources, and every result would be forgotten."""
    root, take = pack
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    assert importlib.import_module("fp_pack.deep").base(5) == 5
    edit(root, "deep.py", "return x", "return x + 100")
    sys.modules.pop("fp_pack.deep")
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    assert importlib.import_module("fp_pack.deep").base(5) == 105
    fake = lambda: None  # noqa: E731
    fake.__module__, fake.__name__ = "fp_pack.nodes", "first"
    take()
    assert fp.sources_changed(NodeDef("t", fake, "1")) == []
    sys.modules.pop("fp_pack.deep")


def test_an_edit_that_keeps_size_and_time_is_noticed(pack: tuple[Path, Take]) -> None:
    root, take = pack
    status = (root / "deep.py").stat()
    take()
    (root / "deep.py").write_text((root / "deep.py").read_text().replace("return x", "return 7"))
    os.utime(root / "deep.py", ns=(status.st_atime_ns, status.st_mtime_ns))
    fake = lambda: None  # noqa: E731
    fake.__module__, fake.__name__ = "fp_pack.nodes", "first"
    assert fp.sources_changed(NodeDef("t", fake, "1")) == ["fp_pack.deep"]
