"""Reading and writing pictures with OpenImageIO: arrays are always (H, W, C), alpha always straight as stored.

Three of OpenImageIO's habits are guarded against here: it multiplies a PNG's colour by alpha unless told
`oiio:UnassociatedAlpha`, it takes a 2-D array for a transposed picture, and it stamps the time into EXR headers.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import OpenImageIO as oiio

from exmesh_graph.errors import DataError
from exmesh_graph.io.color import linear_to_srgb, srgb_to_linear

Depth = Literal["uint8", "uint16", "half", "float"]
FLOAT_SUFFIXES = (".exr", ".hdr", ".pfm")


@dataclass(frozen=True)
class Photo:
    """A picture as the project uses it.

    rgb        float32 [H, W, 3], linear light, premultiplied by alpha
    alpha      float32 [H, W], coverage; ones where the file has none
    has_alpha  whether the file carried an alpha channel
    clipped    whether the file cannot hold values above 1
    codes      uint8 or uint16 [H, W, 3 or 4], what an integer file holds: sRGB, and straight alpha; None for others
    """

    rgb: np.ndarray
    alpha: np.ndarray
    has_alpha: bool
    clipped: bool
    codes: np.ndarray | None = None

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self.alpha.shape[1], self.alpha.shape[0]

    def digest(self) -> str:
        """Hash of the decoded pixels, so that one picture under two names is recognised."""
        value = hashlib.sha256(repr(self.size).encode())
        for part in (self.rgb, self.alpha):
            value.update(np.ascontiguousarray(part).data)
        return value.hexdigest()


def read_raw(path: Path) -> np.ndarray:
    """Read (H, W, C) in the file's own type: uint8, uint16, float16 or float32. Alpha is left straight.

    Raises DataError for a file that is missing, cannot be decoded, or is cut short.
    """
    path = Path(path)
    if not path.is_file():
        raise DataError(
            "the image does not exist",
            where=str(path),
            fix="check the folder and the spelling (upper and lower case count), or correct the scene file",
        )
    config = oiio.ImageSpec()
    config["oiio:UnassociatedAlpha"] = 1
    source = oiio.ImageInput.open(str(path), config)
    if source is None:
        raise _undecodable(path, oiio.geterror())
    try:
        spec = source.spec()
        kind = spec.format.basetype
        if kind not in (oiio.UINT8, oiio.UINT16, oiio.HALF, oiio.FLOAT):
            kind = oiio.FLOAT
        pixels = source.read_image(0, 0, 0, spec.nchannels, kind)
        if pixels is None:
            raise _undecodable(path, source.geterror())
    finally:
        source.close()
    return np.asarray(pixels).reshape(spec.height, spec.width, spec.nchannels)


def picture_size(path: Path) -> tuple[int, int]:
    """(width, height) from the file's header; DataError where it cannot be decoded."""
    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise _undecodable(path, oiio.geterror())
    spec = source.spec()
    source.close()
    return spec.width, spec.height


def _undecodable(path: Path, reason: str) -> DataError:
    first = reason.strip().splitlines()[0] if reason.strip() else "no reason given"
    return DataError(
        f"the image cannot be decoded ({first})",
        where=str(path),
        expected="a whole PNG, JPEG, TIFF or EXR file",
        fix="copy or export the file again; it is cut short, damaged, or not an image",
    )


def read_image(path: Path) -> np.ndarray:
    """Read float32 (H, W, C) as stored: integers scaled to [0, 1], no colour conversion, straight alpha."""
    return _scaled(read_raw(path))


def read_photo(path: Path, *, premultiplied: bool | None = None) -> Photo:
    """Read a picture into linear, premultiplied float32.

    Integer files hold sRGB with straight alpha; float files (EXR) hold linear light, premultiplied.
    `premultiplied` overrides the latter for float files that break the EXR rule.
    Raises DataError for undecodable files, for channels other than gray or RGB and alpha (beside gray in files of
    integers only), and for values that are not finite.
    """
    path = Path(path)
    pixels = read_raw(path)
    channels = pixels.shape[2]
    is_float = path.suffix.lower() in FLOAT_SUFFIXES
    if channels not in ((1, 3, 4) if is_float else (1, 2, 3, 4)):
        raise DataError(
            f"the image has {channels} channels", where=str(path),
            expected="1 (gray), 3 (RGB) or 4 (RGBA)" + ("" if is_float else ", or 2 (gray and alpha)"),
            fix="export it as plain RGB or RGBA (an EXR with one layer)",
        )  # fmt: skip
    if channels < 3:
        pixels, channels = pixels[..., [0, 0, 0, 1][: channels + 2]], channels + 2
    rgb = _scaled(pixels[..., :3]) if is_float else _linear(pixels[..., :3])
    alpha = np.clip(_scaled(pixels[..., 3]), 0, 1) if channels == 4 else np.ones(pixels.shape[:2], np.float32)
    if pixels.dtype.kind == "f":
        check_finite(pixels, path)
    if channels == 4 and (not is_float or premultiplied is False):
        rgb = rgb * alpha[..., None]
    codes = pixels if pixels.dtype.kind == "u" and not is_float else None
    return Photo(np.ascontiguousarray(rgb), np.ascontiguousarray(alpha), channels == 4, not is_float, codes)


