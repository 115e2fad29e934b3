"""Settings of the geometry functions: parameters of the nodes that call them, declared once. Imports nothing heavy."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator

from exmesh_graph.params import Params, param


def _enough(voxels: int) -> int:
    if 0 < voxels < 16:
        raise ValueError("should be 0, or greater than or equal to 16")
    return voxels


Voxels = Annotated[int, AfterValidator(_enough)]
"""How fine a grid is; 0: by the photographs."""


class HullSettings(Params):
    """The visual hull of masks (`geometry.hull`)."""

    resolution: Voxels = param(
        128,
        ge=0,
        le=512,
        unit="voxels",
        doc="Voxels along the object's longest side; 0: as fine as pictures show it, 1.25 pixels, 64 to 192 voxels.",
    )
    wrong_masks: int = param(
        0, ge=0, unit="views", was="dissent", doc="Masks that may be wrong at a point; 1 for hand-made masks."
    )
    smooth: int = param(
        10, ge=0, le=200, unit="steps", doc="Taubin smoothing steps (no shrinking) after marching cubes."
    )


class TsdfSettings(Params):
    """Depth maps to a surface: fused (`geometry.tsdf`), or carved out of the visual hull (`geometry.carve`)."""

    resolution: Voxels = param(
        128,
        ge=0,
        le=512,
        unit="voxels",
        doc="Voxels along the unit sphere's diameter; 0: 128, solid: as init.visual_hull.",
    )
    truncation: float = param(4.0, ge=1.5, le=32, unit="voxels", doc="Distance at which the field is cut off.")
    masked: bool = param(True, doc="Ignore depth where alpha < 1/2.")
    min_weight: float = param(1.0, ge=1, unit="views", doc="Views that must have seen a voxel.")
    radius: float = param(0.0, ge=0, doc="Ignore depth of points farther than this from the origin; 0: none.")
    solid: bool = param(
        False,
        doc="Cut what the depth maps look through out of the visual hull, which fills what they do not see: closed "
        "(needs masks; resolution is along the object's longest side).",
    )
    wrong_masks: int = param(0, ge=0, unit="views", was="dissent", doc="Masks that may be wrong at a point (solid).")
    clear: float = param(
        1.0, ge=0, le=8, unit="voxels", doc="How far below the hull depth maps must go to carve; 2 for stereo (solid)."
    )
    blur: float = param(
        0.0, ge=0, le=8, unit="voxels", doc="Smooth the field where depth maps carve; 1 for stereo (solid)."
    )


class CleanSettings(Params):
    """From a triangle soup to a start mesh (`geometry.clean`)."""

    faces: int = param(5000, ge=20, unit="faces", doc="Face budget of the result.")
    tolerance: float = param(
        0.0,
        ge=0,
        le=1,
        doc="The budget doubles until 99 % of the surface is kept to within this share of its radius (half the box's "
        "diagonal), so that thin parts stay; 0: never.",
    )
    max_faces: int = param(12000, ge=20, unit="faces", doc="Where doubling ends (`tolerance`).")
    method: Literal["builtin", "pymeshlab", "open3d"] = param(
        "builtin", doc="builtin, pymeshlab (GPL-3): isotropic remeshing; open3d: quadric decimation."
    )
    components: int = param(1, ge=0, doc="Connected parts to keep, largest area first; 0 = all.")
    min_area: float = param(0.0, ge=0, le=1, doc="Drop parts below this share of the largest part's area.")
    close_holes: int = param(0, ge=0, unit="edges", doc="Fill holes of at most so many edges (not open3d); 0 = none.")


class SplitSettings(Params):
    """How `geometry.split` chooses faces, edges and positions (paper section 4.1, Table 1)."""

    method: Literal["score", "area", "random", "uniform"] = param(
        "score", doc="Which faces split: eq. 3, the largest, at random, or all into four (stops at max_faces)."
    )
    position: Literal["projection", "midpoint", "random"] = param("projection", doc="Where on its edge a vertex goes.")
    edge_degrees: Literal["opposite", "endpoints"] = param(
        "opposite", doc="Whose degrees divide the length in the edge score: those that rise, or the edge's own (paper)."
    )
    score: Literal["ranks", "values"] = param(
        "ranks", doc="G and K enter eq. 3 by rank within the mesh, or as they are (the paper's letter)."
    )
    gradient_weight: float = param(0.6, ge=0.0, doc="w_g of eq. 3.")
    curvature_weight: float = param(0.4, ge=0.0, doc="w_k of eq. 3.")
    area_quantile: float = param(0.5, ge=0.0, lt=1.0, doc="Faces from this quantile of area on may be selected.")
    max_degree: int = param(
        10,
        ge=6,
        doc="An edge is not split when a vertex opposite to it has this degree as a round begins; splits on two sides "
        "of a vertex in one round may pass it by one.",
    )


class MergeSettings(Params):
    """Which faces `geometry.merge` collapses, and how far a collapse may turn its neighbours (paper section 4.2)."""

    degenerate: float = param(
        0.05, ge=0.0, le=1.0, doc="tau_degen of eq. 4: faces below this area / longest edge squared go."
    )
    area_quantile: float = param(0.3, ge=0.0, le=1.0, doc="Only faces up to this quantile of area may go.")
    method: Literal["degenerate", "random"] = param(
        "degenerate", doc="Which faces go: degenerate or never rendered ones, or a share of the small ones at random."
    )
    share: float = param(0.1, ge=0.0, le=1.0, doc="Share of the small faces that `random` takes.")
    tries: int = param(3, ge=1, le=3, unit="edges", doc="Edges of a face tried in turn; the paper stops at the first.")
    checks: Literal["shape", "topology"] = param(
        "shape",
        doc="What a collapse must keep: normals, shapes, outlines and the atlas too, or a manifold alone (the paper).",
    )
    uv: Literal["survivor", "own"] = param(
        "survivor", doc="UV of the corners that a collapse moves: the survivor's in their chart, or their own (paper)."
    )
    min_faces: int = param(100, ge=4, unit="faces", doc="The mesh keeps at least this many.")
    min_cosine: float = param(
        0.5, ge=-1.0, le=1.0, doc="A face that stays keeps its normal within the angle of this cosine."
    )
    outline_cosine: float = param(
        0.7,
        ge=-1.0,
        le=1.0,
        doc="A vertex on a boundary or seam goes only where that line turns by no more than the angle of this cosine.",
    )


class FlipSettings(Params):
    """Which edges `geometry.flip` turns, and how much the surface and its texture may change."""

    method: Literal["delaunay", "valence"] = param(
        "delaunay",
        doc="Which edges turn: those whose two opposite angles sum to more than half a turn, or those between vertices "
        "whose degrees then come nearer to six (four on a boundary).",
    )
    max_bend: float = param(0.5, ge=0.0, le=1.5, unit="radians", doc="Only pairs of faces that are flatter than this.")
    max_shift: float = param(
        0.1, ge=0.0, unit="diagonals", doc="How far the texture may move under the new edge; 0 allows rounding only."
    )
    min_shape: float = param(
        0.1, ge=0.0, le=1.0, doc="A new face is not more degenerate (eq. 4) than this, unless the worse old one was."
    )
    max_rounds: int = param(8, ge=1, le=64, doc="Passes over the mesh; it ends early when no edge is left to flip.")


class UntangleSettings(Params):
    """Smoothing apart of faces that cut one another (`geometry.untangle`)."""

    steps: int = param(12, ge=1, le=200, doc="Steps of smoothing at most; it ends when no face cuts another.")
