"""A bench of the wood that its table is of: what the table's picture tells of the outline, and of the gap below it."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from mask_scenes import GROUND, disc, overlap_of
from scipy.ndimage import binary_dilation, binary_erosion

from exmesh_graph.masks.cut import together
from exmesh_graph.masks.explained import explained
from exmesh_graph.masks.ground import Kind, ground_of
from exmesh_graph.masks.outlines import masks_of_surface
from exmesh_graph.masks.pinhole import pixels_of, rays_of, thinned
from exmesh_graph.masks.plane import Plane
from exmesh_graph.masks.settings import CutSettings
from exmesh_graph.masks.table import Table, chances, table_shown
from exmesh_graph.raster import rasterize
from exmesh_graph.testing import look_at
from exmesh_graph.types import DepthMaps, Views

SIZE = 112
PLANE = Plane(np.array([0.0, 1.0, 0.0]), GROUND, 0.5)
BENCH = (((0.5, 0.1, 0.25), (0, 0.1, 0)), ((0.12, 0.2, 0.25), (-0.38, -0.15, 0)), ((0.12, 0.2, 0.25), (0.38, -0.15, 0)))


class Scene(NamedTuple):
    views: Views
    masks: np.ndarray
    gaps: np.ndarray  # what is seen through between the legs
    block: tuple[np.ndarray, np.ndarray]  # the bench without its gap
    depths: DepthMaps  # of the block, as stereo carries it across the gap


@pytest.fixture(scope="module")
def bench():
    turns = 2 * np.pi * np.arange(14) / 14
    heights = np.radians(np.where(np.arange(14) % 2, 16, 38))
    eyes = 2.6 * np.stack([np.cos(heights) * np.sin(turns), np.sin(heights), np.cos(heights) * np.cos(turns)], axis=1)
    poses = np.stack([look_at(eye) for eye in eyes])
    k = np.repeat(np.array([[[1.7 * SIZE, 0, SIZE / 2], [0, 1.7 * SIZE, SIZE / 2], [0, 0, 1]]]), 14, axis=0)
    parts, block = [cuboid(*part) for part in BENCH], cuboid((0.5, 0.275, 0.25), (0, -0.075, 0))
    object_, _ = drawn(joined(*parts), k, poses)
    filled, depth = drawn(block, k, poses)
    whole, far = drawn(joined(*parts, disc(1.3)), k, poses)
    points = np.stack([
        pose[:3, 3] + z[..., None] * rays_of((SIZE, SIZE), one, np.linalg.inv(pose))
        for pose, z, one in zip(poses, far, k, strict=True)
    ])  # fmt: skip
    images = np.where(whole[..., None], wood(points), 0.02).astype(np.float32)
    names = tuple(f"v{i}" for i in range(14))
    views = Views(names, images, np.ones((14, SIZE, SIZE), np.float32), k, poses, "train", has_masks=False)
    return Scene(views, object_, filled & ~object_, block, DepthMaps(names, depth))


def cuboid(half, at):
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [half_ for a, b, c, d in sides for half_ in ((a, b, c), (a, c, d))]
    return (corners * half + at).astype(np.float32), np.array(faces, np.int32)


def joined(*meshes):
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [one + start for (_, one), start in zip(meshes, starts, strict=False)]
    return np.concatenate([vertices for vertices, _ in meshes]).astype(np.float32), np.concatenate(faces)


def drawn(mesh, k, poses):
    seen = rasterize(*(torch.from_numpy(part) for part in (*mesh, k, np.linalg.inv(poses))), SIZE, SIZE)
    return seen.face_id.numpy() >= 0, seen.depth.numpy()


def wood(points):
    """Brown with a grain of its own at each place: table and bench alike."""
    x, y, z = np.moveaxis(points, -1, 0)
    grain = np.sin(31 * x + 3 * np.sin(9 * z)) + np.sin(23 * z + 17 * y + 2 * np.sin(11 * x)) + np.sin(29 * y - 19 * x)
    return (0.25 + 0.06 * grain)[..., None] * [1.0, 0.7, 0.5]


def masks_of(scene, table):
    return masks_of_surface(scene.views, *scene.block, CutSettings(band=6), table=table)


@pytest.mark.thorough
def test_wood_on_wood_is_told_apart_and_the_gap_is_found(bench):
    table = Table(PLANE, bench.depths)
    without, found = masks_of(bench, None), masks_of(bench, table)
    # the table below the bench is seen from low down only: that is where its picture is known
    low = np.arange(len(bench.views)) % 2 == 1
    assert without[low][bench.gaps[low]].mean() > 0.9
    assert found[low][bench.gaps[low]].mean() < 0.55
    assert overlap_of(found, bench.masks) > overlap_of(without, bench.masks) + 0.03
    assert (bench.masks & ~found).sum() < 0.02 * bench.masks.sum()


def test_an_outline_that_is_off_comes_back(bench):
    """Moved outlines, in pictures where colours alone cannot say where the table begins."""
    pictures = np.clip(np.asarray(bench.views.images), 0, 1) ** (1 / 2.2)
    for moved in (binary_dilation, binary_erosion):
        outlines = np.stack([moved(one, iterations=3) for one in bench.masks])
        likely = table_shown(
            PLANE, bench.views, pictures.astype(np.float32), depth_of_all(bench), outlines, bench.block[0]
        )
        off = outlines != bench.masks
        told = np.where(bench.masks, likely < 0.4, likely > 0.6)[off]
        wrong = np.where(bench.masks, likely > 0.6, likely < 0.4)[off]
        assert told.mean() > 0.25, moved
        assert told.sum() > 3 * wrong.sum(), moved


def test_what_an_outline_lacks_of_a_plain_object_is_no_table(bench):
    """A plain block, of which stereo knows the upper half, before a table that it knows."""
    views, plain = bench.views, np.array([0.5, 0.25, 0.15], np.float32)
    filled = bench.masks | bench.gaps
    pictures = np.where(filled[..., None], plain, np.clip(np.asarray(views.images), 0, 1) ** (1 / 2.2))
    whole = depth_of_all(bench)
    cameras = zip(views.intrinsics, views.world_to_camera, strict=True)
    rays = np.stack([rays_of((SIZE, SIZE), *camera) for camera in cameras])
    points = views.camera_to_world[:, None, None, :3, 3] + whole[..., None] * rays
    lower = filled & (points[..., 1] < -0.05)
    depth = np.where(lower, 0, whole)
    top = bench.block[0] * [1, 0.5, 1] + [0, 0.0625, 0]  # what stands where stereo knows it
    likely = table_shown(PLANE, views, pictures.astype(np.float32), depth, filled & ~lower, top)
    missing = lower & ~binary_dilation(filled & ~lower, iterations=2)
    assert missing.sum() > 1000
    assert (likely[missing] > 0.6).mean() < 0.1
    around = (whole > 0) & ~binary_dilation(filled, np.ones((1, 5, 5)))
    assert (likely[around] > 0.6).mean() > 0.7


def depth_of_all(bench):
    """[N, H, W]: of the block, and of the table around it."""
    cameras = zip(bench.views.intrinsics, bench.views.camera_to_world, strict=True)
    table = np.concatenate([drawn(disc(1.3), k[None], pose[None])[1] for k, pose in cameras])
    return np.where(bench.masks | bench.gaps, bench.depths.depth, table)


def test_a_views_own_light_does_not_count(bench):
    """One picture is brighter by 0.1, as gloss or exposure makes it: its table is the same."""
    pictures = (np.clip(np.asarray(bench.views.images), 0, 1) ** (1 / 2.2)).astype(np.float32)
    usable = np.stack([~binary_dilation(one, iterations=2) for one in bench.masks])
    ground = ground_of(PLANE, bench.views, pictures, np.where(usable, Kind.BESIDE, Kind.NOT), bench.block[0])
    k, to_camera = bench.views.intrinsics[0], bench.views.world_to_camera[0]
    plain, brighter = (ground.alike(one, bench.masks[0], k, to_camera) for one in (pictures[0], pictures[0] + 0.1))
    on = usable[0] & np.isfinite(plain)
    assert on.sum() > 1000
    assert (plain[on] > 0.2).mean() > 0.9
    assert (brighter[on] > 0.2).mean() > 0.85


def test_nothing_is_said_where_the_table_is_never_seen(bench):
    hidden, shown = (np.full(bench.masks.shape, kind) for kind in (Kind.NOT, Kind.BESIDE))
    assert ground_of(PLANE, bench.views, np.asarray(bench.views.images), hidden, bench.block[0]) is None
    seen = ground_of(PLANE, bench.views, np.asarray(bench.views.images), shown, bench.block[0])
    above = replace(seen, plane=replace(PLANE, offset=9.0))  # above all cameras: no pixel looks down on it
    camera = bench.views.intrinsics[0], bench.views.world_to_camera[0]
    assert np.isnan(above.alike(np.asarray(bench.views.images[0]), bench.masks[0], *camera)).all()


GRAY, DARK, CLAY = (0.6, 0.55, 0.5), (0.3, 0.28, 0.25), (0.6, 0.4, 0.3)


@pytest.mark.parametrize(
    ("below", "kind", "told"),
    [
        (DARK, Kind.RIM, True),  # the table in its shade
        (DARK, Kind.DEEP, False),  # or a dark object, deep inside its outline
        (CLAY, Kind.RIM, False),  # a pot's wall
        (GRAY, Kind.RIM, False),  # even a pot of the table's colour
        ("grain", Kind.RIM, True),
        ("grain", Kind.DEEP, True),
        ("grain of each view", Kind.DEEP, False),  # a pattern that lies elsewhere than on the table
    ],
)
def test_what_is_below_an_object_is_told_by_shade_and_pattern(bench, below, kind, told):
    places = on_table(bench.views)
    hidden = np.hypot(places[..., 0], places[..., 2]) < 0.3
    if isinstance(below, str):
        steps = 0.7 * np.arange(len(places)) if below == "grain of each view" else np.zeros(len(places))
        wave = np.sin(60 * places[..., 0] + steps[:, None, None]) * np.sin(60 * places[..., 2])
        below = np.asarray(CLAY) * (1 + 0.3 * wave[..., None])
    pictures = np.where(hidden[..., None], below, GRAY).astype(np.float32)
    ground = ground_of(PLANE, bench.views, pictures, np.where(hidden, kind, Kind.BESIDE), bench.block[0])
    texels = np.moveaxis(np.indices(ground.spread.shape), 0, -1) + 0.5
    away = np.linalg.norm((ground.origin + texels @ ground.across)[..., [0, 2]], axis=-1)
    known = np.isfinite(ground.spread)
    assert known[(away > 0.4) & (away < 0.6)].all()
    assert known[away < 0.25].mean() > 0.8 if told else known[away < 0.22].mean() < 0.05
    if told and kind == Kind.RIM and isinstance(below, tuple):
        np.testing.assert_allclose(
            ground.colour[(away < 0.25) & known],
            np.broadcast_to(below, (int(((away < 0.25) & known).sum()), 3)),
            atol=1e-3,
        )


def on_table(views):
    """[N, H, W, 3]: where each pixel's ray meets the plane."""
    cameras = zip(views.intrinsics, views.world_to_camera, strict=True)
    rays = np.stack([rays_of((SIZE, SIZE), *camera) for camera in cameras])
    eyes = views.camera_to_world[:, None, None, :3, 3]
    return eyes + ((GROUND - eyes[..., 1]) / np.minimum(rays[..., 1], -1e-3))[..., None] * rays