def _scaled(codes: np.ndarray) -> np.ndarray:
    """float32; integers scaled to [0, 1]."""
    values = codes.astype(np.float32)
    return values / np.float32(np.iinfo(codes.dtype).max) if codes.dtype.kind == "u" else values


def _linear(codes: np.ndarray) -> np.ndarray:
    """Linear light of sRGB codes: integers by a table, since a power for each pixel is most of what reading costs."""
    return np.take(linear_of_codes(codes.dtype), codes) if codes.dtype.kind == "u" else srgb_to_linear(_scaled(codes))


@cache
def linear_of_codes(dtype: np.dtype) -> np.ndarray:
    """float32 [256] or [65536]: linear light of each sRGB code of an integer type."""
    return srgb_to_linear(_scaled(np.arange(np.iinfo(dtype).max + 1, dtype=dtype)))


def read_mask(path: Path) -> np.ndarray:
    """Read coverage float32 (H, W) in [0, 1] from the first channel of a mask picture (8 or 16 bit, linear)."""
    pixels = read_raw(path)
    if pixels.dtype.kind == "f":
        check_finite(pixels, Path(path))
    return np.ascontiguousarray(np.clip(_scaled(pixels[..., 0]), 0, 1))


def check_finite(pixels: np.ndarray, path: Path) -> None:
    """DataError naming file, count and first pixel (column, row) if any value is NaN or Inf."""
    bad = ~np.isfinite(pixels)
    if bad.any():
        row, column = np.argwhere(bad.reshape(*pixels.shape[:2], -1).any(axis=2))[0]
        count = int(bad.reshape(*pixels.shape[:2], -1).any(axis=2).sum())
        raise DataError(
            f"{count} pixels are NaN or Inf, the first at column {column}, row {row}",
            where=str(path),
            expected="finite values (0 marks a pixel without a measurement)",
            fix="write the file again; replace invalid pixels by 0",
        )


def write_image(path: Path, image: np.ndarray, depth: Depth = "uint8") -> None:
    """Write (H, W, C) or (H, W) as it is: no colour conversion, straight alpha; the same bytes for the same input.

    Integer depths clip to [0, 1] and round; `half` and `float` are for EXR. Raises DataError naming the file.
    """
    path = Path(path)
    pixels = np.asarray(image)
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    if pixels.ndim != 3:
        raise DataError(
            f"cannot write an array of shape {pixels.shape}", where=str(path), expected="(H, W) or (H, W, C)"
        )
    top = {"uint8": 255, "uint16": 65535}.get(depth)
    if top is not None:
        check_finite(pixels, path)
        pixels = np.round(np.clip(pixels.astype(np.float64), 0, 1) * top).astype(depth)
    else:
        pixels = pixels.astype(np.float32)
    _write(Path(path), pixels, depth, {})


def write_codes(path: Path, codes: np.ndarray, *, color_space: str = "") -> None:
    """Write uint8 or uint16 (H, W, C) as it is, and name its colour space if told to.

    PNG by one fixed row filter (average) and compression level 3: noisy maps come out as large as by libpng's search
    for the best filter of each row, in half the time.

    Raises DataError naming the file.
    """
    depth = str(codes.dtype)
    if codes.ndim != 3 or depth not in ("uint8", "uint16"):
        raise DataError(f"cannot write {depth} {codes.shape}", where=str(path), expected="uint8 or uint16 (H, W, C)")
    named = {"oiio:ColorSpace": color_space} if color_space else {}
    _write(path, codes, depth, {"png:compressionLevel": 3, "png:filter": 64, **named})


def _write(path: Path, pixels: np.ndarray, depth: str, attributes: dict[str, Any]) -> None:
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], depth)
    spec.attribute("oiio:UnassociatedAlpha", 1)
    for name, value in attributes.items():
        spec.attribute(name, value)
    if path.suffix.lower() == ".exr":
        spec.attribute("DateTime", "2000:01:01 00:00:00")  # the true time would make equal pictures differ
    target = oiio.ImageOutput.create(str(path))
    if target is None or not target.open(str(path), spec):
        reason = oiio.geterror() if target is None else target.geterror()
        raise DataError(
            f"the image cannot be written ({reason})", where=str(path),
            fix="check that the folder exists and is writable, and that the ending is .png, .jpg, .tif or .exr",
        )  # fmt: skip
    done = target.write_image(np.ascontiguousarray(pixels))
    reason = target.geterror()
    target.close()
    if not done:
        raise DataError(f"the image cannot be written ({reason})", where=str(path), fix="free some disk space")


def display(rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Display colour "over black": sRGB(clip(rgb / alpha, 0, 1)) * alpha, (..., 3) from linear premultiplied."""
    straight = unpremultiply(rgb, alpha)
    return linear_to_srgb(np.clip(straight, 0, 1)) * alpha[..., None]


def unpremultiply(rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """rgb / alpha, 0 where alpha is 0."""
    return np.where(alpha[..., None] > 0, rgb / np.maximum(alpha, 1e-6)[..., None], 0).astype(rgb.dtype)


def encode_rgba(rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Linear premultiplied to straight sRGB RGBA (H, W, 4), what `write_image` puts into a PNG."""
    straight = linear_to_srgb(np.clip(unpremultiply(rgb, alpha), 0, 1))
    return np.concatenate([straight, alpha[..., None]], axis=-1)
