"""Clean-up: damaged meshes become sound ones, sound ones stay closed, and what cannot be mended is an error."""

import itertools

import numpy as np
import pytest

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry import clean
from exmesh_graph.geometry.adjacency import face_areas, signed_volume
from exmesh_graph.geometry.clean import clean_mesh, lost_parts, outward, taubin, weld, without_pillows
from exmesh_graph.geometry.hull import Grid, surface
from exmesh_graph.geometry.settings import CleanSettings
from exmesh_graph.geometry.soundness import inspect, require_sound

METHODS = ["builtin", "pymeshlab", "open3d"]
CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
CUBE_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


def ball(radius=0.8, centre=(0, 0, 0), resolution=24):
    grid = Grid.over(np.full(3, -1.0), np.full(3, 1.0), resolution)
    values = radius - np.linalg.norm(grid.points() - np.asarray(centre, np.float32), axis=1)
    return surface(values.reshape(grid.shape), grid)


def torus(resolution=32):
    grid = Grid.over(np.full(3, -1.0), np.full(3, 1.0), resolution)
    x, y, z = grid.points().T
    return surface((0.25 - np.hypot(np.hypot(x, z) - 0.6, y)).reshape(grid.shape), grid)


def join(*meshes):
    offsets = np.cumsum([0] + [len(v) for v, _ in meshes])
    faces = [f + o for (_, f), o in zip(meshes, offsets, strict=False)]
    return np.concatenate([v for v, _ in meshes]), np.concatenate(faces)


def genus(vertices, faces):
    return (2 - (len(vertices) - 3 * len(faces) // 2 + len(faces))) // 2


class TestInspect:
    def test_cube_is_sound(self):
        found = inspect(CUBE, CUBE_FACES)
        assert found.closed
        assert sum(vars(found).values()) == 0
        assert signed_volume(CUBE, CUBE_FACES) == pytest.approx(1)
        require_sound(CUBE, CUBE_FACES, closed=True, where="")

    def test_each_defect_is_counted(self):
        assert inspect(CUBE, CUBE_FACES[:-1]).open_edges == 3
        turned = CUBE_FACES.copy()
        turned[0] = turned[0, ::-1]
        assert inspect(CUBE, turned).turned_edges == 3
        assert inspect(CUBE, np.vstack([CUBE_FACES, [0, 1, 3]])).duplicate_faces == 1
        assert inspect(CUBE, np.vstack([CUBE_FACES, [0, 1, 3]])).crowded_edges == 3
        assert inspect(np.vstack([CUBE, [[5, 5, 5]]]), CUBE_FACES).unreferenced == 1
        flat = CUBE.copy()
        flat[1] = flat[0]
        assert inspect(flat, CUBE_FACES).flat_faces > 0

    def test_two_cubes_that_share_a_corner_are_pinched_there(self):
        vertices, faces = join((CUBE, CUBE_FACES), (CUBE + 1, CUBE_FACES))
        vertices, faces = weld(vertices, faces)
        assert len(vertices) == 15
        assert inspect(vertices, faces).pinched_vertices == 1

    @pytest.mark.parametrize(
        ("change", "match"),
        [
            (lambda v, f: (v, f[:-1]), "3 open edges"),
            (lambda v, f: (v, f[:, ::-1]), "look inwards"),
            (lambda v, f: (v, np.vstack([f, f[:1]])), "duplicate faces"),
            (lambda v, f: (np.vstack([v, v[:1] + 9]), f), "without a face"),
            (lambda v, f: (v * np.array([[np.nan, 1, 1]]), f), "NaN"),
        ],
    )
    def test_unsound_meshes_are_refused_with_the_reason(self, change, match):
        with pytest.raises(GeometryError, match=f"my node: .*{match}"):
            require_sound(*change(CUBE, CUBE_FACES), closed=True, where="my node")


@pytest.mark.thorough
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("budget", [300, 1500])
def test_ball_within_the_budget(method, budget):
    vertices, faces = clean_mesh(*ball(), CleanSettings(faces=budget, method=method))
    assert 0.75 * budget <= len(faces) <= budget
    assert vertices.dtype == np.float32
    assert faces.dtype == np.int32
    require_sound(vertices, faces, closed=True, where="")
    assert genus(vertices, faces) == 0
    assert np.linalg.norm(vertices, axis=1) == pytest.approx(0.8, abs=0.03)


@pytest.mark.parametrize("method", METHODS)
def test_handles_survive(method):
    vertices, faces = clean_mesh(*torus(), CleanSettings(faces=800, method=method))
    assert genus(vertices, faces) == 1


@pytest.mark.parametrize("method", METHODS[:2])
def test_isotropic_methods_give_even_triangles(method):
    vertices, faces = clean_mesh(*ball(), CleanSettings(faces=800, method=method))
    edges = np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, axis=1)], axis=2)
    assert edges.std() / edges.mean() < 0.2


