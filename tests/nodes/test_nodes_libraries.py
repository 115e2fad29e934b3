"""Every installed library that a node's code imports, also late, is declared: another version is another result."""

from __future__ import annotations

import ast
import functools
import sys
from importlib import metadata
from pathlib import Path

import pytest

from exmesh_graph.graph.cache.fingerprint import fingerprint
from exmesh_graph.graph.declare.packs import load_packs

BUILTIN = {name: d for name, d in load_packs().types.items() if d.function.__module__.startswith("exmesh_nodes.")}
ROOT = Path(__file__).parent.parent.parent
# numpy: under every node, its results are pinned by IEEE arithmetic but for sums; safetensors: bytes are hashed anyway
# bpy: of the child process that Blender's own Python runs; psutil: reads the memory of processes, for limits and logs;
# threadpoolctl: says how many threads take part
LEFT_OUT = {"numpy", "safetensors", "pydantic", "pydantic_core", "bpy", "psutil", "threadpoolctl"}
LATE = {
    "import_open3d": "open3d",
    "import_pymeshlab": "pymeshlab",
    "import_depth_anything": "depth-anything-3",
    "import_pycolmap": "pycolmap",
}  # by a computed name, in exmesh_graph.native
UNUSED = {  # imported by a module of the node's code, but by no function that the node calls
    "benchmark.dtu": {"OpenImageIO", "torch"},
    "benchmark.nerf_synthetic": {"OpenImageIO", "open3d", "pymeshlab", "scikit-image"},
    "benchmark.stanford_orb": {"scikit-image"},
    "data.environment": {"scipy"},
    "data.usd": {"scipy"},
    "usd.compose": {"scipy"},
    "gallery.blender": {"embreex", "scipy", "torch", "warp-lang"},
    "evaluate.round": {"pymeshlab", "open3d", "scikit-image", "embreex"},
    "evaluate.capture": {"pymeshlab", "open3d"},
    "evaluate.mesh": {"pymeshlab", "open3d"},
    "evaluate.stage1": {"pymeshlab"},
    "evaluate.asset": {"pymeshlab"},
    "evaluate.region": {"pymeshlab"},
    "init.sphere": {"scipy"},
    "init.auto": {"OpenImageIO", "depth-anything-3"},
    "init.mesh_file": {"torch", "warp-lang"},
    "init.object": {"OpenImageIO", "depth-anything-3", "pymeshlab"},
    "mask.auto": {"OpenImageIO", "depth-anything-3", "pymeshlab"},
    "mask.files": {"pillow", "scipy"},
    "mask.from_surface": {"OpenImageIO"},
    "prior.depth_files": {"torch", "warp-lang"},
    "init.tsdf": {"pymeshlab"},
    "init.visual_hull": {"open3d", "pymeshlab"},
    "stage2.init": {"scipy", "warp-lang"},
    "stage3.refine": {"OpenImageIO"},
    "prior.depth_anything": {"warp-lang"},
    "regulariser.bilaplacian": {"scipy"},
    "regulariser.laplacian": {"scipy"},
    "uv.regenerate": {"xatlas"},
    "uv.unwrap": {"xatlas"},
    "transport.bounce": {"embreex", "warp-lang"},
    "appearance.uv_texture": {"scipy"},
    "material.alike": {"embreex", "warp-lang"},
}


OWN = metadata.packages_distributions() | {"xatlas": ["xatlas"]}  # its wheel does not list its module


def libraries_of(node_type: str) -> set[str]:
    """Distributions that the modules of the node's fingerprint import."""
    found: set[str] = set()
    for module in fingerprint(BUILTIN[node_type]).modules:
        top, _, rest = module.partition(".")
        base = ROOT / ("nodes" if top == "exmesh_nodes" else top)
        path = base.joinpath(*rest.split(".")) if rest else base
        path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
        if top == "exmesh_nodes" or module == "exmesh_graph.native":
            continue
        for name in imports_of(path):
            if name in LATE.values():
                found.add(name)
            elif name not in sys.stdlib_module_names and name not in ("exmesh_graph", "exmesh_nodes"):
                found.add(OWN.get(name, [name])[0])
    return found - LEFT_OUT


@functools.cache
def imports_of(path: Path) -> set[str]:
    """Names of the packages that a file imports."""
    found: set[str] = set()
    for item in ast.walk(ast.parse(path.read_text())):
        if isinstance(item, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in item.names}
        elif isinstance(item, ast.ImportFrom) and not item.level:
            found.add((item.module or "").partition(".")[0])
            found |= {LATE[alias.name] for alias in item.names if alias.name in LATE}
    return found


@pytest.mark.thorough
@pytest.mark.parametrize("node_type", BUILTIN)
def test_the_key_holds_the_versions_of_all_libraries(node_type: str) -> None:
    declared, imported = set(BUILTIN[node_type].libraries), libraries_of(node_type)
    assert imported - UNUSED.get(node_type, set()) == declared


def test_the_kernels_of_the_rasteriser_and_the_rays_are_part_of_the_code_of_nodes_that_use_them():
    """Imported by a computed name, an edited kernel would give a stale hit."""
    inside = {name: set(fingerprint(BUILTIN[name]).modules) for name in ("stage1.refine", "stage2.fit", "init.pgsr")}
    raster = {f"exmesh_graph.raster.{name}" for name in ("kernels", "kernels_texture", "kernels_silhouette")}
    assert raster <= inside["stage1.refine"]
    assert {"exmesh_graph.raster.kernels", "exmesh_graph.rays.warp_kernels"} <= inside["stage2.fit"]
    splat = {Path(file).name for file in BUILTIN["init.pgsr"].code}
    files = {file.name for file in (ROOT / "exmesh_graph" / "splat").glob("kernels_*.py")}
    assert files
    assert files <= splat | {f"{m.rpartition('.')[2]}.py" for m in inside["init.pgsr"]}
