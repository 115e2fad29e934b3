"""What of Python's standard library cannot bring the outside world into a result; all else of it is told.

Turned this way round the list needs not be whole: a module, or a name of a module, that nobody thought of is told. What
takes a path (`READERS`) is told where no input can have given that path (`unseen`).
"""

from __future__ import annotations

import sys

PURE = (
    "__future__ abc array ast base64 binascii bisect cmath collections colorsys concurrent.futures contextlib "
    "contextvars copy csv dataclasses decimal difflib email.utils.quote enum errno fractions functools graphlib "
    "hashlib heapq hmac html itertools json keyword math numbers operator pprint queue random re reprlib "
    "statistics string struct textwrap threading types typing unicodedata urllib.parse warnings weakref "
    "xml.sax.saxutils zlib "
)
"""Modules and names all of which depend on their arguments alone, or change nothing but what is printed."""

MIXED = {
    "asyncio": "Event Future Lock Queue Semaphore Task gather run sleep wait wait_for",
    "bz2": "compress decompress",
    "codecs": "BOM_UTF8 BOM_UTF16 BOM_UTF32 decode encode getdecoder getencoder lookup",
    "ctypes": "Array POINTER Structure Union _SimpleCData addressof byref c_bool c_byte c_char c_char_p c_double "
    "c_float c_int c_int16 c_int32 c_int64 c_int8 c_longlong c_size_t c_ubyte c_uint c_uint16 c_uint32 "
    "c_uint64 c_uint8 c_void_p cast create_string_buffer memmove pointer sizeof RTLD_GLOBAL RTLD_LOCAL",
    "datetime": "MAXYEAR MINYEAR UTC date datetime time timedelta timezone tzinfo",
    "gzip": "compress decompress BadGzipFile",
    "importlib": "import_module",  # by a text it is in the key, by anything else it is told
    "importlib.metadata": "PackageNotFoundError",
    "importlib.util": "module_from_spec",
    "inspect": "Parameter Signature isabstract isclass isfunction ismethod ismodule signature unwrap",
    "io": "BufferedIOBase BytesIO IOBase RawIOBase SEEK_CUR SEEK_END SEEK_SET StringIO TextIOBase TextIOWrapper "
    "BufferedReader BufferedWriter UnsupportedOperation",
    "logging": "CRITICAL DEBUG ERROR Filter Formatter Handler INFO Logger LoggerAdapter NOTSET NullHandler "
    "StreamHandler WARNING basicConfig captureWarnings critical debug error exception "
    "getLogger info log warning",
    "lzma": "compress decompress LZMAError FORMAT_XZ FORMAT_RAW FILTER_LZMA2",
    "mmap": "ACCESS_COPY ACCESS_READ ACCESS_WRITE mmap",
    "os": "F_OK curdir pardir O_CREAT O_EXCL O_RDONLY O_RDWR O_WRONLY PathLike R_OK SEEK_CUR SEEK_END SEEK_SET W_OK "
    "X_OK chmod close dup dup2 error extsep fsdecode fsencode fspath fsync lseek makedirs mkdir "
    "path pipe register_at_fork remove removedirs rmdir sep truncate unlink "
    "utime write",
    "os.path": "basename commonpath commonprefix dirname extsep isabs join normcase normpath sep split splitdrive "
    "splitext supports_unicode_filenames",
    "pathlib": "Path PosixPath PurePath PurePosixPath PureWindowsPath",
    "shutil": "Error SameFileError rmtree",
    "signal": "SIGINT SIGKILL SIGTERM SIG_DFL SIG_IGN Signals",
    "subprocess": "CalledProcessError CompletedProcess DEVNULL PIPE STDOUT SubprocessError TimeoutExpired",
    "sys": "byteorder exit float_info int_info intern maxsize maxunicode stderr stdout",
    "tarfile": "TarInfo TarError",
    "tempfile": "NamedTemporaryFile SpooledTemporaryFile TemporaryDirectory TemporaryFile mkdtemp mkstemp",
    "time": "monotonic monotonic_ns perf_counter perf_counter_ns process_time sleep thread_time",
    "uuid": "NAMESPACE_DNS NAMESPACE_OID NAMESPACE_URL NAMESPACE_X500 UUID uuid3 uuid5",
    "xml.etree.ElementTree": "Element ElementTree ParseError SubElement XML dump fromstring indent iselement tostring",
    "zipfile": "BadZipFile LargeZipFile ZIP_BZIP2 ZIP_DEFLATED ZIP_LZMA ZIP_STORED ZipInfo ",
}  # fmt: skip
"""Modules that do both, with the names of them that depend on their arguments alone, or only write."""

