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