def test_likeness_counts_by_what_it_tells():
    """The object's own colours are unlike the table's, or as like as the table's own: then they tell nothing."""
    rng = np.random.default_rng(0)
    table = np.arange(4000) < 2000
    telling = np.where(table, rng.uniform(0.5, 1, 4000), rng.uniform(0, 0.5, 4000))
    chance = chances(telling, table, ~table)
    assert (chance[table] > 0.8).all()
    assert (chance[~table] < 0.1).all()
    dumb = chances(rng.uniform(0, 1, 4000), table, ~table)
    assert (np.abs(dumb - 0.5) < 0.1).all()
    order = np.argsort(telling)
    assert (np.diff(chance[order]) >= 0).all()
    telling[::7] = np.nan
    assert (chances(telling, table, ~table)[::7] == 0.5).all()
    assert (chances(telling, table, np.zeros_like(table)) == 0.5).all()


def test_a_depth_that_is_right_explains_and_one_carried_across_does_not(bench):
    pictures = (np.clip(np.asarray(bench.views.images), 0, 1) ** (1 / 2.2)).astype(np.float32)
    own = explained(bench.views, bench.depths.depth, pictures, bench.masks | bench.gaps)
    inner = np.stack([binary_erosion(one, iterations=3) for one in bench.masks])
    assert own[inner].mean() > 0.8
    assert own[bench.gaps].mean() < 0.35
    assert not own[~(bench.masks | bench.gaps)].any()
    assert not explained(bench.views, 0 * bench.depths.depth, pictures, bench.masks).any()


