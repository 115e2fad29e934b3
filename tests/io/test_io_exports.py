"""Cameras of other programs: COLMAP's, nerfstudio's, Metashape's and RealityScan's files beside the pictures, lenses
and turns with them."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from exmesh_graph.errors import DataError
from exmesh_graph.io import photos
from exmesh_graph.io.exports import find_export, read_export
from exmesh_graph.io.lens import Lens, LensChange, turn
from exmesh_graph.io.motion import DOUBTFUL
from exmesh_graph.io.photos import photo_files, place_photos
from exmesh_graph.io.placed import Adjustment
from exmesh_graph.io.settings import PhotosOptions
from tests.io.io_scenes import CENTRE, RADIUS, blender_from_opencv, encode_rgba, of_placed, ring
from tests.io.test_io_one_size import photographed

LENS = Lens(90, 70, (100.0, 100.0), (44.0, 36.5), (-0.16, 0.05), (0.004, -0.003))
OPTIONS = PhotosOptions(blurred=0, alike=0, holdout=5, first=2, checks="off", megapixels=0)
#: Pictures that are stored lying, by how they are to be turned.
TURNED = {2: 6, 5: 8, 7: 3}


def scene(folder):
    """{name: camera of the stored picture} of twelve pictures, some of them turned by their Exif data."""
    (folder / "images").mkdir(parents=True)
    poses = {}
    for number, pose in enumerate(ring(12)):
        quarter = {6: 1, 8: -1, 3: 2}.get(TURNED.get(number, 1), 0)  # what makes the stored picture of the upright one
        stored = pose @ turn(quarter)
        rgb, alpha = photographed(stored, LENS)
        exif = Image.Exif()
        exif[0x0112] = TURNED.get(number, 1)
        codes = np.round(255 * encode_rgba(rgb, alpha)).astype(np.uint8)
        Image.fromarray(codes).save(folder / f"images/IMG_{number}.png", exif=exif.tobytes())
        poses[f"IMG_{number}.png"] = stored
    return poses


def colmap(folder, poses, points=True):
    place = folder / "sparse/0"
    place.mkdir(parents=True)
    f, (cx, cy), (k1, k2), (p1, p2) = LENS.focal[0], LENS.centre, LENS.radial, LENS.tangential
    place.joinpath("cameras.txt").write_text(f"1 OPENCV 90 70 {f} {f} {cx} {cy} {k1} {k2} {p1} {p2}\n")
    lines, seen = [], [[] for _ in range(20)]
    places = CENTRE + RADIUS * np.random.default_rng(0).normal(size=(20, 3))
    for number, (name, pose) in enumerate(poses.items(), start=1):
        to_camera = np.linalg.inv(pose)
        x, y, z, w = Rotation.from_matrix(to_camera[:3, :3]).as_quat()
        pixels = LENS.img_from_cam(places @ to_camera[:3, :3].T + to_camera[:3, 3])
        lines.append(f"{number} {w} {x} {y} {z} {' '.join(map(repr, map(float, to_camera[:3, 3])))} 1 sub/{name}")
        lines.append(" ".join(f"{u} {v} {k + 1}" for k, (u, v) in enumerate(pixels)) if points else "")
        for k in range(20):
            seen[k] += [number, k]
    place.joinpath("images.txt").write_text("\n".join(lines) + "\n")
    rows = [f"{k + 1} {' '.join(map(repr, map(float, p)))} 255 0 0 0.5 {' '.join(map(str, seen[k]))}\n"
            for k, p in enumerate(places)]  # fmt: skip
    place.joinpath("points3D.txt").write_text("".join(rows) if points else "")
    return places


def nerfstudio(folder, poses):
    (k1, k2), (p1, p2) = LENS.radial, LENS.tangential
    frames = [{"file_path": f"./images/{name}", "transform_matrix": blender_from_opencv(pose)[:3].tolist()}
              for name, pose in poses.items()]  # fmt: skip
    content = {
        "camera_model": "OPENCV", "fl_x": 100.0, "fl_y": 100.0, "cx": 44.0, "cy": 36.5, "w": 90, "h": 70,
        "k1": k1, "k2": k2, "p1": p1, "p2": p2, "frames": frames, "ply_file_path": "points.ply",
    }  # fmt: skip
    (folder / "transforms.json").write_text(json.dumps(content))


def metashape(folder, poses, kind="frame", more=""):
    (k1, k2), (p1, p2) = LENS.radial, LENS.tangential
    cameras = "".join(
        f'<camera id="{k}" sensor_id="3" label="{name.removesuffix(".png")}"><transform>'
        f"{' '.join(map(repr, map(float, pose.ravel())))}</transform></camera>"
        for k, (name, pose) in enumerate(poses.items())
    )
    (folder / "cameras.xml").write_text(
        f'<?xml version="1.0" encoding="UTF-8"?><document version="2.0.0"><chunk><sensors><sensor id="3" type="{kind}">'
        f'<resolution width="90" height="70"/><calibration type="{kind}" class="initial"><f>1</f></calibration>'
        f'<calibration type="{kind}" class="adjusted"><resolution width="90" height="70"/><f>100</f><cx>-1</cx>'
        f"<cy>1.5</cy><k1>{k1}</k1><k2>{k2}</k2><p1>{p2}</p1><p2>{p1}</p2></calibration></sensor></sensors>"
        f'<cameras>{cameras}{more}<camera id="99" sensor_id="3" label="IMG_99"/></cameras></chunk></document>'
    )


def realityscan(folder, poses, **said):
    """Focal length of a film of 36 mm, the middle beside the picture's in its longer side, t1 and t2 last."""
    (k1, k2), (p1, p2) = LENS.radial, LENS.tangential
    for name, pose in poses.items():
        to_camera = np.linalg.inv(pose)
        values = {
            "DistortionModel": "brown3t2", "FocalLength35mm": 40, "Skew": 0, "AspectRatio": 1,
            "PrincipalPointU": -1 / 90, "PrincipalPointV": 1.5 / 90,
            "DistortionCoeficients": f"{k1} {k2} 0 0 {p1} {p2}",
        } | said  # fmt: skip
        rotation, place = (" ".join(map(repr, map(float, v.ravel()))) for v in (to_camera[:3, :3], pose[:3, 3]))
        (folder / "images" / name).with_suffix(".xmp").write_text(
            '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
            '<rdf:Description xmlns:xcr="http://www.capturingreality.com/ns/xcr/1.1#" '
            + " ".join(f'xcr:{name}="{value}"' for name, value in values.items())
            + f"><xcr:Rotation>{rotation}</xcr:Rotation><xcr:Position>{place}</xcr:Position></rdf:Description>"
            "</rdf:RDF></x:xmpmeta>"
        )