READERS = {
    "builtins": "open", "bz2": "BZ2File open", "codecs": "open", "fileinput": "input", "glob": "glob iglob",
    "gzip": "GzipFile open",
    "io": "FileIO open open_code", "linecache": "getline getlines", "lzma": "LZMAFile open",
    "os": "access fdopen link listdir lstat open read readlink rename renames replace scandir stat symlink walk fwalk",
    "os.path": "exists getmtime getsize isdir isfile islink lexists samefile",
    "shutil": "copy copy2 copyfile copyfileobj copytree make_archive move unpack_archive", "sqlite3": "connect",
    "tarfile": "TarFile open", "xml.etree.ElementTree": "parse iterparse", "zipfile": "Path ZipFile is_zipfile",
}  # fmt: skip
"""What reads what lies at a path: the first argument must come from an input."""

UNKNOWING = {
    "pathlib.Path": ("cwd", "home"),
    "pathlib.PosixPath": ("cwd", "home"),
    "datetime.date": ("fromtimestamp", "today"),
    "datetime.datetime": ("fromtimestamp", "now", "today", "utcnow"),
    "csv": ("field_size_limit", "get_dialect", "list_dialects", "register_dialect", "unregister_dialect"),
    "random": ("SystemRandom",),
    "sys.stderr": ("encoding", "errors", "isatty", "name"),
    "sys.stdout": ("encoding", "errors", "isatty", "name"),
    "typing": ("ForwardRef", "get_type_hints"),  # they run texts
    "threading": ("active_count", "enumerate", "get_ident", "get_native_id"),
    "xml.etree.ElementTree.ElementTree": ("parse",),
    "types": ("CodeType", "FrameType", "FunctionType", "TracebackType", "get_original_bases"),
}
"""Names of modules and classes of these lists that are none the less told."""


def beyond(dotted: str) -> str:
    """What is told of a name of the standard library, as `os.path.join`; an empty text for nothing."""
    dotted = real(dotted)
    parts = dotted.split(".")
    for k in range(len(parts), 0, -1):
        known, rest = ".".join(parts[:k]), parts[k:]
        if rest and (rest[0] in UNKNOWING.get(known, ()) or (known in _PURE and _is_private(rest[0]))):
            return dotted
        if known in _PURE or is_reader(known):
            return ""
        if known in MIXED:
            return "" if rest and rest[0] in _WORDS[known] else dotted if rest else f"the module {dotted}, as a value"
    return dotted


def real(dotted: str) -> str:
    """A name of the standard library by its own module: `json.codecs.open` is `codecs.open`; `copy.copy` is its own."""
    parts = dotted.split(".")
    for k in range(len(parts) - 1, 0, -1):
        name, module = parts[k].lstrip("_"), ".".join(parts[:k])
        own = name == parts[k - 1] or name in _WORDS.get(module, ()) or name in _READS.get(module, ())
        if name in sys.stdlib_module_names and name not in _PURE and not own and not _is_module(parts[: k + 1]):
            return ".".join([name, *parts[k + 1 :]])
    return dotted


def _is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")


def _is_module(parts: list[str]) -> bool:
    """Whether it is named as such here, as `os.path` or `xml.etree` (`os.path` is no other module called path)."""
    name = ".".join(parts)
    return name in _PURE or any(f"{one}.".startswith(f"{name}.") for one in (*MIXED, *READERS))


def is_reader(dotted: str) -> bool:
    """Whether it reads what lies at the path that is its first argument."""
    module, _, name = dotted.rpartition(".")
    return name in _READS.get(module, ())


def is_standard(name: str) -> bool:
    return name.partition(".")[0] in sys.stdlib_module_names


_PURE = frozenset(PURE.split())
_WORDS = {module: frozenset(names.split()) for module, names in MIXED.items()}
_READS = {module: frozenset(names.split()) for module, names in READERS.items()}
