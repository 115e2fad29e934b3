"""The paper's tables with the published rows of all peers, and ours beside them.

Figures of the rows are those of ExMesh++'s tables (its own and the ones it took from others), each measured by its
authors on their machines; "-" where the paper has none. Times and sizes there are of an A6000 or unstated. Only ours
were measured here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

SCANS = ("24", "37", "40", "55", "63", "65", "69", "83", "97", "105", "106", "110", "114", "118", "122")
_IMAGES = tuple(f"{part} {figure}" for part in ("NVS", "relight", "albedo") for figure in ("PSNR", "SSIM", "LPIPS"))
_ORB = (
    *(f"{part} {figure}" for part in ("NVS", "relight") for figure in ("PSNR-H", "PSNR-L", "SSIM", "LPIPS")),
    "depth",
    "normal",
    "CD",
)
NOTE = "published, other machine"


@dataclass(frozen=True)
class Table:
    """Columns, and the published rows as text: a name without blanks, then a cell per column."""

    columns: tuple[str, ...]
    text: str

    def rows(self) -> list[tuple[str, ...]]:
        """(method, cells...) of each published row."""
        return [tuple(line.split()) for line in self.text.strip().splitlines()]


TABLES: Mapping[str, Table] = {
    "dtu": Table(
        (*SCANS, "CD", "time", "vertices"),
        """
        VolSDF        1.14  1.26  0.81  0.49  1.25  0.70  0.72  1.29  1.18  0.70  0.66  1.08  0.42  0.61  0.55  0.86  >12h    1M
        NeuS          0.83  0.98  0.56  0.37  1.13  0.59  0.60  1.45  0.95  0.78  0.52  1.43  0.36  0.45  0.45  0.77  >12h  488K
        Neuralangelo  0.45  0.74  0.33  0.34  1.05  0.54  0.53  1.33  1.05  0.72  0.43  0.69  0.34  0.38  0.42  0.62  >12h    1M
        SuGaR         1.47  1.33  1.13  0.61  2.25  1.71  1.15  1.63  1.62  1.07  0.79  2.45  0.98  0.88  0.79  1.33    1h  492K
        2DGS          0.46  0.84  0.31  0.45  0.92  1.01  0.83  1.23  1.30  0.66  0.61  1.07  0.45  0.71  0.54  0.76   11m  134K
        GOF           0.50  0.82  0.37  0.37  1.12  0.74  0.73  1.18  1.29  0.68  0.77  0.90  0.42  0.66  0.49  0.74    1h  532K
        PGSR          0.36  0.57  0.38  0.33  0.78  0.58  0.50  1.08  0.63  0.59  0.46  0.54  0.30  0.38  0.34  0.52   30m  540K
        QGS           0.38  0.62  0.37  0.38  0.75  0.55  0.51  1.12  0.68  0.61  0.46  0.58  0.35  0.41  0.40  0.54   48m  129K
        NVDiffRec     3.04  3.02  2.10  0.78  2.18  1.60  1.46  1.67  2.85  1.26  1.10  3.26  1.13  1.31  1.19  1.86   >1h   69K
        IMLS-Splat    0.32  1.32  0.67  0.62  1.16  0.80  0.78  1.45  1.06  0.89  0.67  0.97  0.63  0.63  0.64  0.84   15m  159K
        GeoSVR        0.32  0.51  0.30  0.33  0.71  0.48  0.42  1.03  0.62  0.56  0.33  0.46  0.30  0.34  0.32  0.47   49m  489K
        ExMesh++      0.44  0.70  0.30  0.34  0.76  0.63  0.52  1.06  1.05  0.58  0.45  0.88  0.32  0.36  0.38  0.58   13m  102K
        """,  # noqa: E501
    ),
    "synthetic4relight": Table(
        (*_IMAGES, "roughness MSE", "time"),
        """
        NeRFactor     22.80  0.916  0.150  21.54  0.875  0.171  19.49  0.864  0.206      -  >48h
        NVDiffRecMC   34.29  0.967  0.068  24.22  0.943  0.078  29.61  0.945  0.075  0.009    2h
        InvRender     30.74  0.953  0.086  28.67  0.950  0.091  28.28  0.935  0.072  0.008  >12h
        TensoIR       35.80  0.978  0.049  29.69  0.951  0.079  30.58  0.946  0.065  0.015   >4h
        GS-IR         35.65  0.971  0.055  27.93  0.953  0.067  20.78  0.907  0.101  0.045   19m
        RelightGS     36.80  0.982  0.028  31.00  0.964  0.050  28.31  0.951  0.058  0.013   41m
        GeoSplatting  35.99  0.978  0.031  34.10  0.971  0.037  29.90  0.949  0.062  0.004   27m
        ExMesh++      35.76  0.971  0.053  34.19  0.962  0.061  30.16  0.953  0.068  0.005   30m
        """,
    ),
    "stanford_orb": Table(
        (*_ORB, "time"),
        """
        Neuralangelo  27.69  35.87  0.981  0.029      -      -      -      -  69.68  1.85  77.85  >12h
        2DGS          29.63  37.30  0.984  0.022      -      -      -      -  28.43  0.11   1.35   11m
        PGSR          30.77  40.52  0.989  0.012      -      -      -      -   0.36  0.05   0.73   30m
        NeRFactor     26.06  33.47  0.973  0.046  23.54  30.38  0.969  0.048      -     -      -  >48h
        InvRender     25.91  34.01  0.977  0.042  23.76  30.83  0.970  0.046      -     -      -  >12h
        GS-IR         26.48  32.66  0.960  0.050  22.88  29.05  0.958  0.053      -     -      -   19m
        RelightGS     28.57  35.20  0.982  0.028  21.37  28.07  0.963  0.044      -     -      -   41m
        NVDiffRecMC   28.03  36.40  0.982  0.028  24.43  31.60  0.972  0.036   0.32  0.04   0.51    2h
        IRGS          28.82  35.66  0.978  0.034  21.94  28.68  0.969  0.039   0.54  0.06   0.49   40m
        RadiosityGS   30.93  39.24  0.989  0.023  24.05  31.29  0.975  0.035   1.87  0.06   0.41    6h
        ExMesh++      31.27  39.52  0.990  0.014  26.60  34.03  0.980  0.022   0.30  0.02   0.30   30m
        """,
    ),
    "nerf_synthetic": Table(
        ("CD, no unit given", "CD visible", "CD full", "PSNR", "vertices"),
        """
        Only_Split        0.74  -  -  28.77  121K
        Only_Merge        1.81  -  -  23.51    6K
        Random_Split      0.77  -  -  28.30   94K
        Random_Merge      1.34  -  -  26.27   98K
        Per-Vertex_Color  0.76  -  -  28.47  184K
        Per-Face_Color    0.78  -  -  28.12  227K
        MLP_Texture       0.64  -  -  28.87  101K
        ExMesh++          0.64  -  -  29.32  100K
        """,
    ),
}


def paper_table(name: str, scored: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """The table as rows of cells, header first: the published rows, then ours, the mean over the scenes scored.

    Several rows of one scene (seeds) count as their mean. A column that a scene lacks is the mean over those that have
    it, and "-" where none has.
    """
    table = TABLES[name]
    scenes = sorted({str(entry["scene"]) for entry in scored}, key=lambda text: (len(text), text))
    ours = []
    for column in table.columns:
        per_scene = [_mean(_values(scored, scene, column)) for scene in scenes]
        if name == "dtu" and column in SCANS:
            per_scene = [_mean(_values(scored, column, "CD"))]
        if column == "time":
            per_scene = [_mean([float(entry["seconds"]) for entry in scored if entry["scene"] == s]) for s in scenes]
        ours.append(_text(column, _mean([value for value in per_scene if value is not None])))
    counted = f"ours, {len(scenes)} scene{'s' * (len(scenes) != 1)}"
    header = ["method", *table.columns, ""]
    published = [[row[0].replace("_", " "), *row[1:], NOTE] for row in table.rows()]
    return [header, *published, [counted, *ours, "measured here: " + ", ".join(s or "unnamed" for s in scenes)]]


def as_text(rows: Sequence[Sequence[str]]) -> str:
    """Aligned for a terminal; ours after a line."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = [
        "  ".join(
            cell.ljust(w) if i in (0, len(row) - 1) else cell.rjust(w)
            for i, (cell, w) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
    return "\n".join([*lines[:-1], "-" * len(lines[0]), lines[-1]])


def as_markdown(rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    head, *rest = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([head, "| --- |" + " ---: |" * (len(rows[0]) - 1), *rest]) + "\n"


def _values(scored: Sequence[Mapping[str, Any]], scene: str, column: str) -> list[float]:
    cells = (entry["row"].get(column) for entry in scored if str(entry["scene"]) == scene)
    return [float(value) for value in cells if value is not None]


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None


def _text(column: str, value: float | None) -> str:
    if value is None:
        return "-"
    if column == "time":
        return f"{value / 60:.0f}m" if value >= 60 else f"{value:.0f}s"
    if column == "vertices":
        return f"{value / 1000:.0f}K" if value >= 10_000 else f"{value:.0f}"
    return f"{value:.3f}" if column.endswith(("SSIM", "LPIPS", "MSE")) else f"{value:.2f}"
