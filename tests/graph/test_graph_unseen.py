"""Code that the key did not see: it is in the key now, refused when it is loaded, or told as not in the key."""

from __future__ import annotations

import ast
import importlib
import pkgutil
import shutil
import sys
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph import Session
from exmesh_graph.api import standard
from exmesh_graph.api.doctor import examine
from exmesh_graph.api.planning import plan, why
from exmesh_graph.api.reach import unseen_in
from exmesh_graph.api.unseen import undeclared, unseen
from exmesh_graph.graph.cache import fingerprint as fp
from exmesh_graph.graph.cache import moduletext
from exmesh_graph.graph.declare.node import NodeDef
from exmesh_graph.graph.declare.packs import current, load_packs

Take = Callable[..., fp.Fingerprint]

NODES = """
from __future__ import annotations
import importlib
import os
from exmesh_graph.graph.declare.node import node
from exmesh_graph.params import Params, param
from ._stars import *
from . import tools, registry, effect
from . import alone
try:
    from unseen_pack.tools import param as chosen
except ImportError:
    from exmesh_graph.params import param as chosen

def tuned(x, *, by=param(101, doc="No field of parameters.")):
    return x + by

match os.sep:
    case "/" as system:
        FLAVOUR = 102
    case _:
        FLAVOUR = 103

match os.curdir:
    case "." as lone:
        NOBODY = 109

class Inner(Params):
    weight: float = param(104, doc="Built by code.")

class Outer(Params):
    weight: float = param(105, doc="Only a parameter.")

class Maybe(Params):
    weight: float = chosen(110)

@registered(106)
def by_star(x):
    return x

def more_of(plug, other, maybe: Maybe = None):
    return plug.f() + other.f() + len(lone)

@registry.node("t.x", 107)
def by_other_node(x):
    return x

@node("t.a", version="1")
def first(ctx, *, p: Outer):
    plug = importlib.import_module("unseen_pack.plug")
    other = importlib.import_module(".plug_two", __package__)
    try:
        from .fast import speed
    except ImportError:
        speed = 1
    return starred(1) + tools.param(108) + tuned(1) + Inner().weight + FLAVOUR + len(system) + more_of(plug, other)
"""
FILES = {
    "__init__.py": "",
    "nodes.py": NODES,
    "_stars.py": "TABLE = {}\ndef starred(x):\n    return x + 201\n"
    "def registered(n):\n    return lambda f: TABLE.setdefault(n, f)\n",
    "tools.py": "def param(x):\n    return x + 202\ndef build():\n    return param(203)\n",
    "registry.py": "TABLE = {}\ndef node(name, n):\n    return lambda f: TABLE.setdefault((name, n), f)\n",
    "effect.py": "from . import registry\nregistry.TABLE['x'] = 206\n",
    "alone.py": "from . import registry\nregistry.TABLE['y'] = 207\n",
    "plug.py": "def f():\n    return 204\n",
    "plug_two.py": "def f():\n    return 205\n",
}


@pytest.fixture
def pack(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Path, Take]]:
    root = tmp_path / "unseen_pack"
    root.mkdir()
    for name, text in FILES.items():
        (root / name).write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    importlib.invalidate_caches()

    def take(module: str = "unseen_pack.nodes") -> fp.Fingerprint:
        current().parts.pop(fp.Sources, None)
        return fp.fingerprint(definition(module))

    yield root, take
    for name in [name for name in sys.modules if name.partition(".")[0] in ("unseen_pack", "second_pack")]:
        del sys.modules[name]
    current().parts.pop(fp.Sources, None)


def definition(module: str = "unseen_pack.nodes") -> NodeDef:
    return NodeDef("t", types.FunctionType((lambda: None).__code__, {"__name__": module}, "first"), "1")


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


