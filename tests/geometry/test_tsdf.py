"""TSDF fusion of depth maps ray-cast from a sphere and from the sample scene's mesh."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from exmesh_graph.errors import DataError, GeometryError
from exmesh_graph.geometry.adjacency import signed_volume
from exmesh_graph.geometry.clean import clean_mesh, inspect
from exmesh_graph.geometry.settings import CleanSettings, TsdfSettings
from exmesh_graph.geometry.tsdf import fuse
from exmesh_graph.gpu.cores import cores
from exmesh_graph.types import DepthMaps, Views

CARVE = TsdfSettings(resolution=48, truncation=3, min_weight=2)
SAMPLE = Path(__file__).parents[2] / "graphs" / "samples" / "spot"


def sphere_views(count=14, size=96, radius=0.7, centre=(0.1, -0.05, 0.0)):
    """Views and exact z-depth of a sphere, from all around."""
    i = np.arange(count) + 0.5
    y, turn = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    eyes = 3.5 * np.stack([np.cos(turn) * np.sqrt(1 - y * y), y, np.sin(turn) * np.sqrt(1 - y * y)], axis=1)
    f = 0.5 * size / np.tan(0.3)
    k = np.array([[f, 0, size / 2], [0, f, size / 2], [0, 0, 1]])
    px, py = np.meshgrid(np.arange(size) + 0.5, np.arange(size) + 0.5)
    poses, depths = [], []
    for eye in eyes:
        z = -eye / np.linalg.norm(eye)
        x = np.cross(z, [0.0, 1, 0])
        x /= np.linalg.norm(x)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), eye
        d = np.stack([px, py, np.ones_like(px)], axis=-1) @ np.linalg.inv(k).T @ pose[:3, :3].T
        to = eye - np.asarray(centre)
        a, b, c = (d * d).sum(-1), 2 * (d @ to), to @ to - radius**2
        inside = b * b - 4 * a * c
        depths.append(np.where(inside > 0, (-b - np.sqrt(np.maximum(inside, 0))) / (2 * a), 0))
        poses.append(pose)
    depth = np.stack(depths).astype(np.float32)
    names = tuple(f"v{i}" for i in range(count))
    views = Views(
        names=names,
        images=np.zeros((*depth.shape, 3), np.float32),
        alpha=(depth > 0).astype(np.float32),
        intrinsics=np.repeat(k[None], count, axis=0),
        camera_to_world=np.stack(poses),
        split="train",
    )
    return views, DepthMaps(names, depth)


@pytest.fixture(scope="module")
def sphere():
    return sphere_views()


def test_points_beyond_the_radius_are_ignored(sphere):
    """A wall behind the sphere, 2 from the origin on every side."""
    views, depths = sphere
    walled = DepthMaps(depths.names, np.where(depths.depth > 0, depths.depth, np.float32(5.5)))
    kept, _ = fuse(views, walled, TsdfSettings(resolution=48, masked=False, radius=1.0))
    assert np.linalg.norm(kept - [0.1, -0.05, 0.0], axis=1).max() < 0.85
    with_wall, _ = fuse(views, walled, TsdfSettings(resolution=48, masked=False))
    assert np.linalg.norm(with_wall, axis=1).max() > 1.5


def test_sphere(sphere):
    vertices, faces = fuse(*sphere, TsdfSettings(resolution=64))
    r = np.linalg.norm(vertices - [0.1, -0.05, 0.0], axis=1)
    # Half a pixel of shift in the projection would move the surface by 0.01 here; the voxel is 0.031.
    assert r.mean() == pytest.approx(0.7, abs=0.004)
    assert np.abs(r - 0.7).max() < 0.04
    # seen from outside the faces turn counter-clockwise
    assert signed_volume(vertices, faces) == pytest.approx(4 / 3 * np.pi * 0.7**3, rel=0.03)
    assert inspect(vertices, faces).crowded_edges == 0


def test_finer_voxels_are_more_exact(sphere):
    errors = []
    for resolution in (32, 96):
        vertices, _ = fuse(*sphere, TsdfSettings(resolution=resolution))
        errors.append(np.abs(np.linalg.norm(vertices - [0.1, -0.05, 0.0], axis=1) - 0.7).mean())
    assert errors[1] < 0.5 * errors[0]


def test_same_bytes_each_time(sphere):
    first, second = fuse(*sphere, TsdfSettings(resolution=48)), fuse(*sphere, TsdfSettings(resolution=48))
    assert np.array_equal(first[0], second[0])
    assert np.array_equal(first[1], second[1])


def test_masks_remove_background(sphere):
    views, depths = sphere
    walled = np.where(depths.depth > 0, depths.depth, 3.9).astype(np.float32)  # a wall behind the sphere
    masked, _ = fuse(views, DepthMaps(views.names, walled), TsdfSettings(resolution=48))
    assert np.linalg.norm(masked, axis=1).max() < 1
    plain, _ = fuse(views, DepthMaps(views.names, walled), TsdfSettings(resolution=48, masked=False))
    assert len(plain) > len(masked)


@pytest.mark.thorough
def test_result_can_be_cleaned(sphere):
    vertices, faces = clean_mesh(*fuse(*sphere, TsdfSettings(resolution=48)), CleanSettings(faces=600, close_holes=100))
    assert inspect(vertices, faces).closed


def test_bad_input(sphere):
    views, depths = sphere
    with pytest.raises(DataError, match="not those of the views"):
        fuse(views, DepthMaps(tuple(reversed(views.names)), depths.depth), TsdfSettings(resolution=40))
    with pytest.raises(DataError, match="the depth maps are"):
        fuse(views, DepthMaps(views.names, depths.depth[:, ::2]), TsdfSettings(resolution=40))
    with pytest.raises(GeometryError, match="no surface"):
        fuse(views, DepthMaps(views.names, depths.depth * 0), TsdfSettings(resolution=40))


@pytest.mark.thorough
def test_sample_mesh_from_ray_cast_depth():
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    from exmesh_graph.evaluate.metrics.mesh import chamfer
    from exmesh_graph.io.blender import load_blender
    from exmesh_graph.io.settings import BlenderOptions

    scene = load_blender(SAMPLE, BlenderOptions(downscale=2))
    views, truth = scene.train, scene.truth
    embree = EmbreeScene()
    TriangleMesh(embree, truth.mesh_vertices, truth.mesh_faces)
    px, py = np.meshgrid(np.arange(views.width) + 0.5, np.arange(views.height) + 0.5)
    pixels = np.stack([px, py, np.ones_like(px)], axis=-1).reshape(-1, 3)
    depths = []
    for k, pose in zip(views.intrinsics, views.camera_to_world, strict=True):
        d = pixels @ np.linalg.inv(k).T @ pose[:3, :3].T
        length = np.linalg.norm(d, axis=1)
        unit = (d / length[:, None]).astype(np.float32)
        origins = np.repeat(pose[None, :3, 3], len(d), axis=0).astype(np.float32)
        hit = embree.run(origins, unit, output=1)
        depths.append(np.where(hit["primID"] >= 0, hit["tfar"] / length, 0).reshape(views.height, views.width))
    fused = fuse(views, DepthMaps(views.names, np.stack(depths).astype(np.float32)), TsdfSettings(resolution=128))
    result = chamfer(*fused, truth.mesh_vertices, truth.mesh_faces, samples=5000)
    assert result.chamfer < 2.5e-3  # a sixth of a voxel; half a pixel of shift would give 0.006


def test_carved_depth_is_closed_and_where_the_truth_is():
    """Masks and depth of a sphere; a bite that the depth maps alone see; a side that they do not see."""
    from exmesh_graph.geometry.carve import carving
    from exmesh_graph.geometry.hull import SilhouetteField, surface

    def carve(given):
        found = carving(field, views, given, CARVE)
        assert np.array_equal(found.field(np.ones(found.grid.shape, bool)), found.hull)
        assert np.array_equal(found.taken, (found.hull > 0) & (found.left < 0))
        return surface(found.field(), found.grid)

    views, depths = sphere_views(count=24)
    alpha = (depths.depth > 0).astype(np.float32)
    views = replace(views, alpha=alpha, has_masks=True)
    field = SilhouetteField.from_masks(alpha, views.intrinsics, views.world_to_camera)
    centre = np.array([0.1, -0.05, 0.0])
    # the ball less a ball around its top: rays that meet the bite go on to its far side
    top, bite = centre + np.array([0, 0.7, 0]), 0.35
    cut, half = depths.depth.copy(), depths.depth.copy()
    for i, (k, pose) in enumerate(zip(views.intrinsics, views.camera_to_world, strict=True)):
        y, x = np.indices(alpha.shape[1:]) + 0.5
        rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(k).T @ pose[:3, :3].T
        points = pose[:3, 3] + depths.depth[i][..., None] * rays
        inside = (np.linalg.norm(points - top, axis=-1) < bite) & (depths.depth[i] > 0)
        to = pose[:3, 3] - top
        a, b, c = (rays * rays).sum(-1), 2 * rays @ to, to @ to - bite**2
        far = (-b + np.sqrt(np.maximum(b * b - 4 * a * c, 0))) / (2 * a)
        out = np.linalg.norm(pose[:3, 3] + far[..., None] * rays - centre, axis=-1) > 0.7
        cut[i] = np.where(inside, np.where(out, 0, far), depths.depth[i])
        half[i] = np.where(points[..., 1] < centre[1], 0, depths.depth[i])
    whole = carve(depths)
    bitten = carve(replace(depths, depth=cut.astype(np.float32)))
    unseen = carve(replace(depths, depth=half.astype(np.float32)))
    for vertices, faces in (whole, bitten, unseen):
        report = inspect(vertices, faces)
        assert report.closed
        assert signed_volume(vertices, faces) > 0
    voxel = 1.4 / 48
    assert np.abs(np.linalg.norm(whole[0] - centre, axis=1) - 0.7).max() < 1.5 * voxel
    assert np.abs(np.linalg.norm(unseen[0] - centre, axis=1) - 0.7).max() < 1.5 * voxel
    floor = bitten[0][np.linalg.norm(bitten[0] - centre, axis=1) < 0.6]
    assert len(floor) > 50
    assert np.median(np.abs(np.linalg.norm(floor - top, axis=1) - bite)) < voxel
    with pytest.raises(DataError, match="not those of the views"):
        carve(replace(depths, names=depths.names[::-1]))


def test_depth_maps_near_the_hull_leave_it_and_others_carve():
    from exmesh_graph.geometry.carve import carved

    hull = np.full(6, 0.3)
    below = np.array([-0.2, 0.0, 0.1, 0.15, 0.2, 0.5])
    np.testing.assert_allclose(hull - carved(hull, hull - below, 0.1), [0, 0, 0, 0.1, 0.2, 0.5], atol=1e-12)


@pytest.mark.parametrize("least", [0, 1, 5])
def test_the_kernel_gives_what_numpy_gives(least):
    """Points all around, on a camera's plane and behind cameras; depth maps with holes, one of them empty."""
    from exmesh_graph.geometry.carve import depth_field, plain_depth_field

    rng = np.random.default_rng(0)
    views, depths = sphere_views(count=6)
    holed = np.where(rng.random(depths.depth.shape) < 0.2, 0, depths.depth).astype(np.float32)
    holed[2] = 0
    depths = replace(depths, depth=holed)
    points = rng.uniform(-1, 1, (20000, 3)).astype(np.float32) * np.repeat([1, 20], 10000)[:, None].astype(np.float32)
    points[0] = views.camera_to_world[0, :3, 3]
    given = (views, depths, 0.1, least)
    plain, values = plain_depth_field(points, *given), depth_field(points, *given)
    # a point whose pixel or truncation turns on the last bit falls to either side
    same = np.isclose(values, plain, rtol=1e-4, atol=1e-5)
    assert same.mean() > 0.999
    assert (np.abs(values[~same]) <= 0.1).all()
    for count in (2, 3):
        with cores(count):
            assert np.array_equal(depth_field(points, *given), values)


def test_a_blur_smooths_what_was_carved_and_leaves_the_hull_alone():
    from scipy.ndimage import gaussian_filter

    from exmesh_graph.geometry.carve import blurred

    random = np.random.default_rng(0)
    values = random.normal(size=(24, 20, 22)).astype(np.float32)
    changed = np.zeros(values.shape, bool)
    assert np.array_equal(blurred(values, changed, 1.0, 9.0), values)
    changed[:8] = True
    assert blurred(values, changed, 0.0, 9.0) is values
    made = blurred(values, changed, 1.0, 0.5)
    cut = np.clip(values, -0.5, 0.5)
    assert made[:6] == pytest.approx(gaussian_filter(cut, 1.0, mode="nearest")[:6], abs=1e-5)
    assert np.array_equal(made[14:], cut[14:])  # four deviations away
