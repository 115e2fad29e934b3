"""The nodes of data, priors and coarse start, run on small folders: what they read, hand on, and refuse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from exmesh_nodes import data, init
from io_scenes import ANGLE, CENTRE, RADIUS, SIZE, ring, sphere_picture

from benchmarks.meshes import write_obj, write_ply
from exmesh_graph.errors import DataError, GeometryError, MissingLibraryError
from exmesh_graph.geometry.adjacency import signed_volume
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.io.images import write_image
from exmesh_graph.io.normalise import FILL, frame_scale, points_to_normalised
from exmesh_graph.native import import_open3d, import_pymeshlab
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import Mesh


@pytest.fixture
def context():
    return FakeContext()


def need(importer):
    """Skip where a wheel lacks its system library (libGL and the like): the message names library and package."""
    try:
        importer()
    except MissingLibraryError as error:
        pytest.skip(str(error))


def check_views(out, train, test):
    """Splits, sizes, and cameras that see the ball where the normalised world says it is."""
    assert (len(out.train), len(out.test)) == (train, test)
    assert (out.train.split, out.test.split) == ("train", "test")
    assert not set(out.train.names) & set(out.test.names)
    centre = points_to_normalised(CENTRE[None], out.frame)[0]
    for views in (out.train, out.test):
        assert views.images.shape == (len(views), views.height, views.width, 3)
        for k, pose in zip(views.intrinsics, views.world_to_camera, strict=True):
            x, y, z = k @ (pose[:3, :3] @ centre + pose[:3, 3])
            assert z > 0
            assert 0 < x / z < views.width
            assert 0 < y / z < views.height
    return centre


def test_blender(blender_scene, context):
    p = data.BlenderParams(path=blender_scene)
    out = data.blender(context, p=p)
    centre = check_views(out, 9, 3)
    assert np.abs(centre).max() < 0.08  # the hull of nine views is loose, so its sphere is not quite the ball's
    assert 0.8 * FILL < RADIUS / frame_scale(out.frame) <= FILL
    # the ball's middle is the middle of its mask, in every view
    for alpha, k, pose in zip(out.train.alpha, out.train.intrinsics, out.train.world_to_camera, strict=True):
        rows, columns = np.nonzero(alpha > 0.5)
        x, y, z = k @ (pose[:3, :3] @ centre + pose[:3, 3])
        assert (x / z, y / z) == pytest.approx((columns.mean() + 0.5, rows.mean() + 0.5), abs=0.5)
    assert out.truth.mesh_vertices is None
    assert context.warnings == []
    listed = data._blender_sources(p)
    assert set(listed) == {
        "transforms_train.json",
        "transforms_test.json",
        *(f"{split}/{i:03d}_rgba.png" for split, n in (("train", 9), ("test", 3)) for i in range(n)),
    }
    half = data.blender(context, p=data.BlenderParams(path=blender_scene, downscale=2, hdr=False))
    check_views(half, 9, 3)
    assert (half.train.width, half.train.height) == (SIZE // 2, SIZE // 2)
    assert np.array_equal(half.frame.scene_from_normalised, out.frame.scene_from_normalised)
    check_views(data.blender(context, p=data.BlenderParams(path=blender_scene, max_views=4, max_test_views=2)), 4, 2)


def test_blender_says_what_it_cannot_read(blender_scene, context):
    with pytest.raises(DataError, match=r"_rgba\.exr"):
        data.blender(context, p=data.BlenderParams(path=blender_scene, hdr="true"))
    with pytest.raises(DataError, match="nowhere"):
        data._blender_sources(data.BlenderParams(path=blender_scene / "nowhere"))


def test_blender_passes_on_notes(blender_scene, context):
    write_image(blender_scene / "env_train.exr", np.ones((4, 8, 3), np.float32), "float")
    out = data.blender(context, p=data.BlenderParams(path=blender_scene, up="y"))
    assert out.truth.environment is None
    assert any("up: z only" in warning for warning in context.warnings)
    assert data.blender(FakeContext(), p=data.BlenderParams(path=blender_scene)).truth.environment is not None


def test_middlebury(middlebury_scene, context):
    p = data.MiddleburyParams(path=middlebury_scene, downscale=1, wrong_masks=0)
    out = data.middlebury(context, p=p)
    centre = check_views(out, 9, 1)
    assert out.test.names == ("v03",)
    assert out.train.has_masks
    assert np.abs(centre).max() < 0.08
    listed = data._middlebury_sources(p)
    assert set(listed) == {"ball_par.txt", *(f"{place}/v{i:02d}.png" for place in ("image", "mask") for i in range(10))}
    unmasked = data.middlebury(context, p=data.MiddleburyParams(path=middlebury_scene, downscale=1, masks=False))
    assert not unmasked.train.has_masks


def test_idr(idr_scene, context):
    p = data.IdrParams(path=idr_scene, up="y")
    out = data.idr(context, p=p)
    check_views(out, 9, 1)
    assert not out.train.has_masks
    assert frame_scale(out.frame) == pytest.approx(2 * RADIUS / FILL, rel=1e-6)
    assert out.frame.metres_per_unit == 0.001
    assert set(data._idr_sources(p)) == {"cameras_sphere.npz", *(f"image/{i:06d}.png" for i in range(10))}


@pytest.fixture
def with_depth(blender_scene):
    """The scene and a folder of exact depth maps of its training views, in the scene's units."""
    folder = blender_scene / "depth"
    folder.mkdir()
    for i, pose in enumerate(ring(9)):
        depth = sphere_picture(pose, samples=1)[2]
        np.save(folder / f"{i:03d}.npy", depth.astype(np.float32))
    return data.blender(FakeContext(), p=data.BlenderParams(path=blender_scene)), folder