@pytest.mark.parametrize(
    ("name", "number", "matters"),
    [
        ("nodes.py", 101, True),  # a default that is no field of parameters
        ("nodes.py", 102, True),  # in a `match`
        ("nodes.py", 104, True),  # a default of parameters that code builds
        ("nodes.py", 105, False),  # of the node's own parameters: their values are in the key
        ("nodes.py", 106, True),  # by a decorator out of `import *`
        ("nodes.py", 107, True),  # by another's decorator called node
        ("nodes.py", 108, True),  # another's function called param
        ("nodes.py", 109, True),  # in a `match` of which only the name it binds is used
        ("nodes.py", 110, True),  # what may be ours or another's `param`
        ("effect.py", 206, True),  # imported for its effect alone, beside what is used
        ("alone.py", 207, True),  # imported for its effect alone
        ("_stars.py", 201, True),  # out of `import *`
        ("tools.py", 203, True),  # in a module with a `param` of its own
        ("plug.py", 204, True),  # importlib.import_module("text")
        ("plug_two.py", 205, True),  # importlib.import_module(".text", __package__)
    ],
)
@pytest.mark.reliability(
    "code is edited that came by import *, match, a named import_module, another's `param` or `.node(...)`",
    "another key",
)
def test_such_code_is_in_the_key(pack: tuple[Path, Take], name: str, number: int, matters: bool) -> None:
    root, take = pack
    before = take().digest
    edit(root / name, str(number), str(number + 1000))
    assert (take().digest != before) is matters


@pytest.mark.parametrize("name", ["rest", "more"])
def test_names_that_match_binds(pack: tuple[Path, Take], name: str) -> None:
    root, take = pack
    edit(root / "nodes.py", "len(lone)", f"len({name})")
    more = "match {'a': [1, 2]}:\n    case {'a': [_, *rest], **more}:\n        NONE = 1\n\nclass Inner("
    edit(root / "nodes.py", "class Inner(", more)
    before = take().digest
    edit(root / "nodes.py", "[1, 2]", "[1, 2, 3]")
    assert take().digest != before


def test_a_module_that_may_be_missing(pack: tuple[Path, Take]) -> None:
    """It was a node that never ran; when the module comes, the key is another one, also in a session that lives on."""
    root, take = pack
    before = take()
    assert before.parts["unseen_pack.fast"] == fp.ABSENT
    assert fp.sources_changed(definition()) == []
    (root / "fast.py").write_text("speed = 2\n")
    current().part(fp.Sources).refresh()
    after = fp.fingerprint(definition())
    assert after.digest != before.digest
    assert "unseen_pack.fast" in after.modules
    assert take() == after


@pytest.mark.parametrize(
    "written", ["from ._json import encode_basestring", "from . import _json", "import unseen_pack._json"]
)
@pytest.mark.reliability("a compiled module of a pack is edited", "another key; nodes that use it run")
def test_a_compiled_module(pack: tuple[Path, Take], written: str) -> None:
    import _json  # a file of its own in every build of Python: Debian's has most others in the interpreter

    root, take = pack
    own = Path(_json.__file__)  # its last name is what Python asks of it
    built = root / own.name
    shutil.copy(own, built)
    (root / "_json.py").write_text("encode_basestring = None  # Python takes the compiled one\n")
    edit(root / "nodes.py", "from .fast import speed", written)
    before = take()
    assert "unseen_pack._json" in before.modules
    assert importlib.import_module("unseen_pack._json").encode_basestring("a") == '"a"'
    data = built.read_bytes()
    built.unlink()  # a loaded one must not change under its process
    built.write_bytes(data + b"\0")
    assert fp.sources_changed(definition()) == ["unseen_pack._json"]
    assert take().digest != before.digest


@pytest.mark.reliability("a second top-level package of the pack's distribution is edited", "another key")
def test_a_second_package_of_one_distribution(
    pack: tuple[Path, Take], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root, take = pack
    home = tmp_path / "site-packages"
    home.mkdir()
    monkeypatch.syspath_prepend(str(home))
    shutil.move(root, home)
    for name in ("second_pack", "foreign_pack"):
        (home / name).mkdir()
        (home / name / "__init__.py").write_text("def f():\n    return 301\n")
    nodes = home / "unseen_pack" / "nodes.py"
    edit(nodes, "speed = 1\n", "speed = 1\n    import second_pack, foreign_pack\n")
    info = home / "unseen_pack-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: unseen-pack\nVersion: 1\n")
    (info / "top_level.txt").write_text("unseen_pack\nsecond_pack\n")
    importlib.invalidate_caches()
    before = take()
    assert "second_pack" in before.modules
    assert "foreign_pack" not in before.modules
    edit(home / "second_pack" / "__init__.py", "301", "302")
    assert take().digest != before.digest


