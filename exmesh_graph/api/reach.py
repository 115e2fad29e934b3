"""What one module's syntax reaches out for: names of the standard library that `standard` does not know to be harmless,
built-in functions, files at paths that no input gave, and what is known of some other libraries.
"""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Iterator
from typing import Any, TypeGuard

from exmesh_graph.api.fixed import Fixed
from exmesh_graph.api.kept import kept_in
from exmesh_graph.api.standard import beyond, is_reader, is_standard, real
from exmesh_graph.graph.cache.syntax import LOADERS, imports_in, last_of, text_of
from exmesh_graph.pythontree import walk

_ENVIRONMENT = re.compile(r"(?:.*\.)?(?:environb?(?:\.get)?|getenvb?)\Z", re.DOTALL)  # of `os`, whatever it is called
_OF_ENVIRONMENT = ("environ", "environb", "getenv", "getenvb")
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
    **dict.fromkeys(("torch.set_printoptions", "torch.set_flush_denormal", "torch.autograd.set_detect_anomaly",
                     "torch.is_anomaly_enabled", "numpy.setbufsize"), "the state of a library"),
    **dict.fromkeys(("ctypes.CDLL", "ctypes.PyDLL", "ctypes.cdll.LoadLibrary"), "a library outside of Python"),
}  # fmt: skip
_BUILTINS = {
    **{name: f"code that is a text ({name})" for name in ("eval", "exec", "compile")},
    "globals": "names that are texts (globals)",
    "input": "what somebody types (input)", "breakpoint": "what somebody types (breakpoint)",
    "hash": "hash(), which is another in each process", "__debug__": "how Python was started (__debug__)",
}  # fmt: skip
_OF_ANYTHING = {
    **dict.fromkeys(("__file__", "__path__", "__loader__", "__spec__", "__cached__"), "files beside the module ({})"),
    **dict.fromkeys(("__globals__", "__builtins__", "__subclasses__", "__code__", "__self__", "f_globals", "f_locals",
                     "f_builtins", "f_back", "gi_frame", "cr_frame", "ag_frame", "tb_frame", "tb_lineno",
                     "__traceback__"),
                    "what lies around code ({})"),
    **dict.fromkeys(("st_mtime", "st_mtime_ns", "st_ctime", "st_ctime_ns", "st_atime", "st_ino", "st_uid", "st_mode"),
                    "what a file's contents do not tell ({})"),
    **dict.fromkeys(("lineno", "f_lineno", "co_firstlineno"), "numbers of lines ({})"),
    **dict.fromkeys(("model_fields", "model_json_schema", "__pydantic_fields__"),
                    "words and bounds of parameters, which are in no key ({})"),
    **dict.fromkeys(("setLevel", "isEnabledFor", "getEffectiveLevel"), "levels of loggers ({})"),
    "expanduser": "the home folder", "__doc__": "docstrings, which are in no key ({})",
    **dict.fromkeys(("now", "today", "utcnow"), "the clock ({})"),
}  # fmt: skip
_AROUND = re.compile(
    "__(?:globals|builtins|subclasses|code|self|traceback|import|doc)__"
)  # as a text: "{0.__globals__}"
_THROUGH = {
    "os",
    "sys",
    "posix",
    "builtins",
    "subprocess",
    "importlib",
    "shutil",
    "socket",
}  # also `np.os`
_UNSEEDED = {"random.Random", "random.seed", "numpy.random.default_rng", "numpy.random.RandomState",
             "numpy.random.seed", "numpy.random.SeedSequence"}  # fmt: skip
_BESIDE = ("importlib.resources", "importlib_resources", "pkgutil")
_RUNS = ("exec_module", "run_path", "run_module")
_PATHS = ("pathlib.Path", "pathlib.PosixPath", "pathlib.PurePath", "Path", "PurePath")
_READS = re.compile(
    r"(?:(?:io|os|codecs|builtins|(?:PIL\.)?Image)\.)?open"
    r"|(?:\w+\.)*(?:(?:im)?read\w*|load\w*|\w*from_?(?:file|txt)\w*|memmap)\Z"
)
_HARMLESS = "# not in the key"


