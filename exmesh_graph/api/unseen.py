"""What a node's code depends on that no text of modules can tell: the environment, files, computed code and imports.

It is told, and not keyed: by `why`, `plan` and `doctor`. A line is left out that ends in `# not in the key: reason`,
or has such a comment above it.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import importlib.metadata
import inspect
import re
import sys
import textwrap
from collections.abc import Iterable, Mapping
from pathlib import Path

from exmesh_graph.errors import ExmeshError
from exmesh_graph.files import sha256_file
from exmesh_graph.graph.cache.fingerprint import Sources
from exmesh_graph.graph.cache.moduletext import OWN, ModuleText
from exmesh_graph.graph.cache.syntax import LOADERS, imports_in, last_of, text_of
from exmesh_graph.graph.declare.node import NodeDef
from exmesh_graph.graph.declare.packs import current

_ENVIRONMENT = re.compile(r"(?:.*\.)?(?:environb?(?:\.get)?|getenvb?)\Z", re.DOTALL)  # of `os`, whatever it is called
_OF_ENVIRONMENT = ("environ", "environb", "get", "getenv", "getenvb")  # what such a name ends in: asked first
_OF_MACHINE = {
    "os.getcwd": "the working folder", "os.getcwdb": "the working folder", "pathlib.Path.cwd": "the working folder",
    "pathlib.Path.home": "the home folder", "os.path.expanduser": "the home folder",
    "os.path.expandvars": "the environment", "sys.argv": "the command line", "shutil.which": "another program",
    **dict.fromkeys(("os.system", "os.popen", "subprocess.run", "subprocess.Popen", "subprocess.call",
                     "subprocess.check_call", "subprocess.check_output", "subprocess.getoutput",
                     "asyncio.create_subprocess_exec", "asyncio.create_subprocess_shell"), "another program"),
    **dict.fromkeys(("urllib.request.urlopen", "urllib.request.urlretrieve", "socket.socket",
                     "socket.create_connection", "http.client.HTTPConnection", "http.client.HTTPSConnection",
                     "requests.get", "requests.post", "requests.request", "requests.Session",
                     "httpx.get", "httpx.Client"), "the network"),
    **dict.fromkeys(("socket.gethostname", "platform.node", "platform.uname", "getpass.getuser", "os.uname",
                     "os.getlogin"), "the machine's or the user's name"),
    **dict.fromkeys(("ctypes.CDLL", "ctypes.PyDLL", "ctypes.cdll.LoadLibrary"), "a library outside of Python"),
}  # fmt: skip
_ENDS = {*_OF_ENVIRONMENT, *(name.rpartition(".")[2] for name in _OF_MACHINE)}
_BESIDE = ("importlib.resources", "importlib_resources", "pkgutil")
_RUNS = ("exec_module", "run_path", "run_module")
_READERS = re.compile(
    r"(?:(?:io|os|codecs|builtins|gzip|bz2|lzma|tarfile|(?:PIL\.)?Image)\.)?open"
    r"|os\.(?:listdir|scandir|walk)|glob\.i?glob|linecache\.getlines?|sqlite3\.connect"
    r"|(?:pathlib\.)?(?:Pure)?Path|(?:\w+\.)*(?:(?:im)?read\w*|load\w*|\w*from_?(?:file|txt)\w*|memmap)\Z"
)
_PSEUDO = ("/proc/", "/sys/", "/dev/")
_HARMLESS = "# not in the key"
_looked_at: dict[str, list[tuple[int, str]]] = {}
"""What was found in modules of these bytes (`ModuleText.key`), for where there is no store whose memo knows."""


def unseen(definitions: Iterable[NodeDef]) -> list[str]:
    """`module:line: words` of every place in the code of nodes and components; what cannot be read is left out."""
    told: dict[str, None] = {}
    for definition in definitions:
        with contextlib.suppress(ExmeshError):  # told of where the node is planned
            told.update(dict.fromkeys(_of(definition)))
    return list(told)


def undeclared(definition: NodeDef) -> list[str]:
    """The installed libraries that a pack's code imports for a type and its declaration (`libraries=`) leaves out."""
    declared, owners = {*map(_canonical, definition.libraries)}, importlib.metadata.packages_distributions()
    return sorted(
        name for name in outside_imports(definition, but_not_of=(OWN,))
        if name in owners and not declared & {_canonical(owner) for owner in owners[name]}
    )  # fmt: skip


def outside_imports(definition: NodeDef, but_not_of: tuple[str, ...] = ()) -> set[str]:
    """Top names of what a node type's code imports from neither the project nor the standard library."""
    sources = current().part(Sources)
    modules = [sources.module(name) for name in sources.fingerprint(definition).modules]
    own = {OWN, *(module.name.partition(".")[0] for module in modules)} | sys.stdlib_module_names
    asked = [module for module in modules if module.name.partition(".")[0] not in but_not_of]
    return {name.partition(".")[0] for module in asked for name, _ in module.imports} - own


