"""Wavefront OBJ with an MTL file and pictures: what every tool opens, without light, units or levels of detail.

MTL has no physically based standard; `map_Pr`, `map_Pm` and `norm` are the extension that Blender, Houdini and others
read; readers that do not know them show the base colour.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from exmesh_graph.export.content import file_content
from exmesh_graph.export.folder import new_folder
from exmesh_graph.export.maps import write_map
from exmesh_graph.export.settings import FileSettings
from exmesh_graph.types import Asset, Frame

_STATEMENTS = {"base_color": "map_Kd", "roughness": "map_Pr", "metallic": "map_Pm", "normal": "norm"}
_SCALES = {"measured": "measured", "unknown": "scale unknown", "normalised": "normalised units"}


def write_textured_obj(
    folder: Path,
    asset: Asset,
    frame: Frame | None = None,
    settings: FileSettings | None = None,
) -> dict[str, Any]:
    """Write `<name>.obj`, `<name>.mtl` and the maps into the new `folder`; return what was measured.

    Points in scene units, Y-up (`recentre` as `export.usd.write_usd`); v of the texture coordinates up. Equal inputs
    give equal bytes. Raises DataError, GeometryError or NumericsError.
    """
    settings = settings or FileSettings()
    name = settings.name
    _, prepared, placement, mesh, report = file_content(asset, frame, settings)
    with new_folder(folder) as partial:
        material = ["newmtl surface", "Kd 1 1 1", "Ks 0.04 0.04 0.04", "Ni 1.5", "illum 2", "Pr 1", "Pm 0"]
        for key, codes in prepared.items():
            write_map(partial / f"{key}.png", codes, srgb=key == "base_color")
            material.append(f"{_STATEMENTS[key]} {key}.png")
        if "metallic" in prepared:
            material[material.index("Pm 0")] = "Pm 1"
        (partial / f"{name}.mtl").write_text("\n".join(material) + "\n", encoding="utf-8")
        corners = np.stack([mesh.faces, mesh.st_faces], axis=-1) + 1
        lines = [f"# Y-up, {placement.metres_per_unit:g} metres per unit ({_SCALES[placement.report['scale']]})"]
        lines += [f"mtllib {name}.mtl", f"o {name}"]
        lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.points.tolist()]
        lines += [f"vt {u:.9g} {v:.9g}" for u, v in mesh.st.tolist()]
        lines += [f"vn {x:.6g} {y:.6g} {z:.6g}" for x, y, z in mesh.normals.tolist()]
        lines += ["usemtl surface", "s 1"]
        lines += ["f " + " ".join(f"{v}/{t}/{v}" for v, t in face) for face in corners.tolist()]
        (partial / f"{name}.obj").write_text("\n".join(lines) + "\n", encoding="ascii")
    return report