def unseen_in(tree: ast.AST, lines: list[str]) -> list[tuple[int, str]]:
    """(line, words) of every such place; `lines` are those of the whole file."""
    return looked_at(tree, lines, "")["places"]


def looked_at(tree: ast.AST, lines: list[str], package: str) -> dict[str, Any]:
    """`places` as `unseen_in` has them; what a module has `lent` and `taken` (see there), as JSON would hold it;
    what `kept_in` says, its places as `keeps`."""
    module, quiet, told = _Module(tree), _harmless(tree, lines), dict[int, str]()
    for item, words in module.places():
        if item.lineno not in quiet:
            told.setdefault(item.lineno, words)
    taken = _taken(module.items, package, quiet) if package else []
    kept = kept_in(tree, package) or {"places": [], "inner": [], "state": {}, "uses": [], "hooked": [], "acts": []}
    keeps = [place for place in kept.pop("places") if place[0] not in quiet]
    for name in ("uses", "acts"):
        kept[name] = [place for place in kept[name] if place[0] not in quiet]
    return {
        "places": sorted(told.items()),
        "lent": _lent(tree) if package else {},
        "taken": taken,
        "keeps": keeps,
        **kept,
    }


def _lent(tree: ast.AST) -> dict[str, str]:
    """{name at the top of a module: words} of what it has from the standard library and others could take from it."""
    lent = {}
    for item in getattr(tree, "body", ()):
        for alias in item.names if isinstance(item, (ast.Import, ast.ImportFrom)) else ():
            level, module = getattr(item, "level", 0), getattr(item, "module", None)
            origin = f"{module}.{alias.name}" if module else alias.name
            if not level and is_standard(origin) and beyond(origin) and (module or alias.asname or "." not in origin):
                lent[alias.asname or alias.name] = beyond(origin)
    return lent


def _taken(items: list[ast.AST], package: str, quiet: set[int]) -> list[tuple[int, str]]:
    """(line, dotted name) of what a module takes from others of its own top package: what these have may be lent."""
    top, taken = package.partition(".")[0], dict[str, int]()
    names: dict[str, str] = {}
    for item in items:
        if isinstance(item, (ast.Import, ast.ImportFrom)):
            for alias, (module, name) in zip(item.names, imports_in(item, package), strict=True):
                if module.partition(".")[0] == top and alias.name != "*":
                    short = alias.asname or alias.name.partition(".")[0]
                    names[short] = f"{module}.{name}" if name else module if alias.asname else top
                    if name and item.lineno not in quiet:
                        taken.setdefault(f"{module}.{name}", item.lineno)
    for item in items if names else ():
        if isinstance(item, ast.Attribute) and item.lineno not in quiet:
            root, parts = _chain(item)
            if root in names:
                taken.setdefault(".".join([names[root], *parts]), item.lineno)
    return [(line, name) for name, line in taken.items()]


def _harmless(tree: ast.AST, lines: list[str]) -> set[int]:
    """The lines that say, or whose comment above or function says, that what they do changes no result."""
    quiet = {k for k, line in enumerate(lines, 1) if _HARMLESS in line}
    quiet |= {k + 1 for k in quiet if lines[k - 1].strip().startswith(_HARMLESS)}
    for item in walk(tree) if quiet else ():
        if isinstance(item, (ast.FunctionDef, ast.AsyncFunctionDef)) and item.lineno in quiet:
            quiet.update(range(item.lineno, (item.end_lineno or item.lineno) + 1))
    return quiet


