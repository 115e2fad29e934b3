"""What a run shows for itself: figures, pictures, exported files."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

from exmesh_graph.errors import DataError
from exmesh_graph.types.artifact import Artifact, load_arrays, save_arrays

if TYPE_CHECKING:
    import numpy as np


@dataclass(frozen=True, eq=False)
class Metrics(Artifact):
    """Named figures. `values` is JSON-like: numbers, strings, lists and nested dicts; no NaN.

    `headline` and `stages`, where given, are what the report draws (docs/report.md). `save` raises DataError where an
    entry of theirs is malformed: the node that made it fails, not the report after all nodes.
    """

    type_name: ClassVar[str] = "Metrics"
    values: dict[str, Any] = field(default_factory=dict)

    def save(self, folder: Path) -> None:
        for fault in figure_faults(self.values):
            expected = "a list of {label, value, unit?, floor?, goal?, better?, series?, over?}"
            raise DataError(fault, where="Metrics", expected=expected, fix="docs/report.md says what each holds")
        text = json.dumps(self.values, sort_keys=True, indent=1, allow_nan=False)
        (folder / "metrics.json").write_text(text + "\n", encoding="utf-8")

    @classmethod
    def load(cls, folder: Path) -> Self:
        return cls(json.loads((folder / "metrics.json").read_text(encoding="utf-8")))


def figure_faults(values: Mapping[str, Any]) -> Iterator[str]:
    """What is wrong with the entries of `headline` and `stages`, one sentence each."""
    for group in ("headline", "stages"):
        entries = values.get(group)
        if entries is None:
            continue
        if not isinstance(entries, list | tuple):
            yield f"{group} is {type(entries).__name__}, no list"
            continue
        for number, entry in enumerate(entries):
            name = f"{group}[{number}]"
            if not isinstance(entry, Mapping):
                yield f"{name} is {type(entry).__name__}, no mapping"
            elif not isinstance(entry.get("label"), str) or not entry["label"]:
                yield f"{name} has no label"
            elif not isinstance(entry.get("value"), bool | int | float | str):
                yield f"{name} ({entry['label']}) has the value {entry.get('value')!r}: no number, text or bool"
            elif not _are_numbers([entry[key] for key in ("floor", "goal") if entry.get(key) is not None]):
                yield f"{name} ({entry['label']}) has a floor or a goal that is no number"
            elif not isinstance(over := entry.get("over") or {}, Mapping) or not _are_numbers(over.values()):
                yield f"{name} ({entry['label']}) has an `over` that does not map names to numbers"


def _are_numbers(values: Iterable[Any]) -> bool:
    return all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)


@dataclass(frozen=True, eq=False)
class ScoredViews(Artifact):
    """A few of the picture pairs that a score compared, for nodes that draw them (docs/report.md).

    pairs            what each pair is, JSON-like: {kind, name, number, figures}. `kind` is held_out, relit, albedo,
                     roughness or indirect; `name` that of the view or the light; `number` counts the scored ones
    images           float16 [N, 2, H, W, 3], display values in [0, 1]: ours and the truth (indirect: the view as
                     rendered and its interreflected light)
    marks            uint8 [N, H, W] or None: what of a held-out pair counted (COUNTED), was missing (MISSING), or shows
                     surface where none counts (LEAKED); 0 elsewhere, and in pairs of other kinds
    view             name of the middle one of the scored views, of which
    intrinsics       float64 [3, 3], pixels, and
    camera_to_world  float64 [4, 4], OpenCV axes, normalised world, are the camera
    """

    type_name: ClassVar[str] = "ScoredViews"
    conventions: ClassVar[Mapping[str, Any]] = {"color": "display"}
    pairs: tuple[Mapping[str, Any], ...]
    images: np.ndarray
    view: str
    intrinsics: np.ndarray
    camera_to_world: np.ndarray
    marks: np.ndarray | None = None

    COUNTED: ClassVar[int] = 1
    MISSING: ClassVar[int] = 2
    LEAKED: ClassVar[int] = 3

    def save(self, folder: Path) -> None:
        named = {name: getattr(self, name) for name in ("images", "intrinsics", "camera_to_world", "marks")}
        arrays = {name: array for name, array in named.items() if array is not None}
        save_arrays(folder, arrays, {"pairs": list(self.pairs), "view": self.view})

    @classmethod
    def load(cls, folder: Path) -> Self:
        arrays, meta = load_arrays(folder)
        return cls(pairs=tuple(meta["pairs"]), view=meta["view"], **arrays)


@dataclass(frozen=True, eq=False)
class Files(Artifact):
    """A folder of files, kept byte for byte. `root` holds them until the store has its copy.

    `main` names the file a user opens first, relative to `root`.
    """

    type_name: ClassVar[str] = "Files"
    root: Path
    main: str = ""

    @property
    def read_back(self) -> bool:
        return True

    def save(self, folder: Path) -> None:
        (folder / "main.json").write_text(json.dumps({"main": self.main}) + "\n", encoding="utf-8")
        shutil.copytree(self.root, folder / "files")

    @classmethod
    def load(cls, folder: Path) -> Self:
        main = json.loads((folder / "main.json").read_text(encoding="utf-8"))["main"]
        return cls(root=folder / "files", main=main)


@dataclass(frozen=True, eq=False)
class Gallery(Files):
    """Pictures for the report: PNG or WebP files, and models (.glb), under `root` and `captions.json`, a list of
    {file, title, caption, compare?} (docs/report.md).
    """

    type_name: ClassVar[str] = "Gallery"


@dataclass(frozen=True, eq=False)
class UsdAsset(Files):
    """An exported USD asset: `asset.usdz`, `asset.usda` with its layers, `scene.usda`, `textures/`, ...

    `up` is what its stages say of themselves, "y" or "z": no convention of the type, since readers take either.
    """

    type_name: ClassVar[str] = "UsdAsset"
    up: str = "y"

    def save(self, folder: Path) -> None:
        super().save(folder)
        (folder / "up.json").write_text(json.dumps({"up": self.up}) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, folder: Path) -> Self:
        up = json.loads((folder / "up.json").read_text(encoding="utf-8"))["up"]
        return replace(super().load(folder), up=up)

    def facets(self) -> dict[str, Any]:
        return {"up": self.up}


@dataclass(frozen=True, eq=False)
class GltfAsset(Files):
    """An asset as one binary glTF file, in metres."""

    type_name: ClassVar[str] = "GltfAsset"
    conventions: ClassVar[Mapping[str, Any]] = {"up": "y"}


@dataclass(frozen=True, eq=False)
class ObjAsset(Files):
    """An asset as Wavefront OBJ with MTL and pictures."""

    type_name: ClassVar[str] = "ObjAsset"
    conventions: ClassVar[Mapping[str, Any]] = {"up": "y"}