@pytest.mark.parametrize("method", METHODS)
def test_damaged_input_is_mended(method):
    """Inside out, doubled faces, slivers, floaters, a fin on an edge: all gone, the ball still closed."""
    vertices, faces = ball()
    floater, floater_faces = ball(0.1, (0.85, 0.85, 0.85))
    damaged, broken = join((vertices, faces), (floater, floater_faces))
    broken = np.vstack([broken, broken[:5], [[0, 0, 1], [7, 8, 8]]])
    result = clean_mesh(damaged, broken[:, ::-1], CleanSettings(faces=700, method=method))
    require_sound(*result, closed=True, where="")
    assert np.linalg.norm(result[0], axis=1).max() < 0.85


@pytest.mark.parametrize("method", METHODS)
def test_non_manifold_edges_are_repaired(method):
    vertices, faces = ball()
    fin = np.vstack([vertices, [[0, 0, 1.5]]])
    finned = np.vstack([faces, [[*faces[100, :2], len(vertices)]]])
    assert inspect(fin, finned).crowded_edges == 1
    result = clean_mesh(fin, finned, CleanSettings(faces=700, method=method))
    assert inspect(*result).crowded_edges == 0


@pytest.mark.thorough
def test_components():
    two = join(ball(0.35, (-0.5, 0, 0)), ball(0.25, (0.6, 0, 0)))
    both = clean_mesh(*two, CleanSettings(faces=900, components=0))
    assert both[0][:, 0].max() > 0.5
    assert signed_volume(*both) == pytest.approx(4 / 3 * np.pi * (0.35**3 + 0.25**3), rel=0.08)
    one = clean_mesh(*two, CleanSettings(faces=900, components=1))
    assert one[0][:, 0].max() < 0
    large = clean_mesh(*two, CleanSettings(faces=900, components=0, min_area=0.9))
    assert large[0][:, 0].max() < 0


@pytest.mark.thorough
@pytest.mark.parametrize("method", METHODS[:2])
def test_holes_are_closed_on_request(method):
    vertices, faces = ball()
    holed = faces[np.linalg.norm(vertices[faces].mean(1) - [0.8, 0, 0], axis=1) > 0.2]
    assert inspect(*clean_mesh(vertices, holed, CleanSettings(faces=700, method=method))).open_edges > 0
    assert (
        inspect(*clean_mesh(vertices, holed, CleanSettings(faces=700, close_holes=200, method=method))).open_edges == 0
    )
    with pytest.raises(GeometryError, match="cannot close holes"):
        clean_mesh(vertices, holed, CleanSettings(faces=700, method="open3d", close_holes=200))


def test_result_is_measured_not_believed(monkeypatch):
    monkeypatch.setattr(clean, "remesh", lambda v, f, *_: (v, f[:-1]))
    with pytest.raises(GeometryError, match="3 open edges"):
        clean_mesh(*ball(resolution=10), CleanSettings(faces=700))


def test_an_open_mesh_loses_the_faces_that_stay_flat(monkeypatch):
    vertices, faces = ball()
    vertices, faces = vertices, faces[vertices[faces].mean(1)[:, 1] < 0.3]
    before = clean_mesh(vertices, faces, CleanSettings(faces=300))

    def fold(v, f, *_):
        made = before[0].astype(np.float64).copy()
        made[before[1][5, 0]] = made[before[1][5, 1]]
        return made, before[1]

    monkeypatch.setattr(clean, "remesh", fold)
    v, f = clean_mesh(vertices, faces, CleanSettings(faces=300))
    a, b = before[1][5, :2]
    assert len(f) == len(before[1]) - ((before[1] == a).any(1) & (before[1] == b).any(1)).sum() < len(before[1])
    assert inspect(v, f).flat_faces == inspect(v, f).unreferenced == 0


def test_empty_and_collapsed_input():
    with pytest.raises(GeometryError, match="no faces"):
        clean_mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]), CleanSettings(faces=100))