class _Module:
    """The names of one module's text, and what of it depends on the outside."""

    def __init__(self, tree: ast.AST) -> None:
        self.items = list(walk(tree))
        self.names = _imported(self.items)
        self.bound = set(_bound(self.items)) | {*self.names}
        self.tree = tree
        self.used = {item.id for item in self.items if isinstance(item, ast.Name) and isinstance(item.ctx, ast.Load)}
        self.prose = {id(item.value) for item in self.items if isinstance(item, ast.Expr)}
        self.held = {id(part) for item in self.items if isinstance(item, ast.ClassDef) for part in item.body}
        self.called = {id(item.func) for item in self.items if isinstance(item, ast.Call)}

    @functools.cached_property
    def fixed(self) -> Fixed:
        return Fixed(self.tree, self.names)

    def places(self) -> Iterator[tuple[ast.expr | ast.stmt, str]]:
        """Each piece of syntax that depends on something outside, with words for it; the outer ones first."""
        inner: set[int] = set()  # parts of a dotted name that was looked at as a whole
        for item in self.items:
            words = ""
            if isinstance(item, (ast.Name, ast.Attribute)) and id(item) not in inner:
                part: ast.expr = item
                while isinstance(part, ast.Attribute):
                    part = part.value
                    inner.add(id(part))
                words = self._of_name(item)
            elif isinstance(item, (ast.Import, ast.ImportFrom)):
                words = self._of_import(item)
            elif isinstance(item, (ast.Assign, ast.AnnAssign)) and id(item) in self.held and _is_file(item.value):
                words = f"the file {item.value.value!r}"  # of each object of a class
            elif isinstance(item, ast.Call):
                words = self._of_call(item)
            elif isinstance(item, ast.Constant) and isinstance(item.value, str) and id(item) not in self.prose:
                words = (
                    f"what lies around code ({_AROUND.findall(item.value)[0]})" if _AROUND.search(item.value) else ""
                )
            if words and isinstance(item, (ast.expr, ast.stmt)):
                yield item, words

    def _origin(self, item: ast.expr) -> str:
        """What `a.b.c` stands for, its first name as it was imported; an empty text for what is bound here, or made."""
        root, parts = _chain(item)
        known = self.names.get(root) or ("" if root in self.bound else root)
        dotted = ".".join([known, *parts]) if known else ""
        return real(dotted) if is_standard(dotted) else dotted

    def _of_name(self, item: ast.Name | ast.Attribute) -> str:
        if isinstance(item, ast.Name) and not isinstance(item.ctx, ast.Load):
            return ""
        chain = [item.attr if isinstance(item, ast.Attribute) else item.id]
        part: ast.expr = item
        while isinstance(part, ast.Attribute):
            part = part.value
            chain.append(last_of(part))
        for end in chain:
            if end in _OF_ANYTHING and end not in self.bound:
                return _OF_ANYTHING[end].format(end)
        dotted = self._origin(item)
        if any(_ENVIRONMENT.match(text) for text in (dotted, last_of(item))):
            return "the environment"
        if any(end.lstrip("_") in _THROUGH for end in chain[:-1]):
            return f"{ast.unparse(item)[:60]}"
        if not dotted:
            return ""
        if dotted in _OF_MACHINE:
            return _OF_MACHINE[dotted]
        if dotted in _BUILTINS:
            return _BUILTINS[dotted]
        taken = dotted in ("open", *LOADERS) or dotted.endswith(".import_module") or is_reader(dotted)
        if taken and id(item) not in self.called:
            return f"{dotted}, as a value"
        return beyond(dotted) if is_standard(dotted) else ""

    def _of_import(self, item: ast.Import | ast.ImportFrom) -> str:
        for alias, (module, name) in zip(item.names, imports_in(item, ""), strict=True):
            origin = f"{module}.{name}" if name else module
            if origin.startswith(_BESIDE):
                return "files beside the module (resources of a package)"
            if getattr(item, "level", 0) or not is_standard(module):
                continue
            if name in LOADERS and (alias.asname or name) not in LOADERS:
                return f"{origin}, under another name"
            bound = alias.asname or alias.name.partition(".")[0]
            if (
                alias.name == "*" or bound not in self.used or id(item) in self.held
            ):  # for its effect, or for whoever imports it from here
                found = beyond(origin)
                if found and not (name is None and alias.name != "*" and _is_package(origin)):
                    return found if alias.name != "*" else f"{module}, all of it"
        return ""

    def _of_call(self, item: ast.Call) -> str:
        name, text = last_of(item.func), text_of(item)
        if name == "getattr" and len(item.args) > 1 and getattr(item.args[1], "value", "") in _OF_ENVIRONMENT:
            return "the environment"
        if name in LOADERS and not text:
            return f"code by a computed name ({ast.unparse(item)[:60]})"
        if name in LOADERS and is_standard(text) and beyond(text):
            return beyond(text)
        if name in _RUNS:
            return f"code that is run by {'its' if text else 'a computed'} name ({ast.unparse(item)[:60]})"
        dotted = self._origin(item.func)
        if dotted in _UNSEEDED and not item.args and not item.keywords:
            return f"chance ({dotted} without a seed)"
        if dotted in _PATHS and not item.args:
            return "the working folder"
        if dotted in _PATHS or is_reader(dotted) or (not is_standard(dotted) and _READS.fullmatch(dotted)):
            return self._of_path(item, dotted)
        if not dotted and text and _READS.fullmatch(f"it.{name}"):
            return f"the file {text!r}"  # a method of something, as `loader.load("weights.npy")`
        first = item.args[0] if item.args else next((k.value for k in item.keywords if k.arg in _NAMED), None)
        if isinstance(item.func, ast.Name) and name not in ("node", "component") and _is_file(first):
            return f"the file {first.value!r}"  # of the pack's own: `read_table("table.csv")`
        what = _OF_MACHINE.get(dotted, "the environment" if _ENVIRONMENT.match(dotted or name) else "")
        return f"{what} ({text})" if text and what.startswith("the environment") else ""

    def _of_path(self, item: ast.Call, dotted: str) -> str:
        """What a call reads, where no input can have given its path."""
        given = item.args[0] if item.args else next((k.value for k in item.keywords if k.arg in (None, *_NAMED)), None)
        if given is None:
            return "" if item.keywords or not is_reader(dotted) else "the working folder"
        if (text := self.fixed.text(given)) is not None:
            return "" if not text else f"the file {text!r}"
        return f"a file that no input names ({ast.unparse(given)[:60]})" if self.fixed(given) else ""


