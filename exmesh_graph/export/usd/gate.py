"""Judging a USD file: OpenUSD's own validators, and the rules that they do not know.

OpenUSD's validators pass a file whose base colour is read as raw, whose texture reader names a primvar that is not
there, whose indices run out of range or whose paths are absolute: each of these is a wrong picture, or a crash, in
some DCC tool. The rules here find them (docs/usd.md lists all).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from exmesh_graph.errors import DataError
from exmesh_graph.export.usd.package import package_rules
from exmesh_graph.export.usd.read import open_usd, select_variant
from exmesh_graph.export.usd.rules import Pictures, Problem, dome_rules, material_rules, path_rules, stage_rules
from exmesh_graph.export.usd.rules_mesh import mesh_rules

_RULES = {"Mesh": mesh_rules, "Material": material_rules, "DomeLight": dome_rules}


def validate_usd(path: Path, pictures: Pictures | None = None) -> list[Problem]:
    """All problems of a `.usda`, `.usdc` or `.usdz` file; an empty list means that none was found.

    Every variant is judged, one variant set at a time. `pictures` may be shared by calls on files of one asset.
    """
    from pxr import Usd

    problems = list(package_rules(path))
    try:
        stage = open_usd(path)
    except DataError as error:
        return [*problems, Problem("open", path.name, ": ".join(filter(None, (error.what, error.fix))))]
    pictures = pictures or Pictures()
    problems += [*_openusd_findings(stage), *stage_rules(stage), *path_rules(stage)]
    problems += _prim_rules(stage, pictures, tuple(_RULES))
    for name, choice in _other_variants(stage):
        varied = Usd.Stage.Open(stage.GetRootLayer(), Usd.Stage.LoadAll)
        select_variant(varied, name, choice)
        kinds = ("Mesh", "Material") if name == "lod" else ("Material",)
        for problem in _prim_rules(varied, pictures, kinds):
            if problem not in problems:
                problems.append(replace(problem, where=f"{problem.where} {{{name}={choice}}}"))
    return problems


def _prim_rules(stage: Any, pictures: Pictures, kinds: tuple[str, ...]) -> Iterator[Problem]:
    for prim in stage.Traverse():
        kind = str(prim.GetTypeName()).removesuffix("_1")  # DomeLight_1
        if kind in kinds:
            yield from _RULES[kind](prim, pictures)


def _other_variants(stage: Any) -> list[tuple[str, str]]:
    """(variant set, alternative) of all alternatives that are not selected."""
    others: dict[tuple[str, str], None] = {}
    for prim in stage.Traverse():
        sets = prim.GetVariantSets()
        for name in sets.GetNames():
            variants = sets.GetVariantSet(name)
            others |= {(name, c): None for c in variants.GetVariantNames() if c != variants.GetVariantSelection()}
    return list(others)


def _openusd_findings(stage: Any) -> Iterator[Problem]:
    from pxr import UsdValidation

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    for error in UsdValidation.ValidationContext(validators).Validate(stage):
        if "MissingShaderIdInRegistry" in str(error.GetIdentifier()) and "ND_" in error.GetMessage():
            continue  # the wheel has no UsdMtlx, so it knows no node of MaterialX
        level = "error" if error.GetType() == UsdValidation.ValidationErrorType.Error else "warning"
        sites = [str(site.GetPrim().GetPath()) for site in error.GetSites() if site.IsPrim()]
        yield Problem(str(error.GetIdentifier()), ", ".join(sites) or "stage", error.GetMessage(), level)
