"""The picture and video formats that `data.photos` takes, and what the header of a picture says.

What OpenImageIO reads (JPEG, PNG, TIFF), HEIC and HEIF through pillow-heif, cameras' raw files through rawpy (LibRaw).
The tags are Exif 3.0's: 0x0112 Orientation, 0xA405 FocalLengthIn35mmFilm, 0x920A FocalLength, 0x010F Make,
0x0110 Model, 0xA434 LensModel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, UnidentifiedImageError

from exmesh_graph.errors import DataError
from exmesh_graph.io.images import picture_size, read_raw
from exmesh_graph.native import import_av, import_pillow_heif, import_rawpy

OPAQUE = (".jpg", ".jpeg")  # no alpha in these: not worth reading
PLAIN = (*OPAQUE, ".png", ".tif", ".tiff")
HEIF = (".heic", ".heif", ".hif")
RAW = (".dng", ".nef", ".nrw", ".cr2", ".cr3", ".arw", ".raf", ".rw2", ".orf", ".pef", ".srw")
PICTURES = PLAIN + HEIF + RAW
VIDEOS = (".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi")

_DIAGONAL_35 = float(np.hypot(36, 24))


@dataclass(frozen=True)
class Header:
    """What stands in a picture's file beside its pixels.

    size         (width, height) of the pixels that `read_codes` gives
    orientation  how these are to be turned to be upright: 1 to 8 as in Exif
    focal        focal length in those pixels, 0 where the file does not say
    lens         make, model, lens and focal length as they stand there: equal for pictures through one lens
    """

    size: tuple[int, int]
    orientation: int = 1
    focal: float = 0.0
    lens: tuple[str, ...] = ()


def read_header(path: Path) -> Header:
    """Size, orientation and lens of a picture. DataError where it cannot be decoded, MissingLibraryError."""
    ending = path.suffix.lower()
    if ending in HEIF:
        picture = _heif(path)
        exif = Image.Exif()
        exif.load(picture.info.get("exif") or b"")
        # the format turns pictures itself, and its decoder has done so: the flag in the Exif data is a copy
        return _header(picture.size, exif, turned=True)
    if ending in RAW:
        with _raw(path) as raw:
            size = raw.sizes.width, raw.sizes.height
            size = size[::-1] if raw.sizes.flip in (5, 6) else size
            glass, other = getattr(raw, "lens", None), getattr(raw, "other", None)  # rawpy 0.26 and later
            lens = getattr(glass, "model", ""), getattr(other, "focal_length", "")
        header = _header(size, _exif(path), turned=True)
        return replace(header, lens=(*header.lens, *map(str, lens)))
    return _header(picture_size(path), _exif(path), turned=False)


def read_codes(path: Path) -> np.ndarray:
    """uint8 or uint16 [H, W, C] in sRGB with straight alpha, any of `PICTURES`; as stored, orientation not applied.

    Raw files are developed with the camera's white balance and no other change of brightness, into 16 bits, upright.
    """
    ending = path.suffix.lower()
    if ending in HEIF:
        try:
            return np.array(_heif(path))
        except (OSError, ValueError, EOFError) as error:
            raise _damaged(path, error) from error
    if ending in RAW:
        rawpy = import_rawpy(path)
        try:
            with _raw(path) as raw:
                return np.array(
                    raw.postprocess(
                        use_camera_wb=True, no_auto_bright=True, output_bps=16, gamma=(2.4, 12.92),
                        output_color=rawpy.ColorSpace.sRGB, adjust_maximum_thr=0.0,
                    )
                )  # fmt: skip
        except rawpy.LibRawError as error:
            raise _damaged(path, error) from error
    return read_raw(path)


def turned(codes: np.ndarray, orientation: int) -> np.ndarray:
    """[H, W, C] made upright: what Exif's orientation 1 to 8 asks for."""
    if orientation in (5, 6, 7, 8):
        codes = codes.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        codes = codes[::-1]
    return codes[:, ::-1] if orientation in (2, 3, 6, 7) else codes


def need_libraries(files: Sequence[Path]) -> dict[str, Path]:
    """{name: metadata} of the optional packages that decode `files`: sources of a node, so versions are in its key.

    MissingLibraryError, naming a file and the pip command, where a package is not there.
    """
    needed = {}
    for endings, package, need in (
        (HEIF, "pillow-heif", import_pillow_heif), (RAW, "rawpy", import_rawpy), (VIDEOS, "av", import_av),
    ):  # fmt: skip
        first = next((file for file in files if file.suffix.lower() in endings), None)
        if first is not None:
            need(first)
            listed = metadata.files(package) or ()  # not in the key: libraries=
            told = next(file for file in listed if file.name == "METADATA")
            needed[f"{package}/METADATA"] = Path(str(told.locate()))
    return needed


def _header(size: tuple[int, int], exif: Any, *, turned: bool) -> Header:
    inner = exif.get_ifd(0x8769) if exif is not None else {}
    outer = exif if exif is not None else {}
    orientation = 1 if turned else outer.get(0x0112, 1)
    focal = _number(inner.get(0xA405)) * float(np.hypot(*size)) / _DIAGONAL_35
    lens = tuple(str(value).strip("\0 ") for value in (
        outer.get(0x010F, ""), outer.get(0x0110, ""), inner.get(0xA434, ""), inner.get(0x920A, ""),
        inner.get(0xA405, ""),
    ))  # fmt: skip
    good = isinstance(orientation, int) and 1 <= orientation <= 8
    return Header(size, orientation if good else 1, focal, lens)


def _number(value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return 0.0
    return number if np.isfinite(number) and number > 0 else 0.0


def _exif(path: Path) -> Any:
    """Pillow reads no pixels for it. Raw files are TIFF inside, most of them; the others tell nothing here."""
    try:
        with Image.open(path) as picture:
            return picture.getexif()
    except (UnidentifiedImageError, OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return None


def _heif(path: Path) -> Any:
    heif = import_pillow_heif(path)
    try:
        return heif.open_heif(path, convert_hdr_to_8bit=False)
    except (OSError, ValueError, EOFError) as error:
        raise _damaged(path, error) from error


def _raw(path: Path) -> Any:
    rawpy = import_rawpy(path)
    try:
        return rawpy.imread(str(path))
    except rawpy.LibRawError as error:
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> DataError:
    text = str(error.args[0] if error.args else error)
    return DataError(
        f"the image cannot be decoded ({text})", where=str(path), expected="a whole HEIC, HEIF or raw file",
        fix="copy or export the file again (as JPEG, PNG or TIFF); it is cut short, damaged, or not an image",
    )  # fmt: skip