WRITERS = {"COLMAP": colmap, "nerfstudio": nerfstudio, "Metashape": metashape, "RealityScan": realityscan}


def loaded(folder, work, options=OPTIONS):
    (work).mkdir()
    return of_placed(place_photos(folder, options, work))


@pytest.mark.parametrize("program", WRITERS)
def test_views_are_what_the_program_s_cameras_see(tmp_path, monkeypatch, program):
    """Exact places; the ball is where its middle is projected, in pictures that were turned too."""
    if program == "COLMAP":
        pytest.importorskip("pycolmap", reason="pip install 'exmesh-graph[photos]'")
    monkeypatch.setattr(photos, "find_motion", None)  # nothing is looked for
    poses = scene(tmp_path / "a")
    WRITERS[program](tmp_path / "a", {name: pose for name, pose in poses.items() if name != "IMG_4.png"})
    found, cloud, motion = loaded(tmp_path / "a", tmp_path / "w")
    assert motion.left_out == ("IMG_4.png",)
    assert motion.told == f"{program}'s own"
    assert motion.figures()["registered"] == 11
    assert len(cloud) == (20 if program == "COLMAP" else 0)
    assert any("without points" in note for note in found.notes) == (program != "COLMAP")
    ours, theirs = [], []
    for views in (found.train, found.test):
        for number, name in enumerate(views.names):
            ours.append(views.camera_to_world[number][:3, 3])
            theirs.append(poses[f"{name}.png"][:3, 3])
            middle = views.world_to_camera[number] @ [0, 0, 0, 1]  # the ball's, by the masks
            pixel = (views.intrinsics[number] @ middle[:3])[:2] / middle[2]
            row, column = np.nonzero(np.asarray(views.alpha[number]) > 0.5)
            assert np.abs(pixel - [column.mean() + 0.5, row.mean() + 0.5]).max() < 1.5
    assert len(ours) == 11
    spread = [np.linalg.norm(np.asarray(p) - np.mean(p, 0), axis=1) for p in (ours, theirs)]
    np.testing.assert_allclose(spread[0] / spread[0].mean(), spread[1] / spread[1].mean(), rtol=1e-6)


