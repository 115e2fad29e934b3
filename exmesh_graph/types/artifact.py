"""What every value on a wire can do: write itself into a folder, read itself back, state its facets.

Invariant: `load(save(x))` equals `x` bit for bit, so that a value handed over in memory and one read from the
store give the same bytes downstream; and `save` writes the same bytes for equal values (no time stamps, no pickle).
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

from exmesh_graph.errors import DataError
from exmesh_graph.types.pictures import Pictures

if TYPE_CHECKING:
    import numpy as np


class Artifact:
    """Base of the wire types. Ports match nominally: a subclass fits where its base is asked for.

    `conventions` are facets that hold for every value of the type: camera axes, up axis, units, colour space. A port
    asks for the conventions of its type and an output promises them, so that a subclass with others is refused.
    """

    type_name: ClassVar[str] = "artifact"
    conventions: ClassVar[Mapping[str, Any]] = {}

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls.__repr__ = cls.__repr__  # type: ignore[method-assign]  # its own: a dataclass would print whole arrays

    def __repr__(self) -> str:
        """`Mesh(vertices [162, 3], faces [320, 3]; manifold, closed, units normalised)`: sizes and facets."""
        named: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self)} if is_dataclass(self) else {}
        facets: dict[str, Any] = {}
        with contextlib.suppress(Exception):  # arrays that do not fit together still have sizes
            facets = self.facets()
        sizes = [_in_short(name, value) for name, value in named.items() if name not in facets]
        held = [key if value is True else f"{key} {value}" for key, value in facets.items() if value]
        inside = "; ".join(part for part in (", ".join(filter(None, sizes)), ", ".join(held)) if part)
        return f"{type(self).__name__}({inside})"

    def save(self, folder: Path) -> None:
        """Write this value into the existing empty `folder`."""
        raise NotImplementedError

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read a value that `save` wrote."""
        raise NotImplementedError

    @property
    def read_back(self) -> bool:
        """Whether it lies in files of the attempt that made it: others read it from the store."""
        return False

    def facets(self) -> dict[str, Any]:
        """Measured properties (split, closed, ...), checked against what the receiving port asks for."""
        return {}


def _in_short(name: str, value: Any) -> str:
    """A field in a few letters; "" for one that says nothing."""
    if hasattr(value, "shape"):
        return f"{name} {list(value.shape)}"
    if value is None or value == "" or isinstance(value, bool):
        return ""
    if isinstance(value, Mapping | list | tuple):
        return f"{len(value)} {name}" if value else ""
    text = str(value)
    return f"{name} {text if len(text) <= 60 else '…' + text[-59:]}"


class ArrayArtifact(Artifact):
    """Base of wire types that are dataclasses of arrays: checked when made, saved and loaded field by field.

    Fields are arrays, mappings of arrays, tuples of strings, None, numbers, strings or bools.
    `layout` says what each array must be: its dtype and shape, `"float32 V 3"`. A letter is a length that all fields
    with this letter share, a number a fixed length; a `?` behind the dtype allows None; of several shapes, parted by
    `|`, one must fit. `indices` names fields whose values are places in another field: {"faces": "vertices"}.
    Making one that does not fit raises DataError, which names the field, what was expected and what came.
    """

    type_name: ClassVar[str] = "arrays"
    layout: ClassVar[Mapping[str, str]] = {}
    indices: ClassVar[Mapping[str, str]] = {}

    def __post_init__(self) -> None:
        check_layout(self)

    def save(self, folder: Path) -> None:
        import numpy as np

        arrays: dict[str, Any] = {}
        meta: dict[str, Any] = {}
        for f in fields(self):  # type: ignore[arg-type]
            value = getattr(self, f.name)
            if isinstance(value, np.ndarray):
                arrays[f.name] = value
            elif isinstance(value, Mapping):
                arrays.update({f"{f.name}/{key}": array for key, array in value.items()})
            elif not isinstance(value, Pictures):  # which are their owner's to save
                meta[f.name] = value
        save_arrays(folder, arrays, meta)

    @classmethod
    def load(cls, folder: Path) -> Self:
        return cls(**cls.stored(folder))

    @classmethod
    def stored(cls, folder: Path) -> dict[str, Any]:
        """The fields that `save` wrote, by name."""
        arrays, meta = load_arrays(folder)
        values: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value for name, value in meta.items()
        }
        for name, array in arrays.items():
            of, _, key = name.partition("/")
            if key:
                values.setdefault(of, {})[key] = array
            else:
                values[name] = array
        return values


