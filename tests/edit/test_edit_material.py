"""Local edits: the right texels change, and no others."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exmesh_graph.edit.apply import apply_edit
from exmesh_graph.edit.cameras import orbit
from exmesh_graph.edit.settings import EditParams
from exmesh_graph.edit.texels import decal
from exmesh_graph.errors import DataError
from exmesh_graph.io.images import write_image
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import Frame, Views
from exmesh_graph.uv.surface import texel_surface
from tests.edit.edit_scenes import ball

ROOT = Path(__file__).parent.parent.parent


def camera_views(count=3, size=64):
    intrinsics, pose = orbit(count, size, size)
    return Views(
        names=tuple(f"{k:03d}" for k in range(count)),
        images=np.zeros((count, size, size, 3), np.float32),
        alpha=np.ones((count, size, size), np.float32),
        intrinsics=intrinsics,
        camera_to_world=pose,
        split="test",
    )


@settings(max_examples=20, deadline=None)
@given(
    st.lists(st.floats(-1, 1), min_size=3, max_size=3),
    st.floats(0.05, 1.5),
    st.sampled_from(["base_color", "roughness", "metallic"]),
    st.sampled_from(["set", "scale"]),
)
def test_texels_inside_the_ball_change_and_all_others_keep_their_bytes(center, radius, channel, operation):
    asset = ball(size=32, level=1)
    edit = EditParams(channel=channel, operation=operation, value=(0.25,), center=tuple(center), radius=radius)
    new, weight = apply_edit(asset, edit)
    old = getattr(asset, channel) if channel != "metallic" else np.zeros_like(asset.roughness)
    got = getattr(new, channel)
    inside = np.linalg.norm(
        texel_surface(asset, len(asset.base_color)).position - np.float32(center), axis=-1
    ) <= np.float32(radius)
    assert np.array_equal(weight > 0, inside)
    assert got[~inside].tobytes() == old[~inside].tobytes()
    wanted = 0.25 if operation == "set" else 0.25 * old[inside]
    np.testing.assert_allclose(got[inside], wanted, rtol=1e-5, atol=1e-7)
    for other in {"base_color", "roughness", "environment", "seen"} - {channel}:
        assert getattr(new, other) is getattr(asset, other)


def test_a_surface_seen_at_an_edited_pixel_is_edited_wholly():
    """Every texel that a bilinear lookup inside the ball reads has the new value: no rim of the old colour."""
    import torch

    from exmesh_graph.shading.gather import gather_rows
    from exmesh_graph.stage2.surface import texel_footprint

    asset = ball(size=128)
    new, _ = apply_edit(asset, EditParams(channel="roughness", value=(0.9,), center=(0, 0, 1), radius=2.5))
    bary = np.random.default_rng(0).dirichlet([1, 1, 1], size=(len(asset.faces), 8)).astype(np.float32)
    uv = np.einsum("fkc,fcx->fkx", bary, asset.uvs[asset.uv_faces]).reshape(-1, 2)
    read = gather_rows(torch.from_numpy(new.roughness.reshape(-1, 1)), *texel_footprint(torch.from_numpy(uv), 128))
    np.testing.assert_allclose(read.numpy(), 0.9, rtol=1e-6)


def test_a_picked_pixel_is_where_the_view_sees_it():
    asset, views = ball(size=128, level=3), camera_views()
    edit = EditParams(value=(0.0, 0.0, 0.0), view="001", pixel=(32.0, 32.0), radius=0.2)
    _, weight = apply_edit(asset, edit, views)
    middle = texel_surface(asset, len(asset.base_color)).position[weight > 0].mean(axis=0)
    towards = views.camera_to_world[1, :3, 3] / np.linalg.norm(views.camera_to_world[1, :3, 3])
    assert middle @ towards == pytest.approx(1.0, abs=0.03)


def test_center_and_radius_are_scene_units_where_a_frame_is_wired():
    asset = ball()
    matrix = np.diag([5.0, 5.0, 5.0, 1.0])
    matrix[:3, 3] = [10, 0, 0]
    frame = Frame(matrix, np.eye(4))
    here = apply_edit(asset, EditParams(value=(1.0,), center=(0, 0, 1), radius=0.5))[1]
    there = apply_edit(asset, EditParams(value=(1.0,), center=(10, 0, 5), radius=2.5), frame=frame)[1]
    assert np.array_equal(here, there)
    assert 0 < here.mean() < 0.5


def test_a_mask_and_a_feathered_ball_multiply(tmp_path):
    asset = ball()
    mask = np.zeros((64, 64, 3), np.float32)
    mask[:, :32] = 1
    write_image(tmp_path / "mask.png", mask)
    edit = EditParams(
        channel="roughness", value=(1.0,), mask=tmp_path / "mask.png", center=(0, 0, 1), radius=1, feather=0.5
    )
    new, weight = apply_edit(asset, edit)
    assert weight[:, 32:].max() == 0
    assert weight[:, :32].max() > 0.9
    assert ((weight > 0.1) & (weight < 0.9)).any()
    np.testing.assert_allclose(new.roughness, asset.roughness + weight * (1 - asset.roughness), atol=1e-6)


def test_a_decal_stands_upright_and_reads_from_outside():
    """Left half red, upper half green, seen from outside with +Y up: no mirror image, nothing on the far side."""
    asset = ball(size=256, level=3)
    surface = texel_surface(asset, len(asset.base_color))
    picture = np.zeros((8, 8, 4), np.float32)
    picture[:, :4, 0] = 1
    picture[:4, :, 1] = 1
    picture[..., 3] = 1
    laid = decal(surface, picture, (0, 0, 1), 0.6)
    reached = laid[..., 3] > 0
    x, y, z = surface.position[reached].T
    assert (z > 0).all()
    clear = (np.abs(x) > 0.15) & (np.abs(y) > 0.15)  # away from the bilinear borders between quarters
    assert np.array_equal(laid[reached][clear][:, 0] > 0.5, x[clear] < 0)  # seen from +Z, -x is left
    assert np.array_equal(laid[reached][clear][:, 1] > 0.5, y[clear] > 0)
    top = decal(surface, picture, (0, 1, 0), 0.3)
    assert (top[..., 3] > 0).any()
    assert np.isfinite(top).all()
    assert not decal(surface, picture, (5, 5, 5), 0.1).any()


def test_paint_is_linear_and_follows_alpha(tmp_path):
    asset = ball()
    picture = np.zeros((64, 64, 4), np.float32)
    picture[..., 0] = 0.5
    picture[:32, :, 3] = 1
    write_image(tmp_path / "paint.png", picture)
    new, weight = apply_edit(asset, EditParams(operation="paint", picture=tmp_path / "paint.png"))
    assert new.base_color[32:].tobytes() == asset.base_color[32:].tobytes()
    np.testing.assert_allclose(new.base_color[:32], [[[0.216, 0, 0]]] * np.ones((32, 64, 1)), atol=2e-3)
    assert set(np.unique(weight)) == {0, 1}


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (EditParams(operation="paint"), "nothing to paint with"),
        (EditParams(), "no `value`"),
        (EditParams(operation="paint", picture=Path("decal.png"), value=(1.0,)), "`value` does nothing"),
        (EditParams(value=(200.0, 10.0, 10.0)), "out of range"),
        (EditParams(operation="scale", value=(-1.0,)), "out of range"),
        (EditParams(value=(1.0, 0.0)), "2 values for base_color"),
        (EditParams(channel="roughness", value=(1.0, 0.0, 0.0)), "3 values for roughness"),
        (EditParams(value=(1.0,), center=(0, 0, 0)), "a middle and a radius"),
        (EditParams(value=(1.0,), radius=1.0), "a middle and a radius"),
        (EditParams(value=(1.0,), view="000", radius=1.0), "belong together"),
        (EditParams(value=(1.0,), view="000", pixel=(1, 1), center=(0, 0, 0), radius=1.0), "both say"),
        (EditParams(value=(1.0,), view="zebra", pixel=(1, 1), radius=1.0), "no view 'zebra'"),
        (EditParams(value=(1.0,), view="000", pixel=(1, 1), radius=1.0), "does not show the mesh"),
        (EditParams(value=(1.0,), view="000", pixel=(65, 1), radius=1.0), "outside view 000"),
        (EditParams(value=(1.0,), feather=0.5), "`feather` belongs to a ball"),
    ],
)
def test_contradictions_are_named(edit, message):
    with pytest.raises(DataError, match=message):
        apply_edit(ball(size=16, level=0), edit, camera_views())


def test_pixel_without_views_and_a_region_without_texels(tmp_path):
    from exmesh_nodes.edit import EditParams, material

    with pytest.raises(DataError, match="needs the cameras"):
        apply_edit(ball(size=16, level=0), EditParams(value=(1.0,), view="0", pixel=(1, 1), radius=1.0))
    context = FakeContext(scratch=tmp_path)
    out = material(context, ball(), p=EditParams(value=[1.0], center=[9, 9, 9], radius=0.1))
    assert any("holds no texel" in line for line in context.warnings)
    assert out.asset.base_color.tobytes() == ball().base_color.tobytes()


def test_graphs_in_the_old_names_of_these_nodes_are_the_same_graphs(tmp_path):
    from exmesh_graph.graph.declare.packs import load_packs
    from exmesh_graph.graph.language.check import check_file

    shipped = (ROOT / "graphs" / "use.yaml").read_text()
    old = shipped.replace("extends: ", f"extends: {ROOT}/graphs/").replace("samples/", f"{ROOT}/graphs/samples/")
    for now, before in (("relight", "relight"), ("material", "edit_material"), ("turntable", "turntable")):
        assert f"edit.{now}," in old
        old = old.replace(f"edit.{now},", f"use.{before},")
    (tmp_path / "old.yaml").write_text(old)
    new, same = (check_file(file, [], load_packs()) for file in (ROOT / "graphs" / "use.yaml", tmp_path / "old.yaml"))
    assert {name: bound.definition.type for name, bound in same.nodes.items()} == {
        name: bound.definition.type for name, bound in new.nodes.items()
    }
    assert sum("is now called 'edit." in note for note in same.notes) == 4
