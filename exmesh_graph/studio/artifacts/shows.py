"""Which looks an artifact has: the answer of `GET /api/artifact`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from exmesh_graph.gallery.levels import levels_for
from exmesh_graph.report.collect import curves_of
from exmesh_graph.studio.artifacts.shelf import Shelf
from exmesh_graph.studio.artifacts.tables import decision_rows, transport_facts
from exmesh_graph.studio.values import plain
from exmesh_graph.types import (
    Artifact,
    Asset,
    Carrier,
    DepthMaps,
    EnvMap,
    Files,
    Gallery,
    LitViews,
    Mesh,
    Metrics,
    PlanarGaussians,
    PointCloud,
    Region,
    SceneNeeds,
    SceneTruth,
    ScoredViews,
    Stage1State,
    Transport,
    Views,
)

MAPS = ("base_color", "roughness", "metallic", "normal", "confidence", "seen", "texture")
_STACKS = {"albedo": "albedo", "roughness": "roughness", "depth": "depth", "normal": "normal"}  # of the truth


def shows_of(shelf: Shelf, digest: str) -> dict[str, Any]:
    """ARTIFACT of the contract. Raises NoArtifact, StoreError."""
    kind = shelf.kind(digest)
    shows = list(_shows(shelf, digest, kind))
    facts: dict[str, Any] = next((show["facts"] for show in shows if show["kind"] == "facts"), {})
    told = ", ".join(f"{name} {value}" for name, value in list(facts.items())[:4])
    return {
        "digest": digest, "type": kind.type_name, "bytes": shelf.size(digest),
        "title": f"{kind.type_name}: {told}" if told else kind.type_name, "shows": shows,
    }  # fmt: skip


def _shows(shelf: Shelf, digest: str, kind: type[Artifact]) -> Iterator[dict[str, Any]]:
    if issubclass(kind, Views):
        yield from _views(shelf, digest, kind)
    elif issubclass(kind, DepthMaps | Region):
        arrays = shelf.arrays(digest)
        name, layers = ("depth", ["depth"]) if issubclass(kind, DepthMaps) else ("inside", ["mask", "near", "far"])
        yield _sheet("maps", arrays.meta()["names"], arrays.shapes()[name], layers)
        yield _facts({"maps": arrays.shapes()[name][0], "size": _size(arrays.shapes()[name][1:])})
    elif issubclass(kind, SceneTruth):
        yield from _truth(shelf, digest)
    elif issubclass(kind, ScoredViews):
        arrays = shelf.arrays(digest)
        shape, pairs = arrays.shapes()["images"], arrays.meta()["pairs"]
        names = [" ".join(str(pair.get(key, "")) for key in ("kind", "name")).strip() for pair in pairs]
        marks = ["marks"] if "marks" in arrays.shapes() else []
        yield _sheet("pairs", names, (shape[0], *shape[2:]), ["ours", "truth", "error", "beside", *marks])
        yield _facts({"pairs": shape[0], "size": _size(shape[2:4])})
    elif issubclass(kind, Mesh):
        yield from _mesh(shelf, digest, kind)
    else:
        yield from _others(shelf.value(digest))


def _views(shelf: Shelf, digest: str, kind: type[Views]) -> Iterator[dict[str, Any]]:
    arrays = shelf.arrays(digest)
    meta, shape = arrays.meta(), arrays.shapes()["alpha"]
    yield _sheet("views", meta["names"], shape, ["image", "mask", "overlay"] if meta.get("has_masks") else ["image"])
    yield {"kind": "cameras", "id": "cameras", "title": "cameras"}
    if issubclass(kind, LitViews):
        yield _sheet("lights", meta["names"], arrays.shapes()["environments"], ["image"])
    yield _facts({"views": shape[0], "size": _size(shape[1:]), "split": meta.get("split", ""),
                  "masks": bool(meta.get("has_masks"))})  # fmt: skip


def _truth(shelf: Shelf, digest: str) -> Iterator[dict[str, Any]]:
    arrays = shelf.arrays(digest)
    meta, shapes = arrays.meta(), arrays.shapes()
    if "mesh_vertices" in shapes and "mesh_faces" in shapes:
        faces, vertices = shapes["mesh_faces"][0], shapes["mesh_vertices"][0]
        yield {"kind": "model", "id": "model", "title": "true mesh", "levels": 2 if faces > 40_000 else 1,
               "has": ["normals"], "faces": faces, "vertices": vertices}  # fmt: skip
    layers = [name for name in _STACKS if name in shapes]
    if layers:
        yield _sheet("truth", meta["names"], shapes[layers[0]], layers)
    for name in meta.get("relit", ()):
        yield _sheet(f"relit/{name}", meta["names"], shapes[f"relit/{name}/images"], ["image"], f"relit: {name}")
    if "environment" in shapes:
        yield _environment(shapes["environment"])
    yield _facts({"views": len(meta["names"]), "relit": ", ".join(meta.get("relit", ()))})


def _mesh(shelf: Shelf, digest: str, kind: type[Mesh]) -> Iterator[dict[str, Any]]:
    shapes, fields = shelf.outline(digest)
    faces, vertices, lit = shapes["faces"][0], shapes["vertices"][0], issubclass(kind, Asset)
    maps = shapes["base_color" if lit else "texture"] if issubclass(kind, Carrier) else (0, 0)
    flat = issubclass(kind, Carrier) and shapes["uvs"][0] > 0
    has = ["normals", *(["uv", "texture"] if flat else []), *(["pbr"] if lit else [])]
    yield {"kind": "model", "id": "model", "title": "mesh", "levels": len(levels_for(faces, max(maps[:2]))), "has": has,
           "faces": faces, "vertices": vertices}  # fmt: skip
    facts: dict[str, Any] = {"faces": faces, "vertices": vertices}
    if issubclass(kind, Carrier):
        facts["texture"] = _size(shapes["texture"])
        if flat:
            yield {"kind": "picture", "id": "atlas", "title": "atlas with stretch",
                   "layers": ["stretch", "anisotropy", "texture", "all"], "caption": ""}  # fmt: skip
    if lit:
        yield {"kind": "maps", "id": "maps", "title": "maps", "names": [name for name in MAPS if name in shapes],
               "size": maps[0]}  # fmt: skip
        yield _environment(shapes["environment"])
        yield {"kind": "viewer", "id": "viewer", "title": "under any light"}
        facts["maps"] = _size(maps)
    elif issubclass(kind, Carrier):
        yield {"kind": "maps", "id": "maps", "title": "texture", "names": ["texture"], "size": maps[0]}
    if issubclass(kind, Stage1State):
        facts |= {"iteration": fields["iteration"], "appearance": fields["appearance"]}
    yield _facts(facts)


def _others(value: Artifact) -> Iterator[dict[str, Any]]:
    if isinstance(value, EnvMap):
        yield _environment(value.radiance.shape)
        yield _facts({"size": _size(value.radiance.shape)})
    elif isinstance(value, PlanarGaussians | PointCloud):
        title = "Gaussians" if isinstance(value, PlanarGaussians) else "points"
        yield {"kind": "points", "id": "points", "title": title, "count": len(value)}
        yield _facts({title: len(value)})
    elif isinstance(value, Transport):
        yield {"kind": "table", "id": "transport", "title": "transport"}
        yield {"kind": "points", "id": "points", "title": "open sky at each point", "count": len(value.points)}
        yield _facts({row[0]: row[1] for row in transport_facts(value)})
    elif isinstance(value, SceneNeeds):
        yield {"kind": "table", "id": "decisions", "title": "decisions"}
        yield _facts({name: plain(one.value) for name, one in value.decisions.items()})
    elif isinstance(value, Metrics):
        yield from _metrics(value.values)
    elif isinstance(value, Gallery):
        yield {"kind": "gallery", "id": "gallery", "title": "pictures", "items": gallery_items(value)}
    elif isinstance(value, Files):
        yield {"kind": "files", "id": "files", "title": "files", "main": value.main, "files": file_list(value)}
    else:
        yield _facts({"is": repr(value)})


def _metrics(values: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    if values.get("headline") or not list(curves_of(values, "")):
        yield {"kind": "figures", "id": "figures", "title": "figures"}
    if decision_rows(values):
        yield {"kind": "table", "id": "decisions", "title": "decisions"}
    if list(curves_of(values, "")):
        yield {"kind": "curves", "id": "history", "title": "histories"}
    headline = values.get("headline")
    if isinstance(headline, list):
        yield _facts({str(one.get("label")): one.get("value") for one in headline if isinstance(one, Mapping)})


def gallery_items(gallery: Gallery) -> list[dict[str, Any]]:
    """The pictures and models of a gallery with their captions."""
    import json

    captions = json.loads((gallery.root / "captions.json").read_text(encoding="utf-8"))
    return [
        {"file": str(one["file"]), "title": str(one.get("title", "")), "caption": str(one.get("caption", "")),
         "compare": int(one.get("compare") or 0), "model": str(one["file"]).endswith(".glb")}
        for one in captions
    ]  # fmt: skip


def file_list(files: Files) -> list[dict[str, Any]]:
    """The files of a Files artifact."""
    paths = sorted(path for path in files.root.rglob("*") if path.is_file() and not path.is_symlink())
    return [{"path": str(path.relative_to(files.root)), "bytes": path.stat().st_size} for path in paths[:2000]]


def _sheet(name: str, names: Any, shape: tuple[int, ...], layers: list[str], title: str = "") -> dict[str, Any]:
    return {"kind": "sheet", "id": name, "title": title or f"{shape[0]} {name}", "count": shape[0],
            "names": [str(one) for one in names], "layers": layers, "height": shape[1], "width": shape[2]}  # fmt: skip


def _environment(shape: tuple[int, ...]) -> dict[str, Any]:
    return {"kind": "environment", "id": "environment", "title": "environment", "height": shape[0], "width": shape[1]}


def _facts(facts: Mapping[str, Any]) -> dict[str, Any]:
    return {"kind": "facts", "id": "facts", "title": "facts", "facts": plain(facts)}


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} x {shape[0]}"
