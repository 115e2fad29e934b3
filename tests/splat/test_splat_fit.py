"""Fitting planar Gaussians: start, optimiser, densification, the loop, files and nodes."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from exmesh_nodes import gaussians as nodes

from exmesh_graph.errors import DataError, GeometryError
from exmesh_graph.geometry.hull import SilhouetteField
from exmesh_graph.io.blender import load_blender
from exmesh_graph.io.normalise import make_frame
from exmesh_graph.io.settings import BlenderOptions
from exmesh_graph.splat import runtime
from exmesh_graph.splat.density import Density, control, reset_opacity
from exmesh_graph.splat.fit import fit
from exmesh_graph.splat.gaussians import Gaussians, rotation_matrices
from exmesh_graph.splat.optimiser import GaussianAdam
from exmesh_graph.splat.pgsr import pgsr
from exmesh_graph.splat.ply import read_gaussians, transformed, write_gaussians
from exmesh_graph.splat.render import render
from exmesh_graph.splat.settings import DepthSettings, PgsrSettings
from exmesh_graph.splat.start import gaussians_at, hull_points, mean_colours, random_points
from exmesh_graph.targets import prepare_targets
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import PlanarGaussians, PointCloud
from tests.splat.splat_scenes import camera, cloud

SAMPLE = Path(__file__).parents[2] / "graphs" / "samples" / "spot"
QUICK = PgsrSettings(iterations=30, count=1500, max_gaussians=3000, densify_rounds=3, samples=500)


@pytest.fixture(scope="module")
def views():
    return load_blender(SAMPLE, BlenderOptions(downscale=4, max_views=12)).train


@pytest.fixture(scope="module")
def fitted(views):
    return pgsr(views, QUICK)


def test_gaussians_at_points_lie_flat_on_normals():
    normals = np.array([[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0], [0.6, 0, 0.8], [0, 0, 0]])
    points = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.1, 0.1, 0], [0.05, 0.05, 0.05]])
    made = gaussians_at(points, np.full((5, 3), 0.7), normals)
    found = made.normals()[:4].numpy()
    assert np.allclose(np.abs((found * normals[:4]).sum(1)), 1, atol=1e-5)
    assert torch.allclose(torch.sigmoid(made.opacities), torch.tensor(0.1))
    assert float(made.sh[0, 0, 0] * 0.28209479 + 0.5) == pytest.approx(0.7)
    assert gaussians_at(points[:1], points[:1]).scales.isfinite().all()
    with pytest.raises(DataError, match="no points"):
        gaussians_at(np.zeros((0, 3)), np.zeros((0, 3)))


def test_starts_lie_where_they_should(views):
    field = SilhouetteField.from_masks(views.alpha, views.intrinsics, views.world_to_camera)
    points, normals = hull_points(field, 400, inside=0.5)
    inside = np.linalg.norm(normals, axis=1) == 0
    assert inside.sum() == 200
    assert (field(points[inside]) > 0).all()
    assert np.abs(field(points[~inside])).max() < 0.05
    colours = mean_colours(points, prepare_targets(views), normals)
    assert colours.shape == (len(points), 3)
    assert ((colours >= 0) & (colours <= 1)).all()
    assert np.linalg.norm(random_points(500), axis=1).max() <= 1


def test_adam_is_adam_where_seen_and_still_elsewhere():
    made = cloud(6, degree=1, dtype=torch.float64)
    rates = {"means": 1e-2, "scales": 2e-2, "rotations": 3e-2, "opacities": 4e-2, "sh": 5e-2, "sh_rest": 5e-2}
    mine = GaussianAdam(made.map(lambda t: t.clone()))
    leaves = made.map(lambda t: t.clone())
    theirs = torch.optim.Adam([{"params": [t], "lr": rates[n]} for n, t in leaves.tensors().items()], eps=1e-15)
    seen = torch.tensor([True] * 5 + [False])
    for step in range(3):
        g = torch.Generator().manual_seed(step)
        gradients = {n: torch.randn(t.shape, generator=g, dtype=t.dtype) for n, t in leaves.tensors().items()}
        mine.step(gradients, seen, rates)
        for name, tensor in leaves.tensors().items():
            tensor.grad = gradients[name]
        theirs.step()
    for name, tensor in mine.gaussians.tensors().items():
        assert torch.allclose(tensor[:5], leaves.tensors()[name][:5], rtol=1e-10)
        assert torch.equal(tensor[5], made.tensors()[name][5])


def test_density_doubles_splits_prunes_and_keeps_the_limit():
    made = cloud(6, size=0.02, opacity=0.0, dtype=torch.float32)
    made.scales[:] = np.log(0.005)
    made.scales[[1, 4]] = np.log(0.05)
    made.scales[3] = np.log(0.5)
    made.opacities[2] = -8
    settings = PgsrSettings(max_gaussians=100)
    density = Density(6, made.means)
    density.views += 1
    density.weight[:] = torch.tensor([1, 1, 1, 1, 1, 0.0])  # the last was never seen
    density.sums[0, 0], density.sums[1, 0], density.sums[4, 1] = 1e-3, 1e-3, 1e-3
    adam = GaussianAdam(made.map(lambda t: t.clone()))
    counts = control(adam, density, settings, torch.Generator().manual_seed(0))
    assert counts == {"pruned": 3, "doubled": 1, "split": 2}
    assert len(adam.gaussians) == len(adam.steps) == 6 - 3 + 1 + 2
    halves = adam.gaussians.scales[-4:].exp()
    assert torch.allclose(halves, torch.tensor(0.05 / 1.6))
    assert float((adam.gaussians.means[-4:] - made.means[[1, 4, 1, 4]]).norm(dim=1).max()) < 0.3
    again = GaussianAdam(made.map(lambda t: t.clone()))
    density.sums[4, 1] = 1e-2
    assert control(again, density, settings.replaced(max_gaussians=4), torch.Generator()) == {
        "pruned": 3, "doubled": 0, "split": 1,
    }  # fmt: skip
    assert len(again.gaussians) == 4
    reset_opacity(again)
    assert float(torch.sigmoid(again.gaussians.opacities).max()) <= 0.0100001


@pytest.mark.thorough
def test_a_fit_improves_and_repeats_to_the_byte(views, fitted):
    made, history = fitted
    assert history["psnr"][-1] > history["psnr"][0] + 3
    assert history["iteration"][-1] == 30
    assert history["suspects"] == {}
    again, _ = pgsr(views, QUICK)
    assert all(np.array_equal(getattr(made, n), getattr(again, n)) for n in ("means", "scales", "opacities", "sh"))


@pytest.mark.thorough
def test_a_fit_cut_off_ends_with_the_same_bytes(views, fitted):
    kept = {}

    def checkpoint(step, state):
        if step in (1, 17):
            kept[step] = {
                "adam": {k: ({n: t.clone() for n, t in v.items()} if isinstance(v, dict) else v.clone())
                         for k, v in state["adam"].items()},
                "density": {n: t.clone() for n, t in state["density"].items()},
                "history": {n: list(v) for n, v in state["history"].items()}, "sums": list(state["sums"]),
                "gains": state["gains"].clone(),
            }  # fmt: skip

    pgsr(views, QUICK, checkpoint=checkpoint)
    for step, state in kept.items():
        made, history = pgsr(views, QUICK, resumed=(step, state))
        assert np.array_equal(made.means, fitted[0].means)
        assert history == fitted[1]


@pytest.mark.thorough
def test_exposure_takes_what_wanders(views):
    gain = np.linspace(0.8, 1.25, len(views)).astype(np.float32)
    dim = replace(views, images=views.images * gain[:, None, None, None])
    settings = QUICK.replaced(iterations=60, gains=True)
    _, with_it = pgsr(dim, settings)
    _, without = pgsr(dim, settings.replaced(gains=False))
    found = np.array([with_it["gains"][name][0] for name in dim.names])
    assert np.corrcoef(found, np.log(gain))[0, 1] > 0.7
    assert with_it["psnr"][-1] > without["psnr"][-1]


@pytest.mark.thorough
def test_a_blurred_view_is_named(views):
    from scipy.ndimage import gaussian_filter

    images = views.images.copy()
    images[5] = np.roll(gaussian_filter(images[5], (4, 4, 0)), 6, axis=1)
    _, history = pgsr(replace(views, images=images), QUICK.replaced(iterations=120))
    assert list(history["suspects"]) == [views.names[5]]


@pytest.mark.thorough
def test_hard_views_give_a_result_or_a_clear_error(views):
    few = replace(views, **{n: getattr(views, n)[:2] for n in ("names", "images", "alpha", "intrinsics")},
                  camera_to_world=views.camera_to_world[:2])  # fmt: skip
    _, history = pgsr(few, QUICK.replaced(iterations=12, count=300))
    assert set(history["alone"]) <= set(few.names)
    bare = replace(views, alpha=np.ones_like(views.alpha), has_masks=False)
    made, _ = pgsr(bare, QUICK.replaced(iterations=12, count=300))
    assert np.isfinite(made.means).all()
    with pytest.raises(DataError, match="needs a mask"):
        pgsr(bare, QUICK.replaced(start="hull"))
    flat = replace(views, images=np.repeat(views.alpha[..., None] * 0.5, 3, -1))
    made, history = pgsr(flat, QUICK.replaced(iterations=30, count=300))
    assert np.isfinite(made.means).all()
    empty = views.alpha.copy()
    empty[3] = 0
    with pytest.raises(DataError, match=r"empty"):
        pgsr(replace(views, alpha=empty), QUICK)
    black = replace(views, images=np.zeros_like(views.images), alpha=np.zeros_like(views.alpha))
    with pytest.raises(GeometryError, match="no Gaussian is left"):
        pgsr(black, QUICK.replaced(iterations=300, min_opacity=0.08, count=50, start="random"))


def test_the_code_of_every_kernel_is_part_of_the_nodes_fingerprint():
    from exmesh_graph.graph.cache.fingerprint import fingerprint
    from exmesh_graph.graph.declare.packs import load_packs

    room = Path(runtime.__file__).parent
    files = {f"exmesh_graph.splat.{path.stem}" for path in room.glob("kernels_*.py")}
    assert len(files) == 5
    fused = {f"exmesh_graph.splat.fused.{path.stem}" for path in room.glob("fused/*.py") if path.stem != "__init__"}
    assert files | fused <= set(fingerprint(load_packs().types["init.pgsr"]).modules)
    drawn = {f"exmesh_graph.splat.fused.{name}" for name in ("kernels_draw", "native_project", "native_blend")}
    assert files | drawn <= set(fingerprint(load_packs().types["prior.depth_from_gaussians"]).modules)


def test_any_object_with_the_settings_attributes_will_do(views):
    short = QUICK.replaced(iterations=2)
    made, _ = pgsr(views, short)
    plain, _ = pgsr(views, SimpleNamespace(**short.model_dump()))
    assert np.array_equal(made.means, plain.means)
    assert issubclass(nodes.PgsrParams, PgsrSettings)  # declared once
    assert issubclass(nodes.DepthParams, DepthSettings)


def test_points_far_outside_are_left_out(views):
    points = random_points(200, radius=0.8)
    points[:20] *= 1000
    lines = []
    found, once = PointCloud(points, np.full((200, 3), 0.5, np.float32)), QUICK.replaced(iterations=1, densify_rounds=0)
    made, _ = pgsr(views, once, points=found, log=lines.append)
    assert len(made) == 180
    assert "20 far outside" in lines[0]
    with pytest.raises(DataError, match="all 200 points"):
        pgsr(views, QUICK, points=PointCloud(points * 1e6, points))
    with pytest.raises(DataError, match="no points are wired"):
        pgsr(views, QUICK.replaced(start="points"))
    with pytest.raises(DataError, match="max_gaussians"):
        pgsr(views, QUICK.replaced(count=5000))


def test_nothing_left_to_draw_is_an_error(views):
    far = cloud(5, dtype=torch.float32)
    far.means[:] = 100.0
    with pytest.raises(GeometryError, match="no Gaussian is left"):
        fit(far, prepare_targets(views), QUICK.replaced(iterations=10))


def test_ply_comes_back_and_other_orders_are_read(tmp_path):
    for degree in (0, 1, 3):
        made = cloud(7, degree=degree, dtype=torch.float32)
        write_gaussians(tmp_path / "g.ply", made)
        back = read_gaussians(tmp_path / "g.ply")
        assert all(torch.equal(a, b) for a, b in zip(made.tensors().values(), back.tensors().values(), strict=True))
    head = (tmp_path / "g.ply").read_bytes().split(b"end_header\n")[0].decode().split("\n")
    names = [line.split()[2] for line in head if line.startswith("property")]
    assert names[:9] == ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    assert names[9] == "f_rest_0"
    assert names[54:] == ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    table = np.frombuffer((tmp_path / "g.ply").read_bytes().split(b"end_header\n", 1)[1], "<f4").reshape(7, -1)
    assert np.array_equal(table[:, names.index("f_rest_15")], made.sh[:, 1, 1])  # green after all of red
    order = np.random.default_rng(0).permutation(len(names))
    lines = ["ply", "format binary_big_endian 1.0", "element vertex 7"]
    lines += [f"property double {names[i]}" for i in order] + ["end_header\n"]
    (tmp_path / "h.ply").write_bytes("\n".join(lines).encode() + table[:, order].astype(">f8").tobytes())
    back = read_gaussians(tmp_path / "h.ply")
    assert all(torch.equal(a, b) for a, b in zip(made.tensors().values(), back.tensors().values(), strict=True))


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda d: d[:200], "no PLY header|ends early"),
        (lambda d: d[:-8], "ends early"),
        (lambda d: d.replace(b"opacity", b"opacitx"), "no opacity"),
        (lambda d: d.replace(b"f_rest_44", b"x_rest_44"), "44 f_rest"),
        (lambda d: d.replace(b"binary_little_endian", b"ascii"), "binary"),
        (lambda d: d[:-4] + np.float32(np.nan).tobytes(), "NaN"),
    ],
)
def test_bad_files_are_refused(tmp_path, change, match):
    write_gaussians(tmp_path / "g.ply", cloud(3, dtype=torch.float32))
    (tmp_path / "g.ply").write_bytes(change((tmp_path / "g.ply").read_bytes()))
    with pytest.raises(DataError, match=match):
        read_gaussians(tmp_path / "g.ply")
    with pytest.raises(DataError, match="does not exist"):
        read_gaussians(tmp_path / "none.ply")


def test_moved_gaussians_look_the_same_from_the_moved_camera():
    made = cloud(30, size=0.3)
    intrinsics, pose = camera(32, 24)
    turn = rotation_matrices(torch.tensor([[0.3, -0.5, 0.7, 0.2]]).double())[0]
    similarity = torch.eye(4, dtype=torch.float64)
    similarity[:3, :3], similarity[:3, 3] = 2.5 * turn, torch.tensor([3.0, -4, 5])
    moved = transformed(made, similarity.numpy())
    there = torch.eye(4, dtype=torch.float64)
    there[:3, :3] = pose[:3, :3] @ turn.T
    there[:3, 3] = 2.5 * pose[:3, 3] - there[:3, :3] @ similarity[:3, 3]
    a, b = render(made, intrinsics, pose, 24, 32), render(moved, intrinsics, there, 24, 32, near=0.025)
    assert torch.allclose(a.colour, b.colour, atol=1e-9)
    assert torch.allclose(a.normal, b.normal, atol=1e-9)
    assert torch.allclose(2.5 * a.distance, b.distance, atol=1e-9)


@pytest.mark.thorough
def test_the_nodes(views, fitted, tmp_path):
    context = FakeContext(scratch=tmp_path)
    out = nodes.pgsr(context, views, p=nodes.PgsrParams(iterations=6, count=500, max_gaussians=800))
    assert context.steps[-1] == (6, 6)
    assert len(out.gaussians) > 0
    assert "hull" in context.lines[0]
    more = nodes.pgsr(context, views, None, fitted[0], p=nodes.PgsrParams(iterations=2))
    assert len(more.gaussians) > len(fitted[0]) / 2
    depths = nodes.depth_from_gaussians(context, fitted[0], views, p=nodes.DepthParams(agreeing=0)).depths
    assert depths.depth.shape == views.alpha.shape
    with pytest.raises(GeometryError, match="no depth is left"):
        nodes.depth_from_gaussians(context, fitted[0], views, p=nodes.DepthParams(incidence=1e-3))
    turn = np.eye(4)
    turn[1:3, 1:3] = [[0, -1], [1, 0]]
    frame = make_frame(np.array([1.0, 2, 3]), 2.0, turn)
    for units in ("normalised", "scene", "dataset"):
        file = nodes.export_gaussians(
            replace_scratch(context, tmp_path / units), fitted[0], frame, p=nodes.GaussianExportParams(units=units)
        ).files
        path = file.root / file.main
        back = nodes.gaussian_file(context, frame, p=nodes.GaussianFileParams(path=path, units=units)).gaussians
        assert np.allclose(back.means, fitted[0].means, atol=1e-5)
        assert np.allclose(back.sh, fitted[0].sh, atol=1e-4)
        assert np.allclose(back.scales, fitted[0].scales, atol=1e-4)
    with pytest.raises(DataError, match="frame"):
        nodes.gaussian_file(context, None, p=nodes.GaussianFileParams(path=path))
    with pytest.raises(DataError, match="does not exist"):
        nodes._gaussian_file(nodes.GaussianFileParams(path=tmp_path / "none.ply"))


def replace_scratch(context, folder):
    folder.mkdir()
    return replace(context, scratch=folder)


def test_an_artifact_is_not_changed(views, fitted):
    before = fitted[0].means.copy()
    pgsr(views, QUICK.replaced(iterations=2), begin=fitted[0])
    assert np.array_equal(before, fitted[0].means)
    low = PlanarGaussians(**{n: getattr(fitted[0], n) for n in ("means", "scales", "rotations", "opacities")},
                          sh=fitted[0].sh[:, :1])  # fmt: skip
    assert pgsr(views, QUICK.replaced(iterations=2), begin=low)[0].sh.shape[1] == 16
    assert isinstance(Gaussians(*(torch.zeros(2),) * 5), Gaussians)
