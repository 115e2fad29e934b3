"""Writes docs/equations.md: the paper's equations, and the functions that compute them.

    python -m docs.make_equations

A function says which equations it computes by a line of its docstring: "Equation: 7." or "Equations: 7, 9.".
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "equations.md"
_TAG = re.compile(r"^(Equation: \d+|Equations: \d+(, \d+)+)\.$")

EQUATIONS = {  # number: (formula, what it says)
    1: (
        r"G_v^{(t)} = \beta_g G_v^{(t-1)} + (1 - \beta_g) \lVert \nabla_v L^{(t)} \rVert_2",
        "Running mean of a vertex's gradient length.",
    ),
    2: (
        r"K_f = \frac{1}{\lvert N(f) \rvert} \sum_{f'} \arccos(n_f \cdot n_{f'})",
        "Curvature of a face: mean angle to the faces next to it.",
    ),
    3: (r"S_f = w_g G_f + w_k K_f", "Score by which faces are split."),
    4: (r"D_f = \mathrm{Area}(f) / \ell_{\max}^2(f)", "How degenerate a face is."),
    5: (r"u_s = (1 - \mu) u_a + \mu u_b", "UV of a new vertex on an edge inside a chart."),
    6: (
        r"u_s^{(1)} = (1 - \mu) u_a + \mu u_b, \; u_s^{(2)} = (1 - \mu) u'_a + \mu u'_b",
        "UVs of a new vertex on a seam, one for each side.",
    ),
    7: (
        r"L_I = \lambda_{rgb} L_{rgb} + \lambda_d L_d + \lambda_m L_m + \lambda_s L_s + \lambda_b L_b",
        "Loss of Stage I.",
    ),
    8: (
        r"L_{rgb} = (1 - \lambda_{ssim}) \lVert \hat I - I \rVert_1 + \lambda_{ssim} L_{ssim}(\hat I, I)",
        "Colour loss.",
    ),
    9: (
        r"L_d = 1 - \mathrm{Cov}(\hat D, D_{ref}) / (\sigma_{\hat D} \sigma_{D_{ref}})",
        "Depth loss: correlation with a reference depth.",
    ),
    10: (
        r"a = A(u(x)), \; r = R(u(x)), \; m = M_{met}(u(x)), \; q = N(u(x))",
        "Material of a surface point, read from the maps at its UV.",
    ),
    11: (
        r"\mathcal{A}(x) = \lbrace a(x), r(x), m(x), n_s(x) \rbrace",
        "What shading needs of a point: the material and the shading normal.",
    ),
    12: (
        r"L_{dir}(x, \omega_o) = \int_{\Omega^+} E(\omega_i) V(x, \omega_i) f_r (n_s \cdot \omega_i)^+ d\omega_i",
        "Direct light of the environment.",
    ),
    13: (r"f_r = f_d + f_s", "BRDF: diffuse plus specular."),
    14: (r"f_d = (1 - m) \, a / \pi", "Diffuse part."),
    15: (
        r"f_s = D G F / (4 (n_s \cdot \omega_i)^+ (n_s \cdot \omega_o)^+ + \epsilon)",
        "Specular part (GGX).",
    ),
    16: (r"F_0 = (1 - m) F_{dielectric} + m \, a", "Reflectance at normal incidence."),
    17: (
        r"\hat L_{dir} = \frac{1}{N_d} \sum_k E(\omega_k) V(x, \omega_k) f_r (n_s \cdot \omega_k)^+ / p(\omega_k)",
        "Monte Carlo estimate of direct light.",
    ),
    18: (
        r"L_{sec}(y) = \int_{\Omega^+} E(\omega_i) V(y, \omega_i) f_d(y) (n_s \cdot \omega_i)^+ d\omega_i",
        "Diffuse light that leaves a secondary hit.",
    ),
    19: (
        r"\hat L_{ind} = \frac{1}{N_b} \sum_j 1_{hit} f_d(x) L_{sec}(y_j) (n_s \cdot \omega_j)^+ / p_b(\omega_j)",
        "Monte Carlo estimate of one-bounce light.",
    ),
    20: (r"\hat I = \hat L_{dir} + \lambda_{ind} \hat L_{ind}", "Radiance of a pixel."),
    21: (
        r"L_{img} = \lambda_{log} \lVert \log\frac{1+\hat I}{1+I} \rVert_1"
        r" + \lambda_{ssim} L_{ssim}(\Gamma(\hat I), \Gamma(I))",
        "Image loss of Stage II.",
    ),
    22: (
        r"L_{II} = L_{img} + \lambda_{mat} L_{mat} + \lambda_{env} L_{env} + \lambda_{chroma}(t) L_{chroma}",
        "Loss of Stage II.",
    ),
    23: (
        r"L_{mat} = \sum_P \mathrm{TV}(\hat P), \; L_{env} = \mathrm{TV}(E)",
        "Total variation of the maps on screen, and of the environment.",
    ),
    24: (
        r"L_{chroma} = \lVert \bar E - \mu_E 1 \rVert_2^2, \; \lambda_{chroma}(t) = \lambda_{chroma}^0 (1 - t / T)",
        "The environment's mean colour stays grey, less so towards the end.",
    ),
}


class Tag(NamedTuple):
    """A function that computes an equation: its file below the repository's root, and its name with its class's."""

    number: int
    file: str
    function: str


def tags(folder: Path = ROOT / "exmesh_graph") -> list[Tag]:
    """All tags below `folder`, by number, file and place. Raises ValueError for a tag that cannot be read."""
    every = [tag for file in sorted(folder.rglob("*.py")) for tag in _tags_of(file, folder.parent)]
    return sorted(every, key=lambda tag: tag.number)


def page(tagged: list[Tag]) -> str:
    """The text of docs/equations.md."""
    lines = [
        "# Equations",
        "",
        "The numbered equations of the ExMesh++ paper, and the functions that compute them. An equation with several",
        "functions is computed in parts, or in two forms (a fast one and a reference). The functions' docstrings say",
        "where and why they differ from the paper. $(x)^+$ stands for $\\max(x, 0)$, $V$ for visibility.",
        "",
        "This page is written by `python -m docs.make_equations` from the functions' docstrings.",
        "",
        "| | equation | what it says | computed by |",
        "| --- | --- | --- | --- |",
    ]
    for number, (formula, says) in EQUATIONS.items():
        computed = [f"`{tag.function}` in [{tag.file}](../{tag.file})" for tag in tagged if tag.number == number]
        lines.append(f"| {number} | ${formula}$ | {says} | {'<br>'.join(computed)} |")
    return "\n".join(lines) + "\n"


def _tags_of(file: Path, root: Path) -> Iterator[Tag]:
    def walk(body: list[ast.stmt], prefix: str) -> Iterator[Tag]:
        for item in body:
            if not isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                continue
            for line in (ast.get_docstring(item) or "").splitlines():
                if not line.startswith(("Equation:", "Equations:")):
                    continue
                if not _TAG.match(line):
                    raise ValueError(f"{file}: {line!r} is not of the form 'Equation: 7.' or 'Equations: 7, 9.'")
                for number in re.findall(r"\d+", line):
                    yield Tag(int(number), file.relative_to(root).as_posix(), prefix + item.name)
            yield from walk(item.body, f"{prefix}{item.name}.")

    text = file.read_text(encoding="utf-8")
    if "Equation" in text:
        yield from walk(ast.parse(text).body, "")


if __name__ == "__main__":
    PAGE.write_text(page(tags()), encoding="utf-8")
