"""Scenes of several assets: what is referenced stands on the table, upright, without its own light."""

import numpy as np
import pytest
from usd_example import example_asset

from exmesh_graph.errors import DataError
from exmesh_graph.export.settings import ComposeSettings
from exmesh_graph.export.usd import ExportSettings, validate_usd, write_usd
from exmesh_graph.export.usd.compose import compose_on_table
from exmesh_graph.types import Frame

SKY = np.ones((8, 16, 3), np.float32)
FRAME = Frame(np.array([[30.0, 0, 0, 5], [0, 30.0, 0, -200], [0, 0, 30.0, 7], [0, 0, 0, 1]]), np.eye(4), 0.01)


@pytest.fixture(scope="module")
def pieces(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pieces")
    write_usd(folder / "ours", example_asset(), FRAME)
    flat = example_asset().vertices * np.array([1, 0.5, 1], np.float32)  # its height tells whether it stands upright
    write_usd(folder / "z", example_asset(vertices=flat), settings=ExportSettings(name="toy", up_axis="Z"))
    (folder / "z.usdz").write_bytes((folder / "z" / "toy.usdz").read_bytes())  # a package alone, its light inside
    return {"ours": folder / "ours" / "asset.usdz", "theirs": folder / "z.usdz"}


def test_pieces_stand_side_by_side_under_one_light(pieces, tmp_path):
    from pxr import Usd, UsdGeom, UsdLux

    settings = ComposeSettings(height=0.4, gap=0.2, turn=(0.5, 0.0))
    compose_on_table(tmp_path / "scene", pieces, SKY, settings)
    file = tmp_path / "scene" / "scene.usda"
    assert [p for p in validate_usd(file) if p.level == "error"] == []
    stage = Usd.Stage.Open(str(file))
    cache = UsdGeom.BBoxCache(Usd.TimeCode.Default(), ["default"])
    box = {}
    for name in ("ours", "theirs", "table"):
        found = cache.ComputeWorldBound(stage.GetPrimAtPath(f"/scene/{name}")).ComputeAlignedRange()
        box[name] = np.array([found.GetMin(), found.GetMax()])
    for name in pieces:
        np.testing.assert_allclose(box[name][:, 1], [0, 0.4], atol=1e-5)
        assert (box["table"][0, [0, 2]] < box[name][0, [0, 2]]).all()
        assert (box["table"][1, [0, 2]] > box[name][1, [0, 2]]).all()
    assert np.isclose(box["table"][1, 1], 0, atol=1e-6)
    assert np.isclose(box["theirs"][0, 0] - box["ours"][1, 0], 0.2 * 0.4, atol=0.15)  # boxes of turned boxes are wider
    domes = [prim for prim in stage.Traverse() if prim.HasAPI(UsdLux.LightAPI)]
    assert [str(prim.GetPath()) for prim in domes] == ["/scene/environment"]
    # the package lies there unpacked: Blender mixes up equally named pictures of several packages
    assert (tmp_path / "scene" / "theirs" / "textures" / "base_color.png").is_file()
    width = np.ptp(box["theirs"][:, 0])
    assert np.isclose(width, 0.8, atol=1e-4)  # flat as it is, twice as wide as high: it was turned upright


def test_the_scene_can_be_moved_and_leaves_nothing_when_refused(pieces, tmp_path):
    compose_on_table(tmp_path / "a", pieces, SKY)
    (tmp_path / "a").rename(tmp_path / "b")
    assert [p for p in validate_usd(tmp_path / "b" / "scene.usda") if p.level == "error"] == []
    from pxr import Usd

    stage = Usd.Stage.CreateNew(str(tmp_path / "empty.usdc"))
    stage.SetDefaultPrim(stage.DefinePrim("/nothing", "Xform"))
    stage.GetRootLayer().Save()
    with pytest.raises(DataError, match="shows no surface"):
        compose_on_table(tmp_path / "bad", {"empty": tmp_path / "empty.usdc"}, SKY)
    stage.Export(str(tmp_path / "lone.usda"))
    with pytest.raises(DataError, match=r"cannot be taken along alone[\s\S]*\.usdz package"):
        compose_on_table(tmp_path / "bad", {"lone": tmp_path / "lone.usda"}, SKY)
    assert not (tmp_path / "bad").exists()