TOLD = {
    "import os\nos.environ['FLAVOUR']": "the environment",
    "import os\nos.getenv('FLAVOUR')": "the environment (FLAVOUR)",
    "from os import environ\nenviron.get('FLAVOUR')": "the environment (FLAVOUR)",
    "eval('1 + 1')": "code that is a text (eval)",
    "globals()['a' + 'b']": "names that are texts (globals)",
    "exec('x = 1')": "code that is a text (exec)",
    "import importlib\nimportlib.import_module('a' + b)": "code by a computed name (importlib.import_module('a' + b))",
    "import runpy\nrunpy.run_path('x.py')": "code that is run by its name (runpy.run_path('x.py'))",
    "import runpy\nrunpy.run_module('pack.x')": "code that is run by its name (runpy.run_module('pack.x'))",
    "import runpy\nrunpy.run_path(p)": "code that is run by a computed name (runpy.run_path(p))",
    "import os as system\nsystem.environ.get('FLAVOUR')": "the environment (FLAVOUR)",
    "from os import environ as around\naround['FLAVOUR']": "the environment",
    "import os\nget = os.getenv": "the environment",
    "import os\nos.path.expandvars('$FLAVOUR')": "the environment ($FLAVOUR)",
    "from pathlib import Path\nPath.home()": "the home folder",
    "import pathlib as p\np.Path('weights.npy')": "the file 'weights.npy'",
    "import os\nos.getcwd()": "the working folder",
    "import sys\nsys.argv[1]": "the command line",
    "import subprocess\nsubprocess.run([tool])": "another program",
    "from subprocess import check_output as ask\nask(['tool'])": "another program",
    "import shutil\nshutil.which('tool')": "another program",
    "import unseen_pack\nunseen_pack.__file__": "files beside the module (__file__)",
    "import unseen_pack\nunseen_pack.__loader__.get_data(p)": "files beside the module (__loader__)",
    "open('/etc/hostname').read()": "the file '/etc/hostname'",
    "from pathlib import Path\nPath('~/weights.npy')": "the file '~/weights.npy'",
    "import numpy as np\nnp.load('weights.npy')": "the file 'weights.npy'",
    "__file__": "files beside the module (__file__)",
    "from importlib import resources": "files beside the module (resources of a package)",
    "import os\no = os": "the module os, as a value",
    "__import__('os').environ['FLAVOUR']": "the environment",
    "import sys\nsys.modules['os'].environ['FLAVOUR']": "the environment",
    "import os\ngetattr(os, 'environ')['FLAVOUR']": "the environment",
    "import posix\nposix.environ[b'FLAVOUR']": "the environment",
    "import codecs\ncodecs.open('weights.txt')": "the file 'weights.txt'",
    "import builtins\nbuiltins.open('weights.bin')": "the file 'weights.bin'",
    "import os\nos.listdir('models')": "the file 'models'",
    "import glob\nglob.glob('*.npy')": "the file '*.npy'",
    "import sqlite3\nsqlite3.connect('weights.db')": "the file 'weights.db'",
    "import linecache\nlinecache.getline('weights.txt', 1)": "the file 'weights.txt'",
    "from PIL import Image\nImage.open('stain.png')": "the file 'stain.png'",
    "import ctypes\nctypes.CDLL(p)": "a library outside of Python",
    "from urllib.request import urlopen\nurlopen(address)": "the network",
    "import requests\nrequests.get(address)": "the network",
    "import socket\nsocket.gethostname()": "the machine's or the user's name",
    "model.eval()\n'a/b'.split('/')\np.open('rb')": "",
    "open('/proc/self/environ', 'rb')": "the file '/proc/self/environ'",
    "import os\nvars(os)['environ']": "the module os, as a value",
    "import os\nos.__dict__['en' + 'viron']": "os.__dict__",
    "import os, functools\nfunctools.reduce(getattr, ['getpid'], os)()": "the module os, as a value",
    "import random\nrandom._os.getpid()": "random._os.getpid",
    "import json\njson.codecs.open('weights.txt')": "the file 'weights.txt'",
    "import queue\nqueue.time()": "the module time, as a value",
    "import concurrent.futures\nconcurrent.futures._base.time.time()": "time.time",
    "import numpy as np\nnp.lib.os.getpid()": "np.lib.os.getpid",
    "import unseen_pack.tools as t\nt._sys.hexversion": "t._sys.hexversion",
    "from os import *": "os, all of it",
    "class Held:\n    import os as o": "the module os, as a value",
    "import os\nos.cpu_count()": "os.cpu_count",
    "import time\ntime.time()": "time.time",
    "from datetime import datetime as d\nd(2020, 1, 1).now()": "the clock (now)",
    "import uuid\nuuid.uuid4()": "uuid.uuid4",
    "import pickle\npickle.loads(b'cos\\ngetenv')": "pickle.loads",
    "import typing\ntyping.get_type_hints(it)": "typing.get_type_hints",
    "import locale\nlocale.getlocale()": "locale.getlocale",
    "import random\nrandom.Random()": "chance (random.Random without a seed)",
    "import numpy as np\nnp.random.default_rng()": "chance (numpy.random.default_rng without a seed)",
    "import platform": "platform",
    "'{0.__globals__}'.format(f)": "what lies around code (__globals__)",
    "'All of __globals__ in prose.'": "",
    "load = __import__": "__import__, as a value",
    "import importlib\nload = importlib.import_module": "importlib.import_module, as a value",
    "import json\njson.loads('[1]')": "",
    "open(0)": "a file that no input names (0)",
    "import shutil\nshutil.move('weights.bin', p)": "the file 'weights.bin'",
    "import os\nos.symlink('weights.bin', p)": "the file 'weights.bin'",
    "p.stat().st_mtime": "what a file's contents do not tell (st_mtime)",
    "e.__traceback__.tb_lineno": "what lies around code (tb_lineno)",
    "f.__doc__": "docstrings, which are in no key (__doc__)",
    "hash('x')": "hash(), which is another in each process",
    "f = eval": "code that is a text (eval)",
    "__builtins__": "what lies around code (__builtins__)",
    "(lambda: 0).__globals__": "what lies around code (__globals__)",
    "print.__self__": "what lies around code (__self__)",
    "list(map(open, names))": "open, as a value",
    "import os\nf = os.listdir": "os.listdir, as a value",
    "NAME = 'weights.bin'\nopen(NAME)": "the file 'weights.bin'",
    "NAMES = ['weights.bin']\nopen(NAMES[0])": "a file that no input names (NAMES[0])",
    "open('wei' + 'ghts')": "a file that no input names ('wei' + 'ghts')",
    "for n in ('a', 'b'):    open(n)": "a file that no input names (n)",
    "def read(p='weights.bin'):    return open(p)": "the file 'weights.bin'",
    "from unseen_pack.tools import WHERE\nopen(WHERE)": "a file that no input names (WHERE)",
    "open(bytes([119]))": "a file that no input names (bytes([119]))",
    "from pathlib import Path\nPath()": "the working folder",
    "import os\nos.stat('weights.bin')": "the file 'weights.bin'",
    "it = table_of('weights.csv')": "the file 'weights.csv'",
    "class Table:\n    path: str = 'weights.csv'": "the file 'weights.csv'",
    "open(p.path)\nround(p.now_and_then)": "",
    "def read(p):\n    q = p / 'x'\n    return open(q).read(4)": "",
    "import os, pathlib, time\nos.path.join(a, 'b.c')\npathlib.PurePath\ntime.perf_counter()": "",
    "import random, numpy as np\nrandom.choice(a)\nrandom.Random(3)\nnp.random.default_rng(3)": "",
    "# not in the key: for records\ndef machine():\n    import os\n    return os.uname()": "",
    "import os\nos.environ['A']  # not in the key: a cache": "",
    "import os\n# not in the key: a cache\nos.environ['A']": "",
}