def check_layout(value: ArrayArtifact) -> None:
    """DataError for the first field that is not as the type's `layout` says, or indexes what is not there.

    Shapes and dtypes only, and the range of the fields in `indices`: no other array is read.
    """
    kind = type(value).__name__
    lengths: dict[str, tuple[int, str]] = {}
    for name, wanted in value.layout.items():
        dtype, _, shapes = wanted.partition(" ")
        array = getattr(value, name)
        if array is None and dtype.endswith("?"):
            continue
        dtype = dtype.rstrip("?")
        options = [shape.split() for shape in shapes.split("|")]
        owned = isinstance(array, Pictures) or type(array).__module__ == "numpy"
        if not (hasattr(array, "dtype") and owned and str(array.dtype) == dtype):
            fix = f"np.asarray({name}, np.{dtype})"
        elif not any(_fits(array.shape, shape, lengths) for shape in options):
            fix = ""
        else:
            shape = next(shape for shape in options if _fits(array.shape, shape, lengths))
            for letter, length in zip(shape, array.shape, strict=True):
                if not letter.isdigit():
                    lengths.setdefault(letter, (length, name))
            continue
        known = {letter: lengths[letter] for shape in options for letter in shape if letter in lengths}
        sizes = "".join(f", {letter} = {length} as in {source}" for letter, (length, source) in known.items())
        raise DataError(
            f"is {_described(array)}",
            where=f"{kind}.{name}",
            expected=f"{dtype} {' or '.join('[' + ', '.join(shape) + ']' for shape in options)}{sizes}",
            fix=fix,
        )
    for name, target in value.indices.items():
        array, count = getattr(value, name), len(getattr(value, target))
        if array.size and (int(array.min()) < 0 or int(array.max()) >= count):
            first = tuple(int(places[0]) for places in ((array < 0) | (array >= count)).nonzero())
            raise DataError(
                f"{name}{list(first)} = {int(array[first])} points outside the {count} {target}",
                where=f"{kind}.{name}",
                expected=f"indices from 0 to {count - 1}",
            )


def _fits(shape: tuple[int, ...], wanted: list[str], lengths: Mapping[str, tuple[int, str]]) -> bool:
    known = {letter: length for letter, (length, _) in lengths.items()}
    return len(shape) == len(wanted) and all(
        length == (int(letter) if letter.isdigit() else known.setdefault(letter, length))
        for length, letter in zip(shape, wanted, strict=True)
    )


def _described(value: Any) -> str:
    if hasattr(value, "dtype") and hasattr(value, "shape"):
        owner = "" if type(value).__module__ == "numpy" else f"a {type(value).__module__} tensor, "
        return f"{owner}{str(value.dtype).removeprefix('torch.')} {list(value.shape)}"
    return "None" if value is None else f"a {type(value).__name__}"


def save_arrays(folder: Path, arrays: dict[str, np.ndarray], meta: dict[str, Any] | None = None) -> None:
    """Write `arrays` to `arrays.safetensors` and the JSON-like `meta` to `meta.json`, byte-stable."""
    import numpy as np
    from safetensors.numpy import save_file

    save_file(
        {name: np.ascontiguousarray(array) for name, array in sorted(arrays.items())},
        folder / "arrays.safetensors",
    )
    text = json.dumps(meta or {}, sort_keys=True, indent=1, ensure_ascii=False, allow_nan=False)
    (folder / "meta.json").write_text(text + "\n", encoding="utf-8")


def load_arrays(folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Read what `save_arrays` wrote: (arrays, meta)."""
    from safetensors.numpy import load_file

    meta = json.loads((folder / "meta.json").read_text(encoding="utf-8"))
    return load_file(folder / "arrays.safetensors"), meta
