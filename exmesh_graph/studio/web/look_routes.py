"""Endpoints of artifacts: what looks there are, and each look. An artifact is named by its digest, so that an answer
is right for ever and browsers may keep it.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from starlette.responses import FileResponse, Response
from starlette.routing import Route

from exmesh_graph.errors import ExmeshError
from exmesh_graph.studio.artifacts.shelf import NoArtifact, Shelf, is_digest
from exmesh_graph.studio.web.answers import BadRequest, Query, Unknown, asked, json_answer
from exmesh_graph.studio.web.guard import SANDBOX
from exmesh_graph.studio.workspace import Workspace

_KEEP = {"cache-control": "private, max-age=31536000, immutable"}
_PICTURES = {".png": "image/png", ".webp": "image/webp", ".glb": "model/gltf-binary"}
_LIGHTS = ("recovered", "studio", "overcast")


def artifact(workspace: Workspace, query: Query) -> Any:
    from exmesh_graph.studio.artifacts.shows import shows_of

    return _kept(query, json_answer(shows_of(workspace.shelf, query.needed("digest"))))


def picture(workspace: Workspace, query: Query) -> Any:
    from exmesh_graph.studio.artifacts import pictures

    digest, show, side = query.needed("digest"), query.get("show", "views"), query.whole("size", 0, 0, 8192)
    layer = query.get("layer") or query.get("name") or "image"
    index, exposure = query.whole("index", 0), _number(query.get("exposure", "0"))
    exact = layer == "mask"
    key = ("picture", digest, show, layer, index, side, exposure)

    def make() -> bytes:
        return pictures.encoded(
            pictures.picture(workspace.shelf, digest, show, layer, index, side, exposure), exact=exact
        )

    kind = "image/png" if exact else "image/webp"
    return _answer(workspace.shelf.made(key, make) if side else make(), kind, query)


def contact(workspace: Workspace, query: Query) -> Any:
    from exmesh_graph.studio.artifacts import pictures

    side, count = query.whole("size", 96, 16, 512), query.whole("count", 64, 1, 256)
    sheet = pictures.contact_sheet(
        workspace.shelf, query.needed("digest"), query.get("show", "views"), query.get("layer", "image"), side,
        query.whole("from", 0), count,
    )  # fmt: skip
    told = {"x-columns": str(sheet.columns), "x-rows": str(sheet.rows), "x-tile": f"{sheet.width}x{sheet.height}"}
    return _answer(sheet.data, "image/webp", query, told)


def model(workspace: Workspace, query: Query) -> Any:
    from exmesh_graph.gallery.levels import levels_of, model_level
    from exmesh_graph.types import Mesh, SceneTruth

    digest, number = query.needed("digest"), query.whole("level", 0, 0, 9)
    value = workspace.shelf.value(digest)
    if isinstance(value, SceneTruth) and value.mesh_vertices is not None and value.mesh_faces is not None:
        value = Mesh(value.mesh_vertices, value.mesh_faces)
    if not isinstance(value, Mesh):
        raise NoArtifact(f"{value.type_name} has no mesh")
    mesh, levels = value, levels_of(value)
    level = levels[min(number, len(levels) - 1)]

    def make() -> bytes:
        data, faces = model_level(mesh, level)
        return struct.pack("<I", faces) + data

    made = workspace.shelf.made(("model", digest, level), make)
    told = {"x-levels": str(len(levels)), "x-faces": str(struct.unpack_from("<I", made)[0])}
    return _answer(made[4:], "model/gltf-binary", query, told)


def points(workspace: Workspace, query: Query) -> Any:
    from exmesh_graph.studio.artifacts.tables import point_rows

    value = workspace.shelf.value(query.needed("digest"))
    return _answer(point_rows(value, query.whole("level", 0, 0, 9)), "application/octet-stream", query)


def cameras(workspace: Workspace, query: Query) -> Any:
    from exmesh_graph.studio.artifacts.tables import camera_facts
    from exmesh_graph.types import Views

    digest = query.needed("digest")
    if not issubclass(workspace.shelf.kind(digest), Views):
        raise NoArtifact("the artifact has no cameras")
    return _kept(query, json_answer(camera_facts(workspace.shelf.arrays(digest))))


def table(workspace: Workspace, query: Query) -> Any:
    from exmesh_graph.studio.artifacts.tables import table_of

    return _kept(query, json_answer(table_of(workspace.shelf.value(query.needed("digest")))))


def curves(workspace: Workspace, query: Query) -> Any:
    from exmesh_graph.studio.artifacts.tables import curve_facts

    return _kept(query, json_answer({"curves": curve_facts(_metrics(workspace.shelf, query))}))


def figures(workspace: Workspace, query: Query) -> Any:
    from exmesh_graph.studio.artifacts.tables import figures_of

    return _kept(query, json_answer(figures_of(_metrics(workspace.shelf, query))))


def environment(workspace: Workspace, query: Query) -> Any:
    value = workspace.shelf.value(query.needed("digest"))
    radiance = getattr(value, "radiance", None)
    radiance = getattr(value, "environment", None) if radiance is None else radiance
    if radiance is None:
        raise NoArtifact(f"{value.type_name} has no environment")
    return _light(radiance, query)


def light(workspace: Workspace, query: Query) -> Any:
    """A built-in light, or one of a file in the graph's folder."""
    from exmesh_graph.report.view.page import overcast, studio

    name = query.needed("name")
    made = {"studio": studio, "overcast": overcast}.get(name)
    return _light(made() if made is not None else workspace.places.light(name), query)