@pytest.mark.parametrize("code", TOLD)
@pytest.mark.reliability(
    "code depends on the environment, on files, on computed imports or texts", "told as not in the key"
)
def test_what_no_key_holds_is_told(code: str) -> None:
    found = [words for _, words in unseen_in(ast.parse(code), code.splitlines())]
    assert found == ([TOLD[code]] if TOLD[code] else [])


@pytest.mark.parametrize("code", [*TOLD][::9])
def test_what_no_key_holds_is_told_where_it_counts(pack: tuple[Path, Take], code: str) -> None:
    """In a helper module, in the node's function; not of a neighbour in the node's module."""
    root, _ = pack
    (root / "plug.py").write_text(code + "\n")
    found = unseen([definition()])
    assert [text.partition(": ")[2] for text in found] == ([TOLD[code]] if TOLD[code] else [])
    assert all(text.startswith("unseen_pack.plug:") for text in found)
    (root / "plug.py").write_text("")
    edit(root / "nodes.py", "    plug = ", f"    {code.splitlines()[-1].split('  #')[0].strip()}\n    plug = ")
    edit(root / "nodes.py", "@node(", "def neighbour():\n    eval('1')\n    return 1\n\n@node(")
    current().parts.pop(fp.Sources, None)
    assert all("eval" not in text or "eval" in code for text in unseen([definition()]))