def test_depth_files(with_depth, context):
    scene, folder = with_depth
    p = data.DepthFilesParams(folder=folder, pattern="{stem}")
    depths = data.prior_depth_files(context, scene.train, scene.frame, p=p).depths
    assert depths.names == scene.train.names
    # in normalised units: the ball's point nearest to each camera
    eyes = np.linalg.norm(
        scene.train.camera_to_world[:, :3, 3] - points_to_normalised(CENTRE[None], scene.frame), axis=1
    )
    nearest = np.array([d[d > 0].min() for d in depths.depth])
    assert nearest == pytest.approx(eyes - RADIUS / frame_scale(scene.frame), rel=0.01)
    plain = data.prior_depth_files(context, scene.train, p=p.model_copy(update={"units": "normalised", "scale": 0.5}))
    assert plain.depths.depth[3] == pytest.approx(0.5 * depths.depth[3] * frame_scale(scene.frame), rel=1e-5)
    with pytest.raises(DataError, match="wire `frame"):
        data.prior_depth_files(context, scene.train, p=p)
    assert set(data._depth_sources(p)) == {f"{i:03d}.npy" for i in range(9)}


def test_visual_hull(blender_scene, context):
    scene = data.blender(context, p=data.BlenderParams(path=blender_scene))
    mesh = init.visual_hull(context, scene.train, p=init.HullSettings(resolution=24)).mesh
    assert mesh.facets() == {"manifold": True, "closed": True, "uv": False, "units": "normalised"}
    radius = RADIUS / frame_scale(scene.frame)
    volume = 4 / 3 * np.pi * radius**3
    assert volume < signed_volume(mesh.vertices, mesh.faces) < 1.4 * volume  # a hull holds the ball
    empty = replace(scene.train, alpha=np.where(np.arange(9)[:, None, None] == 4, 0, scene.train.alpha))
    with pytest.raises(DataError, match=f"{scene.train.names[4]}: .*empty"):
        init.visual_hull(context, empty, p=init.HullSettings(resolution=24))


def test_tsdf(with_depth, context):
    need(import_open3d)
    scene, folder = with_depth
    p = data.DepthFilesParams(folder=folder, pattern="{stem}")
    depths = data.prior_depth_files(context, scene.train, scene.frame, p=p).depths
    mesh = init.tsdf(context, scene.train, depths, p=init.TsdfParams(resolution=48)).mesh
    centre = points_to_normalised(CENTRE[None], scene.frame)
    distance = np.linalg.norm(mesh.vertices - centre, axis=1)
    assert distance.mean() == pytest.approx(RADIUS / frame_scale(scene.frame), rel=0.03)
    with pytest.raises(DataError, match="names"):
        init.tsdf(context, scene.test, depths, p=init.TsdfParams())


@pytest.mark.parametrize("method", ["builtin", "pymeshlab", "open3d"])
def test_clean(method, context):
    if method != "builtin":
        need({"pymeshlab": import_pymeshlab, "open3d": import_open3d}[method])
    vertices, faces = icosphere(3)
    small, few = icosphere(1, radius=0.1)
    mesh = Mesh(np.concatenate([vertices, small + 3]), np.concatenate([faces, faces[:5], few + len(vertices)]))
    out = init.clean(context, mesh, p=init.CleanSettings(faces=400, method=method)).mesh
    assert out.facets() == {"manifold": True, "closed": True, "uv": False, "units": "normalised"}
    assert 300 <= len(out.faces) <= 400
    assert np.abs(out.vertices).max() < 1.1  # the small part is gone
    assert out.vertices.dtype == np.float32
    assert out.faces.dtype == np.int32


def test_clean_refuses_what_it_cannot_do(context):
    mesh = Mesh(*icosphere(1))
    with pytest.raises(GeometryError, match="close_holes"):
        init.clean(context, mesh, p=init.CleanSettings(faces=40, method="open3d", close_holes=10))
    with pytest.raises(GeometryError, match="no faces"):
        init.clean(context, replace(mesh, faces=mesh.faces[:0]), p=init.CleanSettings())


@pytest.mark.parametrize("name", ["ball.ply", "ball.obj"])
def test_mesh_file(blender_scene, context, name):
    """The true ball, written in each of the three spaces, lands in the same place."""
    frame = data.blender(context, p=data.BlenderParams(path=blender_scene)).frame
    write = write_ply if name.endswith("ply") else write_obj
    unit, faces = icosphere(1)
    in_dataset = RADIUS * unit + CENTRE
    spaces = {
        "dataset": in_dataset,
        "scene": in_dataset @ frame.dataset_from_scene[:3, :3],
        "normalised": points_to_normalised(in_dataset, frame),
    }
    for units, vertices in spaces.items():
        write(blender_scene / name, vertices, faces)
        p = init.MeshFileParams(path=blender_scene / name, units=units)
        mesh = init.mesh_file(context, frame, p=p).mesh
        assert mesh.vertices == pytest.approx(spaces["normalised"], abs=1e-5), units
        assert np.array_equal(mesh.faces, faces)
        assert set(init._mesh_file_sources(p)) == {name}
    with pytest.raises(DataError, match="wire `frame"):
        init.mesh_file(context, p=init.MeshFileParams(path=blender_scene / name))
    with pytest.raises(DataError, match="does not exist"):
        init._mesh_file_sources(init.MeshFileParams(path=blender_scene / "none.ply"))


def test_the_scenes_angle_is_what_the_cameras_say(blender_scene, context):
    out = data.blender(context, p=data.BlenderParams(path=blender_scene))
    assert 2 * np.arctan(0.5 * SIZE / out.train.intrinsics[0, 0, 0]) == pytest.approx(ANGLE)
