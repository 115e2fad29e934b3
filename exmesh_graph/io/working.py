"""Pictures as people take them, made alike: upright, of one format, at the working size, their masks with them.

What is right as it lies is linked and not copied. A picture that is turned, reduced, or of a format that not everything
here reads becomes a PNG beside the links, and so does its mask.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.cameras import reduced_size
from exmesh_graph.io.formats import PLAIN, Header, read_codes, read_header, turned
from exmesh_graph.io.images import picture_size, read_raw, write_codes
from exmesh_graph.io.one_size import common_shape
from exmesh_graph.io.reduce import area_means, reduced_codes
from exmesh_graph.resources import usable_cores

_BYTES = 100
"""Of a picture that is being reduced, for each of its pixels: codes, linear light in float32, a mask."""
_AT_ONCE = 4 << 30


@dataclass(frozen=True)
class Working:
    """A picture as everything behind it takes it.

    name     of the file as it was given
    image    file with upright pixels at the working size, or lying ones (`quarter`); its name has no spaces, which
             part the names in COLMAP's lists of pairs
    mask     likewise, of the same size; or None
    size     (width, height) of both
    scale    working pixels for one pixel of the file
    quarter  quarter turns to the left by which it lies on its side, so that portrait and landscape are of one size
    lens     what pictures through one lens have in common
    focal    focal length by the file's own word, in working pixels; 0: unknown
    """

    name: str
    image: Path
    mask: Path | None
    size: tuple[int, int]
    scale: float
    quarter: int
    lens: tuple[object, ...]
    focal: float


def prepare(listed: Sequence[tuple[Path, Path | None]], folder: Path, megapixels: float) -> list[Working]:
    """The pictures (file, mask or None) made alike in `folder`, which is new, in the order given.

    megapixels  larger ones are reduced to this, by the mean over areas in linear light; 0: none is

    The size that most have, portrait or landscape alike, is the set's: the fewer of the two lie on their side. Pictures
    of other sizes are reduced until they just hold it, and not enlarged. Raises DataError for what cannot be decoded
    and for masks that do not fit, MissingLibraryError.
    """
    folder.mkdir()
    headers = [read_header(picture) for picture, _ in listed]
    plans = _plans(headers, megapixels)
    most = max(header.size[0] * header.size[1] for header in headers) * _BYTES
    with ThreadPoolExecutor(max(1, min(usable_cores(), _AT_ONCE // most))) as pool:
        return list(pool.map(_made, listed, headers, plans, [folder] * len(listed)))


def common_size(working: Sequence[Working]) -> tuple[int, int]:
    """(width, height) that most have, the larger of equally many."""
    counts = Counter(one.size for one in working)
    return max(counts, key=lambda size: (counts[size], size[0] * size[1], size))


def upright(pose: np.ndarray, quarter: int) -> np.ndarray:
    """Camera-to-world [4, 4] of the picture when it does not lie on its side."""
    turn = np.eye(4)
    if quarter:  # the upright picture's right is the lying one's up, its down the lying one's right
        turn[:2, :2] = [[0, quarter], [-quarter, 0]]
    return pose @ turn


@dataclass(frozen=True)
class _Plan:
    factor: float
    quarter: int


def _plans(headers: Sequence[Header], megapixels: float) -> list[_Plan]:
    sizes = [header.size[::-1] if header.orientation >= 5 else header.size for header in headers]
    factors = [max(1.0, float(np.sqrt(w * h / (megapixels * 1e6)))) if megapixels > 0 else 1.0 for w, h in sizes]
    reached = [reduced_size(size, factor) for size, factor in zip(sizes, factors, strict=True)]
    target = common_shape(reached)
    plans = []
    for header, size, factor in zip(headers, sizes, factors, strict=True):
        across = target[0] != target[1] and size[0] != size[1] and (size[0] > size[1]) != (target[0] > target[1])
        quarter = (-1 if header.orientation in (5, 8) else 1) if across else 0
        if reduced_size(size, factor) not in (target, target[::-1]):
            held = size[::-1] if across else size
            factor = max(1.0, min(held[0] / target[0], held[1] / target[1]))
        plans.append(_Plan(factor, quarter))
    return plans


def _made(pair: tuple[Path, Path | None], header: Header, plan: _Plan, folder: Path) -> Working:
    picture, mask = pair
    plain = picture.suffix.lower() in PLAIN
    stays = plan.factor == 1 and _same(header.orientation, plan.quarter)
    if plain and stays and picture_size(picture) == header.size:
        image = folder / quote(picture.name)
        image.symlink_to(picture.resolve())
    else:
        codes = read_codes(picture)
        if (codes.shape[1], codes.shape[0]) != header.size or codes.dtype.kind != "u":
            raise DataError(
                f"the picture is {codes.dtype} {codes.shape[1]} x {codes.shape[0]}, its header says {header.size[0]} x "
                f"{header.size[1]}", where=str(picture), expected="8 or 16 bits, and a header that holds",
                fix="export it as JPEG, PNG or TIFF",
            )  # fmt: skip
        codes = np.rot90(turned(codes, header.orientation), plan.quarter)
        if plan.factor > 1:
            codes = reduced_codes(codes, plan.factor)
        image = folder / f"{quote(picture.name)}.png"
        write_codes(image, np.ascontiguousarray(codes))
    size = header.size if stays else picture_size(image)
    return Working(
        name=picture.name, image=image, mask=None if mask is None else _mask(mask, picture, header, plan, folder),
        size=size, scale=1 / plan.factor, quarter=plan.quarter,
        lens=(*header.lens, *sorted(header.size), size), focal=header.focal / plan.factor,
    )  # fmt: skip


def _same(orientation: int, quarter: int) -> bool:
    """Whether turning upright and then laying on its side gives the stored pixels."""
    probe = np.arange(6).reshape(2, 3, 1)
    return np.array_equal(np.rot90(turned(probe, orientation), quarter), probe)


def _mask(mask: Path, picture: Path, header: Header, plan: _Plan, folder: Path) -> Path:
    """The mask made alike: of the picture as one sees it or, where only that fits, of the pixels as they are stored."""
    own = read_header(mask)
    if own.orientation == 1 and plan == _Plan(1.0, 0) and header.orientation == 1:
        return mask  # of another size: whoever reads the two says so
    codes = turned(read_raw(mask), own.orientation)
    stored = header.size
    seen = stored[::-1] if header.orientation >= 5 else stored
    size = codes.shape[1], codes.shape[0]
    if size == stored != seen:
        codes = turned(codes, header.orientation)
    elif size != seen:
        raise DataError(
            f"the mask is {size[0]} x {size[1]}, its image {seen[0]} x {seen[1]}", where=str(mask),
            fix=f"make the mask from {picture.name} at its full size",
        )  # fmt: skip
    values = codes[..., 0]
    if values.dtype.kind == "u":
        values = values / np.float32(np.iinfo(values.dtype).max)
    values = np.rot90(np.clip(values, 0, 1).astype(np.float32), plan.quarter)
    if plan.factor > 1:
        values = area_means(values, plan.factor)
    made = folder / f"{picture.name}.mask.png"
    write_codes(made, np.round(values.astype(np.float64) * 65535).astype(np.uint16)[..., None])
    return made