def test_views_through_lenses_that_turn_out_to_be_others_are_those_of_the_others(tmp_path):
    """Pictures that were turned too, in the world that is given."""
    poses = scene(tmp_path / "a")
    nerfstudio(tmp_path / "a", poses)
    (tmp_path / "w").mkdir()
    placed = place_photos(tmp_path / "a", OPTIONS, tmp_path / "w")
    assert placed.alpha

    def of(*lens):
        lenses = [replace(one, lens=Lens(90, 70, *lens)) for one in placed.motion.lenses]
        return replace(placed, motion=replace(placed.motion, lenses=lenses))

    true = of((100.0, 100.0), (44.0, 36.5), (-0.16,)).scene()
    shift = np.zeros((4, 4))
    shift[:3, 3] = [0.02, -0.01, 0.03]
    cameras = {name: pose + shift for part in (true.train, true.test)
               for name, pose in zip(part.names, part.camera_to_world, strict=True)}  # fmt: skip
    after = Adjustment(true.frame, cameras, LensChange(np.log(100 / 97), -0.16))
    found = of((97.0, 97.0), (44.0, 36.5)).scene(after=after)
    for ours, theirs in ((found.train, true.train), (found.test, true.test)):
        np.testing.assert_allclose(ours.images, theirs.images, atol=1e-4)
        np.testing.assert_allclose(ours.intrinsics, theirs.intrinsics, rtol=1e-9)
        np.testing.assert_allclose(ours.camera_to_world, theirs.camera_to_world + shift, atol=1e-12)


def test_points_of_colmap_lie_where_they_did(tmp_path):
    pytest.importorskip("pycolmap", reason="pip install 'exmesh-graph[photos]'")
    poses = scene(tmp_path / "a")
    places = colmap(tmp_path / "a", poses)
    found, cloud, _ = loaded(tmp_path / "a", tmp_path / "w")
    apart = [np.linalg.norm(p - p.mean(0), axis=1) for p in (places, cloud.points.astype(np.float64))]
    np.testing.assert_allclose(apart[0] / apart[0].mean(), apart[1] / apart[1].mean(), rtol=1e-4)
    view, number = found.train, 0
    pose = poses[f"{view.names[number]}.png"]
    seen = ((places, pose[:3, 3]), (cloud.points, view.camera_to_world[number][:3, 3]))
    distance = [np.linalg.norm(points - eye, axis=1) for points, eye in seen]
    np.testing.assert_allclose(distance[0] / apart[0].mean(), distance[1] / apart[1].mean(), rtol=1e-4)


@pytest.mark.parametrize("share", [0.2, 0.32, 0.34])
def test_cameras_that_few_matches_agree_with_are_called_likely_wrong(tmp_path, monkeypatch, share):
    realityscan(tmp_path / "a", scene(tmp_path / "a"))
    monkeypatch.setattr(photos, "read_export", lambda *given: replace(read_export(*given), agreeing=share))
    found, _, motion = loaded(tmp_path / "a", tmp_path / "w")
    said = [note for note in found.notes if f"only {share:.0%} of the matches" in note and "likely wrong" in note]
    assert len(said) == (share < DOUBTFUL)
    assert motion.figures()["agreeing"] == share


def test_which_cameras_are_taken(tmp_path, monkeypatch):
    poses = scene(tmp_path / "a")
    folder = tmp_path / "a"
    with pytest.raises(DataError, match=r"no cameras of another program"):
        loaded(folder, tmp_path / "none", OPTIONS.replaced(cameras="file"))
    (folder / "notes.xml").write_text("<notes/>")
    (folder / "images/IMG_0.xmp").write_text('<x:xmpmeta xmlns:x="adobe:ns:meta/"/>')  # of who develops raw pictures
    assert find_export(folder) is None
    realityscan(folder, poses)
    export = find_export(folder)
    assert (export.program, len(export.files())) == ("RealityScan", 12)
    assert "images/IMG_3.xmp" in photo_files(folder, OPTIONS)
    nerfstudio(folder, poses)
    assert find_export(folder).program == "nerfstudio"
    metashape(folder, poses)
    assert find_export(folder).program == "Metashape"
    colmap(folder, poses)
    export = find_export(folder)
    assert export.program == "COLMAP"
    assert {file.name for file in export.files()} == {"cameras.txt", "images.txt", "points3D.txt"}
    assert "sparse/0/images.txt" in photo_files(folder, OPTIONS)
    assert "sparse/0/images.txt" not in photo_files(folder, OPTIONS.replaced(cameras="find"))
    monkeypatch.setattr(photos, "find_motion", lambda *a, **k: (_ for _ in ()).throw(RuntimeError("looked for")))
    with pytest.raises(RuntimeError, match="looked for"):
        loaded(folder, tmp_path / "found", OPTIONS.replaced(cameras="find"))


