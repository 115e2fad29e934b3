"""Composing the pictures of a Gallery: strips of panels, error maps, environments, atlases."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import binary_erosion

from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.io.images import write_image
from exmesh_graph.types import Asset, Gallery, ScoredViews

ERROR_TOP = 0.2
"""The display-space error shown as the brightest colour of an error map."""

_GAP = 6
_OUTLINE, _MISSING, _LEAKED = (1.0, 0.9, 0.1), (0.9, 0.1, 0.8), (0.1, 0.8, 0.9)
# Dark to bright through purple and orange; readable in gray and by colour-blind readers.
_RAMP = np.array([[0.0, 0.0, 0.02], [0.34, 0.06, 0.43], [0.73, 0.21, 0.33], [0.98, 0.55, 0.04], [0.99, 1.0, 0.64]])


class GalleryWriter:
    """Collects pictures into a folder: PNG (or WebP) files, models (.glb) and `captions.json`."""

    def __init__(self, root: Path) -> None:
        root.mkdir(parents=True, exist_ok=True)
        self.root = root
        self._captions: list[dict[str, Any]] = []

    def add(self, file: str, title: str, caption: str, panels: Sequence[np.ndarray], *, compare: bool = False) -> None:
        """Write `panels` (display values in [0, 1]; [H, W, 3] or [H, W]) side by side as `file`.png.

        `compare`: the first two are ours and the truth, which the page lays over each other with a slider.
        """
        write_image(self.claim(f"{file}.png", title, caption), strip(panels))
        if compare and len({panel.shape[:2] for panel in panels}) == 1:
            self._captions[-1]["compare"] = len(panels)

    def claim(self, file: str, title: str, caption: str) -> Path:
        """Enter what the caller writes to the returned path: PNG, animated WebP, or a model (view.model) as .glb."""
        self._captions.append({"file": file, "title": title, "caption": caption})
        return self.root / file

    def remark(self, text: str) -> None:
        """Add a sentence to the caption of what was entered last."""
        self._captions[-1]["caption"] += f" {text}"

    def finish(self) -> Gallery:
        """Write the captions; the Gallery artifact."""
        text = json.dumps(self._captions, indent=1, ensure_ascii=False)
        (self.root / "captions.json").write_text(text + "\n", encoding="utf-8")
        return Gallery(root=self.root, main=self._captions[0]["file"] if self._captions else "")


def strip(panels: Sequence[np.ndarray]) -> np.ndarray:
    """Panels of one height side by side [H, W, 3], with a white gap between."""
    colored = [np.repeat(p[..., None], 3, axis=2) if p.ndim == 2 else p for p in panels]
    height = max(panel.shape[0] for panel in colored)
    parts: list[np.ndarray] = []
    for panel in colored:
        parts += [resize(panel, height), np.ones((height, _GAP, 3))]
    return np.clip(np.concatenate(parts[:-1], axis=1), 0.0, 1.0)


def stack(rows: Sequence[np.ndarray]) -> np.ndarray:
    """Pictures [H, W, 3] above each other [H, W, 3] on white, with the same gap."""
    width = max(row.shape[1] for row in rows)
    parts: list[np.ndarray] = []
    for row in rows:
        parts += [np.pad(row, ((0, 0), (0, width - row.shape[1]), (0, 0)), constant_values=1.0)]
        parts += [np.ones((_GAP, width, 3))]
    return np.concatenate(parts[:-1])


def error_map(ours: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Mean absolute error over the channels of two display images, in false colours, full at `ERROR_TOP`."""
    return false_colours(np.abs(ours - truth).mean(axis=-1) / ERROR_TOP)


def marked(picture: np.ndarray, marks: np.ndarray) -> np.ndarray:
    """The picture [H, W, 3] in gray: what counts outlined in yellow, of it missing magenta, surface outside cyan.

    marks  uint8 [H, W], as in ScoredViews
    """
    gray = np.repeat(picture.mean(axis=-1, keepdims=True), 3, axis=-1)
    inside = (marks == ScoredViews.COUNTED) | (marks == ScoredViews.MISSING)
    gray[marks == ScoredViews.MISSING] = _MISSING
    gray[marks == ScoredViews.LEAKED] = 0.5 * gray[marks == ScoredViews.LEAKED] + 0.5 * np.array(_LEAKED)
    gray[inside & ~binary_erosion(inside, border_value=1)] = _OUTLINE
    return gray


def false_colours(values: np.ndarray) -> np.ndarray:
    """Values [...], cut off at 0 and 1, as colours [..., 3] from dark to bright."""
    position = np.clip(values, 0.0, 1.0) * (len(_RAMP) - 1)
    low = np.minimum(position.astype(int), len(_RAMP) - 2)
    part = (position - low)[..., None]
    return (1.0 - part) * _RAMP[low] + part * _RAMP[low + 1]


def environment_panels(maps: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Environments [h, w, 3] at one height and, by the first one's 90th percentile, at one exposure."""
    exposure = 0.7 / max(float(np.quantile(maps[0], 0.9)), 1e-6)
    height = max(192, max(image.shape[0] for image in maps))
    return [linear_to_srgb(np.clip(resize(image * exposure, height), 0.0, 1.0)) for image in maps]


def asset_maps(asset: Asset, largest: int = 512) -> dict[str, np.ndarray]:
    """Display values of an asset's maps by name, no side above `largest`; `seen` where there is no confidence."""
    maps = {"base colour": linear_to_srgb(shrink(asset.base_color, largest)), "roughness": asset.roughness}
    if asset.metallic is not None:
        maps["metallic"] = asset.metallic
    if asset.normal is not None:
        maps["normals"] = 0.5 + 0.5 * asset.normal
    if asset.confidence is None:
        maps["texels that a training view saw"] = asset.seen.astype(np.float32)
    else:
        maps["confidence (0 where no view saw the texel)"] = asset.confidence
    return {name: shrink(image, largest) for name, image in maps.items()}


def shrink(image: np.ndarray, largest: int = 512) -> np.ndarray:
    """Box-averaged by a whole factor until no side exceeds `largest`."""
    factor = -(-max(image.shape[:2]) // largest)
    if factor == 1:
        return image
    height, width = (n // factor * factor for n in image.shape[:2])
    blocks = image[:height, :width].reshape(height // factor, factor, width // factor, factor, -1)
    return blocks.mean(axis=(1, 3)).reshape(height // factor, width // factor, *image.shape[2:])


def resize(image: np.ndarray, height: int) -> np.ndarray:
    """Nearest texels at another height, aspect kept."""
    if image.shape[0] == height:
        return image
    width = max(1, round(image.shape[1] * height / image.shape[0]))
    rows = ((np.arange(height) + 0.5) * image.shape[0] / height).astype(int)
    columns = ((np.arange(width) + 0.5) * image.shape[1] / width).astype(int)
    return image[rows][:, columns]
