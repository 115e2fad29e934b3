"""Cameras in the XML of Metashape and of RealityScan, as `io.exports` finds them.

Metashape writes one file of sensors and cameras. RealityScan writes an `.xmp` beside each picture (XMP camera math, in
its help pages): with R = `Rotation` row by row, C = `Position`, OpenCV's axes and s the longer side in pixels,

    x_camera = R (X - C),   f = s FocalLength35mm / 36,   c = (w, h) / 2 + s PrincipalPoint

and lenses k1 k2 k3 k4 t1 t2, of which t2 goes with r^2 + 2 x^2 (`io.lens`: p1 = t1, p2 = t2).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.formats import PICTURES, read_header
from exmesh_graph.io.lens import AnyLens, Lens

_XCR = "http://www.capturingreality.com/ns/xcr/"
#: RealityScan's lenses that are polynomials of Brown's; the rest ("division", fisheyes) is not.
_BROWN = ("perspective", "brown3", "brown4", "brown3t2", "brown4t2")


class Found(NamedTuple):
    """Cameras by picture name as the program writes it, OpenCV axes, in the files' pixels; points as in Motion."""

    poses: Mapping[str, np.ndarray]
    lenses: Mapping[str, AnyLens]
    points: np.ndarray
    colours: np.ndarray
    tracks: np.ndarray
    error: float = 0.0


def no_points() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, colours and tracks of a program that writes none."""
    return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, np.int64)


def read_metashape(file: Path) -> Found:
    """Metashape's XML: sensors with a calibration, cameras with a transform into the chunk."""
    root = _parsed(file)
    sensors: dict[str, Lens] = {}
    for sensor in root.iter("sensor"):
        found = sensor.find("calibration[@class='adjusted']")
        calibration = found if found is not None else sensor.find("calibration")
        if calibration is not None:
            sensors[sensor.get("id", "")] = _metashape_lens(calibration, sensor, file)
    poses, lenses = {}, {}
    for camera in root.iter("camera"):
        transform, label = camera.find("transform"), camera.get("label", "")
        if transform is None or camera.get("sensor_id") not in sensors:
            continue  # not aligned
        numbers = np.array((transform.text or "").split(), np.float64)
        if numbers.size != 16:
            raise DataError(f"the transform of {label} has {numbers.size} numbers", where=str(file), expected="16")
        pose = numbers.reshape(4, 4)
        pose[:3, :3] /= np.cbrt(np.linalg.det(pose[:3, :3]))
        poses[label], lenses[label] = pose, sensors[camera.get("sensor_id", "")]
    return Found(poses, lenses, *no_points())


def _metashape_lens(calibration: ElementTree.Element, sensor: ElementTree.Element, file: Path) -> Lens:
    """u = w / 2 + cx + x' f + x' B1 + y' B2, v = h / 2 + cy + y' f; P1 goes with r^2 + 2 x^2 (Metashape's manual)."""
    kind = calibration.get("type", "frame")
    if kind not in ("frame", "fisheye"):
        raise DataError(f"a sensor is {kind}", where=str(file), expected="frame or fisheye cameras")
    resolution = calibration.find("resolution")
    resolution = resolution if resolution is not None else sensor.find("resolution")
    if resolution is None or calibration.find("f") is None:
        raise DataError("a sensor has no resolution or focal length", where=str(file), fix="export the cameras again")

    def number(name: str) -> float:
        return float(calibration.findtext(name) or 0)

    wide, high = (int(resolution.get(name, 0)) for name in ("width", "height"))
    f, radial = number("f"), tuple(number(f"k{n}") for n in (1, 2, 3, 4))
    return Lens(
        wide, high, (f + number("b1"), f), (wide / 2 + number("cx"), high / 2 + number("cy")), radial,
        (number("p2"), number("p1")), number("b2"), fisheye=kind == "fisheye",
    )  # fmt: skip


def sidecars(folder: Path) -> list[Path]:
    """RealityScan's files in it that say where a camera stood; other programs call theirs the same."""
    return [file for file in sorted(folder.glob("*.xmp")) if _is_pose(file.read_bytes())]


def _is_pose(content: bytes) -> bool:
    return _XCR.encode() in content and b"Rotation" in content and b"Position" in content


def read_sidecars(folder: Path) -> Found:
    """RealityScan's `.xmp` files of the pictures beside them. Their pixels are those that are stored."""
    pictures = {file.stem: file for file in sorted(folder.iterdir()) if file.suffix.lower() in PICTURES}
    poses, lenses = {}, {}
    known: dict[Lens, Lens] = {}
    for file in sidecars(folder):
        picture = pictures.get(file.stem)
        if picture is None:
            continue
        said = _said(file)
        pose = np.eye(4)
        pose[:3, :3] = _numbers(said, "Rotation", 9, file).reshape(3, 3).T
        pose[:3, 3] = _numbers(said, "Position", 3, file)
        lens = _realityscan_lens(said, read_header(picture).size, file)
        poses[picture.name], lenses[picture.name] = pose, known.setdefault(lens, lens)
    return Found(poses, lenses, *no_points())


def _said(file: Path) -> dict[str, str]:
    """What RealityScan's names stand for: attributes or elements."""
    said: dict[str, str] = {}
    for element in _parsed(file).iter():
        for name, value in [*element.attrib.items(), (element.tag, element.text or "")]:
            if str(name).startswith(f"{{{_XCR}"):
                said[str(name).rpartition("}")[2]] = value
    return said


def _realityscan_lens(said: Mapping[str, str], size: tuple[int, int], file: Path) -> Lens:
    model = said.get("DistortionModel", "perspective").lower()
    if model not in _BROWN:
        raise DataError(
            f"the lens is {model!r}", where=str(file), expected=f"one of {', '.join(_BROWN)}",
            fix='set the distortion model to "Brown3" in RealityScan\'s alignment settings, align and export again, or '
            "export COLMAP's files",
        )  # fmt: skip
    longer = max(size)
    bends = _numbers(said, "DistortionCoeficients", 6, file) if model != "perspective" else np.zeros(6)

    def number(name: str) -> float:
        return float(_numbers({**usual, **said}, name, 1, file)[0])

    usual = {"AspectRatio": "1", "Skew": "0", "PrincipalPointU": "0", "PrincipalPointV": "0"}
    f, (wide, high) = number("FocalLength35mm") * longer / 36, size
    centre = wide / 2 + number("PrincipalPointU") * longer, high / 2 + number("PrincipalPointV") * longer
    k1, k2, k3, k4, t1, t2 = map(float, bends)
    return Lens(
        wide, high, (f, f * number("AspectRatio")), centre, (k1, k2, k3, k4), (t1, t2), number("Skew") * longer
    )  # fmt: skip


def _numbers(said: Mapping[str, str], name: str, count: int, file: Path) -> np.ndarray:
    words = said.get(name, "").split()
    try:
        numbers = np.array(words, np.float64)
    except ValueError:
        numbers = np.zeros(0)
    if numbers.size != count:
        raise DataError(
            f"xcr:{name} is {' '.join(words)!r}", where=str(file), expected=f"{count} number{'s' * (count > 1)}",
            fix="export the cameras again, with poses and calibration",
        )  # fmt: skip
    return numbers


def _parsed(file: Path) -> ElementTree.Element:
    try:
        return ElementTree.parse(file).getroot()
    except ElementTree.ParseError as error:
        raise DataError(f"not valid XML ({error})", where=str(file)) from error