@pytest.mark.parametrize(
    ("lent", "taken"),
    [
        ("import os\n", "from .tools import os\nos.getpid()"),
        ("import os as o\nJOINED = o.path.join('a', 'b')\n", "from .tools import o as q\nq.getpid()"),
        ("import os as o\nJOINED = o.path.join('a', 'b')\n", "from . import tools\ntools.o.getpid()"),
        ("from time import time as n\n", "from . import tools\ntools.n()"),
    ],
)
def test_modules_that_others_lend(pack: tuple[Path, Take], lent: str, taken: str) -> None:
    root, _ = pack
    edit(root / "tools.py", "def param", f"{lent}def param")
    assert not any("unseen_pack.plug" in place for place in unseen([definition()]))
    (root / "plug.py").write_text(f"{taken}\n")
    current().parts.pop(fp.Sources, None)
    assert any(place.startswith("unseen_pack.plug:") for place in unseen([definition()]))


def test_each_name_that_is_known_to_be_harmless_is_there() -> None:
    known = [*standard.PURE.split(), *standard.MIXED, *standard.READERS]
    known += [f"{m}.{n}" for m, names in (*standard.MIXED.items(), *standard.READERS.items()) for n in names.split()]
    for name in known:
        assert pkgutil.resolve_name(name) is not None, name
        assert standard.is_standard(name), name


def test_what_nobody_thought_of_is_told() -> None:
    """Each module of the standard library that is in no list, and each name of a mixed one that is not in its own."""
    thought_of = {name.partition(".")[0] for name in (*standard.PURE.split(), *standard.MIXED, *standard.READERS)}
    rest = sys.stdlib_module_names - thought_of
    assert len(rest) > 150
    assert all(standard.beyond(f"{name}.anything") and standard.beyond(name) for name in rest)
    assert standard.beyond("json.codecs") == "the module codecs, as a value"
    assert standard.beyond("copy.copy") == ""
    for module in standard.MIXED:
        allowed = {*standard.MIXED[module].split(), *standard.READERS.get(module, "").split()}
        submodules = {one[len(module) + 1 :].partition(".")[0] for one in (*standard.MIXED, *standard.READERS)
                      if one.startswith(f"{module}.")}  # fmt: skip
        names = set(dir(importlib.import_module(module))) - allowed - submodules
        assert all(standard.beyond(f"{module}.{name}") for name in names), module


@pytest.mark.thorough
def test_nothing_of_ours_is_outside_the_key(packs: Any) -> None:
    own = [d for d in load_packs().types.values() if d.function.__module__.startswith("exmesh_nodes.")]
    assert len(own) > 50
    assert unseen(own) == []


@pytest.fixture
def asking(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Session]:
    (tmp_path / "asking_pack.py").write_text(
        "import os\nimport scipy.version\nfrom typing import NamedTuple\n"
        "from exmesh_graph.graph import node\nfrom exmesh_graph.types import Metrics\n"
        "class Out(NamedTuple):\n    metrics: Metrics\n"
        "@node('asking.flavour', version='1')\ndef flavour(ctx) -> Out:\n"
        "    return Out(Metrics({'x': len(os.environ['HOME'])}))\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    yield Session("asking_pack")
    sys.modules.pop("asking_pack", None)


@pytest.mark.thorough
def test_why_plan_and_doctor_say_so(asking: Session, tmp_path: Path) -> None:
    graph = tmp_path / "g.yaml"
    graph.write_text("nodes: {a: {type: asking.flavour}}")
    place = "asking_pack:10: the environment"
    with asking:
        made = plan(graph, store=tmp_path / "store")
        assert place in str(made)
        assert made.as_json()["not_in_key"] == [place]
        answer = why(graph, "a", store=tmp_path / "store")
        assert answer.not_in_key == (place,)
        assert answer.undeclared == ("scipy",)
        found = [str(finding) for finding in examine(asking.open_store(tmp_path / "store"), asking.packs())]
        assert any(place in text and "asking.flavour" in text for text in found)
        assert undeclared(asking.types["asking.flavour"]) == ["scipy"]


def test_the_suffixes_are_in_the_order_of_python() -> None:
    from importlib.machinery import FileFinder

    loaders = FileFinder(".", *importlib._bootstrap_external._get_supported_file_loaders())  # type: ignore[attr-defined]
    assert [suffix for suffix, _ in loaders._loaders] == list(moduletext._SUFFIXES)  # type: ignore[attr-defined]