@given(st.floats(0.01, 0.99), st.floats(0.01, 0.99))
def test_chances_together(a, b):
    one, other = np.array([a]), np.array([b])
    assert together(one, other) == pytest.approx(together(other, one))
    assert together(one, np.array([0.5])) == pytest.approx(one)
    assert together(one, 1 - one) == pytest.approx(0.5)


def test_pixels_and_rays_are_inverse(bench):
    k, to_camera = bench.views.intrinsics[3], bench.views.world_to_camera[3]
    eye = bench.views.camera_to_world[3][:3, 3]
    rows, columns = np.indices((SIZE, SIZE))
    place, z = pixels_of(eye + 1.7 * rays_of((SIZE, SIZE), k, to_camera), k, to_camera)
    assert place[0] == pytest.approx(rows, abs=1e-6)
    assert place[1] == pytest.approx(columns, abs=1e-6)
    assert z == pytest.approx(1.7)
    behind, _ = pixels_of(eye - rays_of((SIZE, SIZE), k, to_camera), k, to_camera)
    assert (behind < -1e5).all()


def test_maps_are_thinned_in_the_middle_of_squares():
    depth = np.arange(36.0).reshape(1, 6, 6)
    assert thinned(depth, (2, 2), 3)[0].tolist() == [[7, 10], [25, 28]]