def test_cameras_of_upright_pixels_are_taken_as_such(tmp_path):
    """A program that heeds Exif's orientation gives lenses of the turned picture."""
    poses = scene(tmp_path / "a")
    frames = []
    for number, (name, pose) in enumerate(poses.items()):
        quarter = {6: -1, 8: 1}.get(TURNED.get(number, 1), 0)
        size = (70, 90) if quarter else (90, 70)
        frames.append({"file_path": f"images/{name}", "fl_x": 100.0, "w": size[0], "h": size[1],
                       "transform_matrix": blender_from_opencv(pose @ turn(quarter)).tolist()})  # fmt: skip
    (tmp_path / "a/transforms.json").write_text(json.dumps({"frames": frames}))
    found, _, _ = loaded(tmp_path / "a", tmp_path / "w")
    for number, name in enumerate(found.train.names):
        middle = found.train.world_to_camera[number] @ [0, 0, 0, 1]  # the ball's, by the masks
        pixel = (found.train.intrinsics[number] @ middle[:3])[:2] / middle[2]
        row, column = np.nonzero(np.asarray(found.train.alpha[number]) > 0.5)
        assert np.abs(pixel - [column.mean() + 0.5, row.mean() + 0.5]).max() < 3, name  # the lens is left out


def test_exports_that_do_not_fit_say_so(tmp_path):
    poses = scene(tmp_path / "a")
    folder = tmp_path / "a"
    nerfstudio(folder, poses)
    content = json.loads((folder / "transforms.json").read_text())
    for change, what in (({"w": 180, "h": 140}, "90 x 70, its camera in nerfstudio's export 180 x 140"),
                         ({"camera_model": "EQUIRECTANGULAR"}, "camera_model")):  # fmt: skip
        (folder / "transforms.json").write_text(json.dumps({**content, **change}))
        with pytest.raises(DataError, match=what):
            loaded(folder, tmp_path / f"w{len(what)}")
    (folder / "transforms.json").write_text(json.dumps({**content, "frames": content["frames"][:2]}))
    with pytest.raises(DataError, match="of 2 pictures, of which 2 lie in the folder"):
        loaded(folder, tmp_path / "few")
    (folder / "cameras.xml").write_text("<document><chunk>")
    with pytest.raises(DataError, match="not valid XML"):
        loaded(folder, tmp_path / "xml")
    metashape(folder, poses, kind="spherical")
    with pytest.raises(DataError, match="a sensor is spherical"):
        loaded(folder, tmp_path / "round")
    metashape(folder, poses, more='<camera sensor_id="3" label="x"><transform>1 2</transform></camera>')
    with pytest.raises(DataError, match="the transform of x has 2 numbers"):
        loaded(folder, tmp_path / "short")
    metashape(folder, poses, more='<camera sensor_id="3" label="x"><transform>one two</transform></camera>')
    with pytest.raises(DataError, match=r"cannot be read \(ValueError: could not convert"):
        loaded(folder, tmp_path / "words")


def test_sidecars_that_do_not_fit_say_so(tmp_path):
    poses = scene(tmp_path / "a")
    for number, (said, what) in enumerate((
        ({"DistortionModel": "division"}, "the lens is 'division'"),
        ({"DistortionCoeficients": "0 0 0"}, "xcr:DistortionCoeficients is '0 0 0'"),
        ({"FocalLength35mm": ""}, "xcr:FocalLength35mm is ''"),
        ({"AspectRatio": "wide"}, "xcr:AspectRatio is 'wide'"),
    )):  # fmt: skip
        realityscan(tmp_path / "a", poses, **said)
        with pytest.raises(DataError, match=what):
            loaded(tmp_path / "a", tmp_path / f"w{number}")
    (tmp_path / "a/images/IMG_0.xmp").write_text("<x http://www.capturingreality.com/ns/xcr/ Rotation Position")
    with pytest.raises(DataError, match="not valid XML"):
        loaded(tmp_path / "a", tmp_path / "xml")


def test_a_lens_that_does_not_bend_needs_no_coefficients(tmp_path):
    poses = scene(tmp_path / "a")
    realityscan(tmp_path / "a", poses, DistortionModel="perspective", DistortionCoeficients="")
    _, _, motion = loaded(tmp_path / "a", tmp_path / "w")
    assert motion.lenses[0].lens.straight


def test_a_damaged_model_of_colmap_says_so(tmp_path):
    pytest.importorskip("pycolmap", reason="pip install 'exmesh-graph[photos]'")
    poses = scene(tmp_path / "a")
    colmap(tmp_path / "a", poses)
    (tmp_path / "a/sparse/0/cameras.txt").write_text("1 NO_SUCH_MODEL 90 70 1\n")
    with pytest.raises(DataError, match="COLMAP's model cannot be read"):
        loaded(tmp_path / "a", tmp_path / "w")
