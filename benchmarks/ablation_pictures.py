"""One strip of a sweep's variants, good and bad: the same part of the same pictures of each, named.

    python -m benchmarks.ablation_pictures runs/SWEEP OUT.jpg --variants base mlp per_vertex \\
        --take pictures:0:1/6 --take look_pictures:0:0/3

--take NODE:PICTURE:PANEL/PANELS takes picture number PICTURE of the gallery of the node (its own name, or its end;
the last of several), and panel PANEL of PANELS in a row from it. Rows of the result are takes, columns variants; the
name `truth` takes the panel after PANEL.
"""

from __future__ import annotations

import argparse
import io
import json
from pathlib import Path
from typing import Any

from PIL import Image, ImageDraw

from exmesh_graph.graph.cache.store import Store
from exmesh_graph.report.collect import gallery_of
from exmesh_graph.types import Gallery

GAP, LINE = 6, 18


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="folder of the sweep's run")
    parser.add_argument("picture", type=Path)
    parser.add_argument("--variants", nargs="+", required=True)
    parser.add_argument("--take", action="append", required=True, metavar="NODE:PICTURE:PANEL/PANELS")
    parser.add_argument("--side", type=int, default=200, help="width of a column in pixels")
    parser.add_argument("--store", type=Path, default=Path(".exmesh"))
    options = parser.parse_args()
    table = json.loads((options.run / "sweep.json").read_text())
    outputs = {
        node["name"]: node.get("outputs") or {} for node in json.loads((options.run / "run.json").read_text())["nodes"]
    }
    members: dict[str, dict[str, str]] = {}
    for member in table["members"]:
        members.setdefault(member["variant"], member["nodes"])
    store = Store(options.store)
    columns = []
    for variant in options.variants:
        if variant == "truth":  # beside ours in a comparison
            first = next(name for name in options.variants if name in members)
            columns.append(
                (variant, [_panel(store, outputs, members[first], _next(t), options.side) for t in options.take])
            )
            continue
        if variant not in members:
            raise SystemExit(f"{options.run} has no variant {variant!r}; it has {', '.join(members)}")
        panels = [_panel(store, outputs, members[variant], take, options.side) for take in options.take]
        columns.append((variant, panels))
    _strip(columns, options.side).save(options.picture, quality=88)


def _next(take: str) -> str:
    node, number, part = take.split(":")
    index, count = part.split("/")
    return f"{node}:{number}:{int(index) + 1}/{count}"


def _panel(store: Store, outputs: dict[str, Any], nodes: dict[str, str], take: str, side: int) -> Image.Image:
    name, number, part = take.split(":")
    index, count = (int(n) for n in part.split("/"))
    own = [key for key in nodes if key == name or key.endswith("." + name)]
    if not own:
        raise SystemExit(f"no node {name!r}; there are {', '.join(nodes)}")
    for port in outputs[nodes[own[-1]]].values():
        if port["type"] == "Gallery":
            gallery = store.load(Gallery, port["digest"])
            if gallery is None:
                raise SystemExit("the store no longer holds the pictures: run the sweep again")
            pictures = [one for one in gallery_of(Path(gallery.root), name) if not one.is_model]
            if int(number) >= len(pictures):
                raise SystemExit(f"{own[-1]} has {len(pictures)} pictures: {', '.join(one.title for one in pictures)}")
            image = Image.open(io.BytesIO(pictures[int(number)].data)).convert("RGB")
            width = (image.width + GAP) / count
            cut = image.crop((round(index * width), 0, round((index + 1) * width) - GAP, image.height))
            return cut.resize((side, round(side * cut.height / cut.width)), Image.Resampling.LANCZOS)
    raise SystemExit(f"{own[-1]} has no gallery")


def _strip(columns: list[tuple[str, list[Image.Image]]], side: int) -> Image.Image:
    heights = [max(panels[row].height for _, panels in columns) for row in range(len(columns[0][1]))]
    size = len(columns) * (side + GAP) - GAP, LINE + sum(heights) + GAP * (len(heights) - 1)
    sheet = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(sheet)
    for column, (name, panels) in enumerate(columns):
        left, top = column * (side + GAP), LINE
        draw.text((left + 2, 3), name, fill="black")
        for panel, height in zip(panels, heights, strict=True):
            sheet.paste(panel, (left, top))
            top += height + GAP
    return sheet


if __name__ == "__main__":
    main()