def _chain(item: ast.expr) -> tuple[str, list[str]]:
    """The first name of `a.b.c`, and the others; no first name where it begins with something else."""
    parts: list[str] = []
    while isinstance(item, ast.Attribute):
        parts.append(item.attr)
        item = item.value
    return (item.id if isinstance(item, ast.Name) else ""), parts[::-1]


def _is_file(item: ast.expr | None) -> TypeGuard[ast.Constant]:
    """Whether it is a text that can hardly be anything but a file's name."""
    return isinstance(item, ast.Constant) and isinstance(item.value, str) and bool(_FILE.fullmatch(item.value))


_FILE = re.compile(
    r"[\w./\\~*\- ]*[\w*]\.(?:txt|csv|tsv|json|ya?ml|np[yz]|bin|dat|h5|hdf5|pth?|onnx|pkl|pickle|png|jpe?g|exr|hdr"
    r"|tiff?|obj|ply|stl|gl(?:tf|b)|usd[azc]?|xml|toml|ini|cfg|db|sqlite3?|parquet|safetensors|ckpt|zip)"
)
_NAMED = ("file", "path", "filename", "name", "fp", "src")
_NAMING = (ast.MatchAs, ast.MatchStar, ast.ExceptHandler)


def _imported(items: list[ast.AST]) -> dict[str, str]:
    """{name: dotted origin} of what is imported under a name, whatever it is called then."""
    names: dict[str, str] = {}
    for item in items:
        if isinstance(item, ast.Import):
            for alias in item.names:
                names[alias.asname or alias.name.partition(".")[0]] = (
                    alias.name if alias.asname else alias.name.partition(".")[0]
                )
        elif isinstance(item, ast.ImportFrom):
            base = item.module or "."
            names |= {alias.asname or alias.name: f"{base}.{alias.name}" for alias in item.names if alias.name != "*"}
    return names


def _bound(items: list[ast.AST]) -> Iterator[str]:
    """Names that a module gives a meaning of its own, anywhere."""
    for item in items:
        if isinstance(item, ast.arg):
            yield item.arg
        elif isinstance(item, ast.Name) and not isinstance(item.ctx, ast.Load):
            yield item.id
        elif isinstance(item, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, _NAMING)):
            yield item.name or ""


def _is_package(name: str) -> bool:
    """Whether `import name` only makes way for names below it, which are looked at where they are used."""
    return name in ("concurrent", "email", "importlib", "urllib", "xml", "xml.etree", "xml.sax")
