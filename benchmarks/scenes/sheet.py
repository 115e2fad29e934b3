"""A contact sheet: a row a scene, three photographs, the four relit views, base colour and normals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
from PIL import Image, ImageDraw, ImageFont

from benchmarks.scenes.catalogue import RECIPES

SIDE, LABEL = 150, 92
COLUMNS = ("photograph", "photograph", "photograph", "sun", "overcast", "lamps", "coloured", "base colour", "normal")


def sheet(out: Path, names: list[str], picture: Path) -> None:
    """Write the JPEG `picture` of the scenes below `out`; those without pictures are left out."""
    names = names or [name for name in RECIPES if (out / name / "transforms_train.json").is_file()]
    font = ImageFont.load_default(14)
    whole = Image.new("RGB", (LABEL + SIDE * len(COLUMNS), 22 + SIDE * len(names)), (246, 246, 244))
    pen = ImageDraw.Draw(whole)
    for column, head in enumerate(COLUMNS):
        pen.text((LABEL + SIDE * column + 6, 3), head, (40, 40, 40), font)
    for row, name in enumerate(names):
        pen.text((6, 22 + SIDE * row + SIDE // 2 - 8), name, (40, 40, 40), font)
        for column, file in enumerate(_files(out / name)):
            if file is not None and file.is_file():
                whole.paste(_small(file), (LABEL + SIDE * column, 22 + SIDE * row))
    picture.parent.mkdir(parents=True, exist_ok=True)
    whole.save(picture, quality=82, optimize=True)


def _files(folder: Path) -> list[Path | None]:
    photographs = sorted(f for f in (folder / "train").glob("*.png") if "mask" not in f.name)
    shown = [photographs[len(photographs) * k // 6] if photographs else None for k in (0, 2, 4)]
    tests = sorted((folder / "test").glob("*_albedo.png"))
    view = tests[len(tests) // 3].name[:3] if tests else "002"
    relit = [folder / f"test_rli/{light}_{view}.png" for light in COLUMNS[3:7]]
    return [*shown, *relit, folder / f"test/{view}_albedo.png", folder / f"test/{view}_normal.exr"]


def _small(file: Path) -> Image.Image:
    if file.suffix == ".exr":
        source = oiio.ImageInput.open(str(file))
        size = source.spec()
        normal = np.asarray(source.read_image(0, 0, 0, 3, oiio.FLOAT)).reshape(size.height, size.width, 3)
        source.close()
        there = np.linalg.norm(normal, axis=-1, keepdims=True) > 0
        coloured = np.concatenate([127.5 * normal + 127.5, 255.0 * there], axis=-1)
        one = Image.fromarray(coloured.astype(np.uint8), "RGBA")
    else:
        one = Image.open(file).convert("RGBA")
    one = one.resize((SIDE, SIDE), Image.Resampling.BOX if one.width >= 2 * SIDE else Image.Resampling.BILINEAR)
    ground = Image.new("RGBA", one.size, (232, 232, 228, 255))
    return Image.alpha_composite(ground, one).convert("RGB")
