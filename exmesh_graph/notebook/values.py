"""What each wire type shows of itself."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from exmesh_graph.errors import ExmeshError
from exmesh_graph.notebook import cells
from exmesh_graph.notebook.models import glb_frame, turning
from exmesh_graph.types import (
    Artifact,
    Asset,
    Carrier,
    DepthMaps,
    EnvMap,
    Files,
    Gallery,
    GltfAsset,
    LitViews,
    Mesh,
    Metrics,
    PlanarGaussians,
    PointCloud,
    Region,
    SceneNeeds,
    ScoredViews,
    UsdAsset,
    Views,
)

if TYPE_CHECKING:
    import numpy as np

_MOST_VIEWS = 24
_THUMBNAIL = 110  # pixels high
_MOST_BYTES = 12_000_000  # of pictures in one output
Part = Callable[[Any], str]


def artifact_html(value: Artifact) -> str | None:
    """HTML of a wire type's value; None where nothing is known beyond its `repr`. A wire type of your own shows what
    its `_repr_html_` says.
    """
    own = getattr(type(value), "_repr_html_", None)
    if own is not None:
        return own(value)  # type: ignore[no-any-return]
    show = next((_SHOWN[kind] for kind in type(value).__mro__ if kind in _SHOWN), None)
    if show is None:
        return None
    try:
        inside = show(value)
    except ExmeshError as error:
        inside = cells.said(f"Not shown: {error.what}.", "soft")
    return cells.cell(cells.said(repr(value), "soft"), inside)


def _carrier(carrier: Carrier) -> str:
    from exmesh_graph.gallery.pictures import shrink

    size = carrier.texture.shape[0]
    return turning(carrier) + cells.sheet([(_map(shrink(carrier.texture, 256)), f"texture, {size} x {size}")])


def _asset(asset: Asset) -> str:
    from exmesh_graph.gallery.pictures import asset_maps, environment_panels

    maps = [(_map(image), name.partition(" (")[0]) for name, image in asset_maps(asset, 256).items()]
    light = cells.picture(environment_panels([asset.environment])[0], 128), "environment"
    return turning(asset) + cells.sheet([*maps, light])


def _views(views: Views) -> str:
    from exmesh_graph.gallery.pictures import shrink
    from exmesh_graph.io.images import encode_rgba

    rows = _spread(len(views), _MOST_VIEWS)
    pictures = []
    for i in rows:
        rgb, alpha = shrink(views.images[i], 256), shrink(views.alpha[i], 256)
        pictures.append((cells.picture(encode_rgba(rgb, alpha), _THUMBNAIL), views.names[i]))
    lights = []
    if isinstance(views, LitViews) and views.environments is not None:
        lights = [(_environment(views.environments[i], 64), views.names[i]) for i in rows]
    return _some(rows, views) + cells.sheet(pictures, "mask") + cells.sheet(lights)


def _depths(maps: DepthMaps) -> str:
    import numpy as np

    from exmesh_graph.gallery.pictures import false_colours

    rows = _spread(len(maps.names), _MOST_VIEWS)
    pictures = []
    for i in rows:
        depth = maps.depth[i]
        depth = depth[:: -(-depth.shape[0] // 256), :: -(-depth.shape[1] // 256)]
        known = depth > 0
        near, far = np.quantile(depth[known], [0.02, 0.98]) if known.any() else (0.0, 1.0)
        shade = false_colours((far - depth) / max(far - near, 1e-9))
        words = f"{maps.names[i]}: {near:.3g} to {far:.3g}" if known.any() else f"{maps.names[i]}: none"
        pictures.append((cells.picture(np.concatenate([shade, known[..., None]], -1), _THUMBNAIL), words))
    return _some(rows, maps.names) + cells.said("Near is bright.", "soft") + cells.sheet(pictures, "mask")


def _region(region: Region) -> str:
    rows = _spread(len(region.names), _MOST_VIEWS)
    step = -(-max(region.inside.shape[1:]) // 256)
    pictures = [
        (cells.picture(region.inside[i, ::step, ::step].astype("float32"), _THUMBNAIL),
         f"{region.names[i]}: {region.inside[i].mean():.0%}")
        for i in rows
    ]  # fmt: skip
    return _some(rows, region.names) + cells.said("White counts.", "soft") + cells.sheet(pictures, "mask")


def _env_map(value: EnvMap) -> str:
    return cells.sheet([(_environment(value.radiance, 160), "up is up, the centre looks along +Z")])


def _metrics(metrics: Metrics) -> str:
    """Headline figures as tiles, histories as curves, all other figures in a table."""
    from exmesh_graph.report.charts import line_chart, thin
    from exmesh_graph.report.collect import curves_of
    from exmesh_graph.report.page import metric_rows
    from exmesh_graph.report.text import number

    values = metrics.values
    heads = [entry for entry in values.get("headline") or () if "label" in entry and "value" in entry]
    shown = [
        (str(entry["label"]), f"{number(entry['value'])} {entry.get('unit') or ''}".rstrip(),
         "" if entry.get("floor") is None else f"uninformed guess {number(entry['floor'])}")
        for entry in heads
    ]  # fmt: skip
    charts, drawn = [], set()
    for curve in curves_of(values, ""):
        drawn |= {curve.name, curve.axis}
        keep = thin(curve.positions)
        line = (curve.name, [curve.positions[k] for k in keep], [curve.values[k] for k in keep])
        charts.append(line_chart([line], title=curve.name, x_label=curve.axis, width=300, height=180))
    rows = [(name, text) for name, text in metric_rows(values) if name.split(" · ")[-1] not in drawn]
    listed = cells.table(rows)
    parts = [cells.tiles(shown) if shown else "", f'<div class="charts">{"".join(charts)}</div>' if charts else ""]
    return "".join(parts) + (cells.folded(f"{len(rows)} figures", listed) if len(rows) > 12 else listed)


def _gallery(gallery: Gallery) -> str:
    from exmesh_graph.report.text import size

    parts, budget = [], _MOST_BYTES
    for entry in json.loads((gallery.root / "captions.json").read_text(encoding="utf-8")):
        file, title, caption = gallery.root / entry["file"], entry.get("title", ""), entry.get("caption", "")
        data = file.read_bytes()
        if len(data) > budget:
            parts.append(cells.said(f"{title}: {file} ({size(len(data))})", "soft"))
            continue
        budget -= len(data)
        if file.suffix == ".glb":
            parts.append(glb_frame(data, caption))
        else:
            parts.append(cells.sheet([(_stored(data, file.suffix), f"{title}. {caption}")]))
    return "".join(parts)


def _stored(data: bytes, suffix: str) -> str:
    """A picture file, smaller where it is wide."""
    import io

    import numpy as np
    from PIL import Image

    if suffix == ".webp":  # a film
        import base64

        return f'<img src="data:image/webp;base64,{base64.b64encode(data).decode("ascii")}" alt="">'
    image = Image.open(io.BytesIO(data)).convert("RGB")
    image.thumbnail((960, 480))
    return cells.picture(np.asarray(image, np.float32) / 255)


def _usd(files: UsdAsset) -> str:
    from exmesh_graph.export.usd.read import read_usd

    return turning(read_usd(files.root / files.main).asset(), f"As {files.main} holds it.") + _files(files)


def _gltf(files: GltfAsset) -> str:
    from exmesh_graph.export.gltf import read_glb
    from exmesh_graph.export.gltf_compact import compact_glb
    from exmesh_graph.gallery.models import LIGHT_WIDTH, equirectangular
    from exmesh_graph.report.view.page import studio

    light = equirectangular(studio(), LIGHT_WIDTH)
    data = compact_glb(*read_glb(files.root / files.main), unlit=False, light=light, eye=None)
    return glb_frame(data, f"{files.main} in a studio: glTF holds no environment.") + _files(files)


def _scored(scored: ScoredViews) -> str:
    from exmesh_graph.gallery.pictures import strip

    shown = []
    for pair, (ours, truth) in zip(scored.pairs, scored.images.astype("float32"), strict=True):
        shown.append(
            (cells.picture(strip([ours, truth]), 150), f"{pair['kind'].replace('_', ' ')} {pair.get('name') or ''}")
        )
    return cells.said("Ours, truth.", "soft") + cells.sheet(shown)


def _files(files: Files) -> str:
    from exmesh_graph.report.text import size

    listed = sorted(path for path in files.root.rglob("*") if path.is_file())
    rows = [(str(path.relative_to(files.root)), size(path.stat().st_size)) for path in listed]
    return cells.said(str(files.root), "soft") + cells.folded(f"{len(rows)} files", cells.table(rows))


def _needs(needs: SceneNeeds) -> str:
    from exmesh_graph.report.text import number

    rows = []
    for name, choice in needs.decisions.items():
        gain = "" if choice.gain is None else f"{choice.gain:+.2f} dB"
        rows.append((name, number(choice.value), gain, f"{100 * (choice.cost - 1):+.0f} %", choice.reason))
    return cells.table(rows, ["parameter", "auto is", "gain", "work", "why"])


def _gaussians(gaussians: PlanarGaussians) -> str:
    colours = 0.5 + 0.28209479 * gaussians.sh[:, 0]
    return cells.sheet([(_cloud(gaussians.means, colours), "means, in their colours from the front")])


def _points(points: PointCloud) -> str:
    return cells.sheet([(_cloud(points.points, points.colours), "as seen from +Z")])


def _cloud(points: np.ndarray, colours: np.ndarray, size: int = 280) -> str:
    """Points about the origin in parallel projection along -Z, those in front last."""
    import numpy as np

    inside = np.flatnonzero(np.abs(points).max(axis=1) < 1.1)
    order = inside[np.argsort(points[inside, 2], kind="stable")]
    column, row = (
        np.round((0.5 + sign * points[order, axis] / 2.2) * (size - 1)).astype(int) for axis, sign in ((0, 1), (1, -1))
    )
    image = np.zeros((size, size, 4), np.float32)
    image[row, column] = np.concatenate([colours[order], np.ones((len(order), 1))], axis=1)
    return cells.picture(image, size)


def _map(image: np.ndarray) -> str:
    return cells.picture(image, 128)


def _environment(radiance: np.ndarray, height: int) -> str:
    from exmesh_graph.gallery.pictures import environment_panels

    return cells.picture(environment_panels([radiance])[0], height)


def _some(rows: list[int], of: Any) -> str:
    return cells.said(f"{len(rows)} of {len(of)}, evenly spread:", "soft") if len(rows) < len(of) else ""


def _spread(count: int, most: int) -> list[int]:
    """At most `most` rows of `count`, evenly spread."""
    return [count * k // min(count, most) for k in range(min(count, most))]


_SHOWN: dict[type, Part] = {
    Mesh: turning, Carrier: _carrier, Asset: _asset, Views: _views, DepthMaps: _depths, Region: _region,
    EnvMap: _env_map,
    Metrics: _metrics, Gallery: _gallery, UsdAsset: _usd, GltfAsset: _gltf, Files: _files,
    ScoredViews: _scored, SceneNeeds: _needs, PlanarGaussians: _gaussians, PointCloud: _points,
}  # fmt: skip
