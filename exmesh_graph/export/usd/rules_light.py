"""Rules about dome lights: what some reader would turn, ignore or not load."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from exmesh_graph.errors import DataError
from exmesh_graph.export.usd.problem import Pictures, Problem


def dome_rules(prim: Any, stage: Any, pictures: Pictures) -> Iterator[Problem]:
    """All rules on one DomeLight or DomeLight_1 prim."""
    from pxr import Gf, Usd, UsdGeom, UsdLux

    where = str(prim.GetPath())
    if prim.GetTypeName() != "DomeLight":
        yield Problem("error", "domeType", where, "DomeLight_1 is turned wrongly by Blender; use DomeLight")
        return
    dome = UsdLux.DomeLight(prim)
    if dome.GetTextureFormatAttr().Get() != UsdLux.Tokens.latlong:
        yield Problem("error", "domeFormat", where, "texture:format must be latlong")
    if dome.GetExposureAttr().Get():
        yield Problem("error", "domeExposure", where, "Blender ignores exposure; fold it into the pixels")
    turn = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
    up = Gf.Vec3d(0, 0, 1) if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z else Gf.Vec3d(0, 1, 0)
    if turn.TransformDir(Gf.Vec3d(0, 1, 0)).GetNormalized() * up < 0.5:
        what = "the map's pole is more than 60 degrees off the stage's up axis (a Z-up stage needs RotateX 90)"
        yield Problem("error", "domeUpAxis", where, what)
    if turn.GetDeterminant3() <= 0:
        yield Problem("error", "domeMirrored", where, "the light is mirrored: most renderers cannot do that")
    file = dome.GetTextureFileAttr().Get()
    try:
        facts = pictures.facts(file)
    except DataError as error:
        yield Problem("error", "domeImage", where, error.what)
        return
    if facts is None:
        yield Problem("error", "domeImage", where, f"the environment {file} is not found")
    elif facts.width != 2 * facts.height or not facts.finite or facts.lowest < 0:
        yield Problem("error", "domeImage", where, "the environment must be 2:1, finite and not negative")