@pytest.mark.parametrize("method", METHODS)
def test_same_input_same_bytes(method):
    first, second = (clean_mesh(*ball(resolution=16), CleanSettings(faces=300, method=method)) for _ in range(2))
    assert np.array_equal(first[0], second[0])
    assert np.array_equal(first[1], second[1])


def test_outward_turns_each_part():
    two = join((CUBE, CUBE_FACES[:, ::-1]), (CUBE + 3, CUBE_FACES))
    assert signed_volume(two[0], outward(*two)) == pytest.approx(2)


def rods(resolution=96):
    """A ball with four rods, a fortieth as thick as the whole is long."""
    grid = Grid.over(np.full(3, -1.0), np.full(3, 1.0), resolution)
    points = grid.points()
    values = 0.3 - np.linalg.norm(points, axis=1)
    for axis in (0, 1):
        across = np.linalg.norm(np.delete(points, axis, axis=1), axis=1)
        values = np.maximum(values, np.minimum(0.025 - across, 0.9 - np.abs(points[:, axis])))
    return surface(values.reshape(grid.shape), grid)


@pytest.mark.thorough
def test_thin_parts_get_the_faces_they_need():
    start = rods()
    few = clean_mesh(*start, CleanSettings(faces=100, components=0))
    assert lost_parts(start, few, 0.03) > 0.05  # what the tolerance is for
    radius = np.linalg.norm(np.ptp(start[0], axis=0)) / 2
    kept = clean_mesh(*start, CleanSettings(faces=100, components=0, tolerance=0.03 / radius))
    assert lost_parts(start, kept, 0.03) <= 0.01
    assert len(kept[1]) <= CleanSettings().max_faces
    assert inspect(*kept).closed


@pytest.mark.thorough
def test_a_plain_object_keeps_to_its_budget():
    assert len(clean_mesh(*ball(), CleanSettings(faces=600, tolerance=0.05))[1]) <= 600
    held = clean_mesh(*rods(), CleanSettings(faces=200, components=0, tolerance=1e-6, max_faces=500))
    assert len(held[1]) <= 500


def test_lost_parts_is_the_share_of_area_that_is_far():
    whole = join(ball(0.4, (-0.5, 0, 0)), ball(0.4, (0.5, 0, 0)))
    assert lost_parts(whole, ball(0.4, (-0.5, 0, 0)), 1e-3) == pytest.approx(0.5, abs=0.01)
    assert lost_parts(whole, whole, 1e-6) == 0
    assert lost_parts(whole, ball(0.4, (-0.5, 0, 0)), 5.0) == 0


def test_smoothing_leaves_no_face_without_area(monkeypatch):
    vertices, faces = ball(resolution=16)
    least = np.quantile(face_areas(taubin(vertices, faces, 10), faces), 0.05)
    monkeypatch.setattr(clean, "flat_area", lambda _: least)
    smooth = taubin(vertices, faces, 10)
    small = face_areas(smooth, faces) <= least
    assert np.array_equal(smooth[faces[small]], vertices[faces[small]])  # as far back as they can go
    assert not np.array_equal(smooth, vertices)


def test_pillows_are_taken_out_and_other_faces_stay():
    faces = np.array([[0, 1, 2], [3, 1, 2], [2, 1, 0], [4, 5, 6], [5, 6, 4]], np.int32)
    assert without_pillows(faces).tolist() == [[3, 1, 2], [4, 5, 6], [5, 6, 4]]
    for order in itertools.permutations(range(3)):
        way = np.linalg.det(np.eye(3)[list(order)])
        kept = without_pillows(np.array([[0, 1, 2], order], np.int32))
        assert len(kept) == (2 if way > 0 else 0)
    assert len(without_pillows(np.zeros((0, 3), np.int32))) == 0
    faces = ball()[1]
    assert np.array_equal(without_pillows(faces), faces)


@pytest.mark.thorough
def test_a_budget_that_cannot_hold_the_surface_is_passed_over(monkeypatch):
    asked = []
    real = clean._cleaned

    def cleaned(vertices, faces, settings, where, *passes):
        asked.append(settings.faces)
        if settings.faces < 1600:
            raise GeometryError("the mesh is not sound")
        return real(vertices, faces, settings, where, *passes)

    monkeypatch.setattr(clean, "_cleaned", cleaned)
    settings = CleanSettings(faces=400, tolerance=0.05, max_faces=3000)
    assert len(clean_mesh(*ball(resolution=40), settings)[1]) <= 1600
    assert asked[-3:] == [400, 800, 1600]
