"""Exported assets in a scene of several, and the messages where Blender or a file is missing."""

import numpy as np
import pytest
from exmesh_nodes import dcc, export, gallery

from exmesh_graph.errors import DataError
from exmesh_graph.export.usd import validate_usd
from exmesh_graph.types import EnvMap


def test_a_package_from_disk_and_our_own_asset_on_one_table(scene, context, tmp_path):
    ours = export.usd(context, scene.asset, p=export.ExportSettings(name="ours")).files
    package = tmp_path / "other.usdz"
    package.write_bytes((ours.root / ours.main).read_bytes())
    context.warnings.clear()
    other_context = type(context)(tmp_path / "other")
    other_context.scratch.mkdir()
    other = dcc.usd_file(other_context, p=dcc.UsdFileParams(path=package)).files
    assert other_context.warnings == []
    light = EnvMap(np.ones((4, 8, 3), np.float32))
    table = dcc.compose(context, light, ours, other, p=dcc.ComposeSettings(turn=(0.2, 0.4))).files
    assert [p for p in validate_usd(table.root / table.main) if p.level == "error"] == []
    assert (table.root / "first" / "ours.usda").is_file()  # the component, without its light
    assert (table.root / "second" / "scene.usda").is_file()  # unpacked
    with pytest.raises(DataError, match="cannot be started"):
        gallery.blender(context, table, p=gallery.BlenderParams(python=str(tmp_path / "none")))


def test_only_packages_are_taken_from_disk(tmp_path):
    (tmp_path / "a.usda").write_text("#usda 1.0\n")
    for name in ("a.usda", "none.usdz"):
        with pytest.raises(DataError, match="not a USD package"):
            dcc._package_source(dcc.UsdFileParams(path=tmp_path / name))