def lights(workspace: Workspace, query: Query) -> Any:
    return {"lights": [*_LIGHTS, *workspace.places.lights()]}


def file(workspace: Workspace, query: Query) -> Any:
    """A file of a Files artifact, to be saved: never shown as a page of this server."""
    from exmesh_graph.types import Files

    value = workspace.shelf.value(query.needed("digest"))
    if not isinstance(value, Files):
        raise NoArtifact(f"{value.type_name} has no files")
    path = _inside(value.root, query.needed("path"))
    return FileResponse(path, media_type="application/octet-stream", filename=path.name, headers=_KEEP)


def gallery(workspace: Workspace, query: Query) -> Any:
    from exmesh_graph.types import Gallery

    value = workspace.shelf.value(query.needed("digest"))
    if not isinstance(value, Gallery):
        raise NoArtifact(f"{value.type_name} has no pictures")
    path = _inside(value.root, query.needed("file"))
    if path.suffix not in _PICTURES:
        raise Unknown(f"{path.name} is no picture")
    return FileResponse(path, media_type=_PICTURES[path.suffix], headers=_KEEP)


def view(workspace: Workspace, query: Query) -> Any:
    """The page of `exmesh view` for an asset, sandboxed."""
    from exmesh_graph.report.view.page import view_page
    from exmesh_graph.types import Asset

    digest = query.needed("digest")
    value = workspace.shelf.value(digest)
    if not isinstance(value, Asset):
        raise NoArtifact(f"{value.type_name} has no page of its own")
    asset = value
    data = workspace.shelf.made(("view", digest), lambda: view_page(asset, digest[:12]).encode())
    return _answer(data, "text/html; charset=utf-8", query, {"content-security-policy": SANDBOX})


def seen(work: Callable[[Workspace, Query], Any]) -> Any:
    """The endpoint of a look: an artifact that is not what its type says is told of, whoever made it."""

    @functools.wraps(work)
    def looked(workspace: Workspace, query: Query) -> Any:
        try:
            return work(workspace, query)
        except (ExmeshError, RecursionError):
            raise
        except Exception as error:  # of the libraries that read it
            what = f"this cannot be shown: {type(error).__name__}: {str(error)[:200]}"
            raise NoArtifact(what, fix="run the graph again: it is made anew") from error

    return asked(looked)


ROUTES = [
    Route("/api/artifact", seen(artifact)),
    Route("/api/artifact/picture", seen(picture)),
    Route("/api/artifact/contact", seen(contact)),
    Route("/api/artifact/model", seen(model)),
    Route("/api/artifact/points", seen(points)),
    Route("/api/artifact/cameras", seen(cameras)),
    Route("/api/artifact/table", seen(table)),
    Route("/api/artifact/curves", seen(curves)),
    Route("/api/artifact/figures", seen(figures)),
    Route("/api/artifact/environment", seen(environment)),
    Route("/api/artifact/file", seen(file)),
    Route("/api/artifact/gallery", seen(gallery)),
    Route("/api/artifact/view", seen(view)),
    Route("/api/light", seen(light)),
    Route("/api/lights", asked(lights)),
]


def _light(radiance: Any, query: Query) -> Response:
    from exmesh_graph.gallery.models import equirectangular

    made = equirectangular(radiance, query.whole("width", 256, 16, 4096))
    head = struct.pack("<II", made.shape[1], made.shape[0])
    return _answer(head + made.tobytes(), "application/octet-stream", query)


def _metrics(shelf: Shelf, query: Query) -> Mapping[str, Any]:
    from exmesh_graph.types import Metrics

    value = shelf.value(query.needed("digest"))
    if not isinstance(value, Metrics):
        raise NoArtifact(f"{value.type_name} has no figures")
    return value.values


def _inside(root: Path, name: str) -> Path:
    """A file below a folder; what leads out of it, also by a link, is not there."""
    path = (root / name).resolve() if "\0" not in name and len(name) < 1000 else root
    if not path.is_relative_to(root.resolve()) or not path.is_file():
        raise Unknown(f"there is no file {name[:80]!r}")
    return path


def _answer(data: bytes, kind: str, query: Query, more: Mapping[str, str] | None = None) -> Response:
    return _kept(query, Response(data, media_type=kind, headers=dict(more or {})))


def _kept(query: Query, response: Response) -> Response:
    """An answer that browsers may keep: the bytes behind a digest never change."""
    if is_digest(query.get("digest", "")):
        tag = f'"{query["digest"][:40]}"'
        response.headers.update({**_KEEP, "etag": tag})
        if query.headers.get("if-none-match") == tag:
            return Response(status_code=304, headers={**_KEEP, "etag": tag})
    return response


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise BadRequest(f"{text[:40]!r} is no number") from None
    if not -30 <= value <= 30:  # NaN, too
        raise BadRequest(f"{text[:40]!r} is out of range", expected="-30 to 30")
    return value
