"""What the variants of a sweep look like: comparisons of any two of them, and their models.

The first repeat of each variant is shown. Pictures are stored again as WebP of quality 90, so that a sweep of thirty
variants stays one page; what is equal in several variants is there once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from exmesh_graph.report.collect import gallery_of
from exmesh_graph.report.contents import GalleryItem
from exmesh_graph.report.templates import data_uri, page_of
from exmesh_graph.report.widgets import GAP, panel_size

PICTURE_BYTES, MODEL_BYTES = 12_000_000, 6_000_000
"""Of a page, before base64 (and, for models, before compression)."""

Key = tuple[str, str]
"""(file, variant)"""


@dataclass
class Comparison:
    """One picture of a node's gallery in all variants that have it: index of its strip, and caption, by variant."""

    node: str
    title: str
    panels: int
    size: tuple[int, int]
    strips: dict[Key, int] = field(default_factory=dict)
    captions: dict[Key, str] = field(default_factory=dict)


@dataclass
class SweepPictures:
    """Pictures and models of a sweep; `strips` are WebP files."""

    comparisons: list[Comparison] = field(default_factory=list)
    strips: list[bytes] = field(default_factory=list)
    models: list[tuple[list[Key], GalleryItem]] = field(default_factory=list)
    pictures_left_out: int = 0
    models_left_out: int = 0


def sweep_pictures(
    record: Mapping[str, Any], members: Sequence[Mapping[str, Any]], load_artifact: Callable[[str], Any]
) -> SweepPictures:
    """Read the galleries of a merged run; `members` as for `sweep_table`.

    Pictures are taken in the order of the galleries, of the last node first, one of each kind before the second of any,
    each for all variants, until `PICTURE_BYTES` are full; models in the order of the variants.
    """
    rows = {row["name"]: row for row in record["nodes"]}
    first: dict[Key, Mapping[str, Any]] = {}
    for member in members:
        first.setdefault((member["file"], member["variant"]), member)
    galleries: dict[str, list[GalleryItem]] = {}
    compared: dict[tuple[Any, ...], dict[Key, GalleryItem]] = {}
    models: dict[bytes, tuple[list[Key], GalleryItem]] = {}
    for key, member in first.items():
        last = None
        for own, name in reversed(member["nodes"].items()):
            for output in (rows.get(name, {}).get("outputs") or {}).values():
                if output["type"] != "Gallery":
                    continue
                digest = output["digest"]
                if digest not in galleries:
                    galleries[digest] = gallery_of(Path(load_artifact(digest).root), own)
                for one in galleries[digest]:
                    if one.is_model:
                        last = last or one
                    elif size := panel_size(one):  # the title names the view: other scenes are not compared
                        compared.setdefault((own, one.file, one.title, one.panels, size), {})[key] = one
        if last is not None:
            models.setdefault(last.data, ([], last))[0].append(key)
    shown = SweepPictures()
    _add_comparisons(shown, compared)
    room = MODEL_BYTES
    for keys, model in models.values():
        room -= len(model.data)
        if room >= 0 or not shown.models:
            shown.models.append((keys, model))
        else:
            shown.models_left_out += len(keys)
    return shown


def versus_section(shown: SweepPictures, labels: Mapping[Key, str], best: tuple[Key, str] | None) -> str:
    """HTML of the comparisons, with a choice of the picture and of what is left and right of the line; "" without."""
    if not shown.comparisons:
        return ""
    names = {key: label for key, label in labels.items() if any(key in c.strips for c in shown.comparisons)}
    if best is not None and best[0] in names:
        names[best[0]] += f" (best: {best[1]})"
    order = list(names)
    data = {
        "gap": GAP,
        "variants": list(names.values()),
        "strips": [data_uri("image/webp", strip) for strip in shown.strips],
        "pictures": [
            {"title": f"{c.title} ({c.node})", "panels": c.panels, "size": c.size,
             "strips": {order.index(key): index for key, index in c.strips.items()},
             "captions": {order.index(key): text for key, text in c.captions.items()}}
            for c in shown.comparisons
        ],
    }  # fmt: skip
    return page_of(__package__, "versus.html", data=data, left_out=shown.pictures_left_out)


def _add_comparisons(shown: SweepPictures, compared: Mapping[tuple[Any, ...], Mapping[Key, GalleryItem]]) -> None:
    from exmesh_graph.export.gltf_compact import as_webp

    kinds: Counter[tuple[str, str]] = Counter()
    ranks = {}
    for name in compared:
        kind = name[0], name[2].partition(" ")[0]
        ranks[name] = kinds[kind]
        kinds[kind] += 1
    order = sorted(compared, key=ranks.__getitem__)
    at: dict[bytes, int] = {}
    room = PICTURE_BYTES
    for number, name in enumerate(order):
        node, _, title, panels, size = name
        comparison = Comparison(node, title, panels, size)
        for key, picture in compared[name].items():
            if picture.data not in at:
                at[picture.data] = len(shown.strips)
                shown.strips.append(as_webp(picture.data, quality=90))
                room -= len(shown.strips[-1])
            comparison.strips[key], comparison.captions[key] = at[picture.data], picture.caption
        shown.comparisons.append(comparison)
        if room < 0:
            shown.pictures_left_out = len(order) - number - 1
            return