def _of(definition: NodeDef) -> list[str]:
    sources, own = current().part(Sources), definition.function.__module__
    made = sources.fingerprint(definition)
    told = []
    for name in made.modules:
        text = sources.module(name)
        found = sources.fact(text, _fact(), functools.partial(_in_module, text))
        told += [f"{name}:{line}: {words}" for line, words in found if name != own or line in made.lines]
    if own == "__main__":
        with contextlib.suppress(OSError, TypeError, SyntaxError):
            source = textwrap.dedent(inspect.getsource(definition.function))
            told += [f"{own}:{line}: {words}" for line, words in unseen_in(ast.parse(source), source.splitlines())]
    return told


def _in_module(text: ModuleText) -> list[tuple[int, str]]:
    if text.key not in _looked_at:
        _looked_at[text.key] = unseen_in(text.tree, text.data.decode("utf-8", "replace").splitlines())
    return _looked_at[text.key]


@functools.cache
def _fact() -> str:
    return f"unseen {sha256_file(Path(__file__))}"


def _canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def unseen_in(tree: ast.AST, lines: list[str]) -> list[tuple[int, str]]:
    """(line, words) of every such place; `lines` are those of the whole file."""
    told: dict[int, str] = {}
    names = _imported(tree)
    for item in ast.walk(tree):
        if isinstance(item, ast.expr | ast.stmt) and (words := _words(item, names)) and not _harmless(lines, item):
            told.setdefault(item.lineno, words)
    return sorted(told.items())


def _imported(tree: ast.AST) -> dict[str, str]:
    """{name: dotted origin} of what is imported under a name, whatever it is called then."""
    names: dict[str, str] = {"environ": "os.environ", "getenv": "os.getenv"}  # also where `import *` brought them
    for item in ast.walk(tree):
        if isinstance(item, ast.Import):
            names |= {alias.asname: alias.name for alias in item.names if alias.asname}
        elif isinstance(item, ast.ImportFrom) and item.module and not item.level:
            names |= {alias.asname or alias.name: f"{item.module}.{alias.name}" for alias in item.names}
    return names


def _dotted(item: ast.expr, names: Mapping[str, str]) -> str:
    """What an expression like `a.b.c` stands for, its first name as it was imported."""
    first, dot, rest = ast.unparse(item).partition(".")
    return names.get(first, first) + dot + rest


def _harmless(lines: list[str], item: ast.expr | ast.stmt) -> bool:
    """Whether a line, or a comment above it, says that what it does changes no result."""
    line = item.lineno
    above = lines[line - 2].strip() if line > 1 else ""
    return _HARMLESS in lines[line - 1] or above.startswith(_HARMLESS)


def _words(item: ast.AST, names: Mapping[str, str]) -> str:
    """What one piece of syntax depends on; an empty text for nothing else."""
    if isinstance(item, ast.Name | ast.Attribute):
        return _of_machine(item, names)
    if isinstance(item, ast.Import | ast.ImportFrom):
        beside = any(f"{module}.{name}".startswith(_BESIDE) for module, name in imports_in(item, ""))
        return "files beside the module (resources of a package)" if beside else ""
    if not isinstance(item, ast.Call):
        return ""
    name, text = last_of(item.func), text_of(item)
    if isinstance(item.func, ast.Name) and name in ("eval", "exec"):
        return f"code that is a text ({name})"
    if isinstance(item.func, ast.Name) and name == "globals":
        return "names that are texts (globals)"
    if name == "getattr" and len(item.args) > 1 and getattr(item.args[1], "value", "") in _OF_ENVIRONMENT:
        return "the environment"
    if name in LOADERS and not text:
        return f"code by a computed name ({ast.unparse(item)[:60]})"
    if name in _RUNS:
        return f"code that is run by {'its' if text else 'a computed'} name ({ast.unparse(item)[:60]})"
    if text and not text.startswith(_PSEUDO) and _READERS.fullmatch(_dotted(item.func, names)):
        return f"the file {text!r}"
    what = _of_machine(item.func, names) if text else ""
    return f"{what} ({text})" if what.startswith("the environment") else what


def _of_machine(item: ast.expr, names: Mapping[str, str]) -> str:
    """What a name stands for of what lies around a process. Syntax is turned into text slowly: its end comes first."""
    end = last_of(item)
    if end in ("__file__", "__path__", "__loader__", "__spec__"):
        return f"files beside the module ({end})"
    if end not in _ENDS and names.get(end, "").rpartition(".")[2] not in _ENDS:
        return ""
    dotted = _dotted(item, names)
    return "the environment" if _ENVIRONMENT.match(dotted) else _OF_MACHINE.get(dotted, "")
