"""Frames of a video as photographs: the sharpest of each of so many equal parts of the way that its pictures move.

Through PyAV (FFmpeg's libraries). The video is decoded twice, to look and to take; no frame is kept meanwhile.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.images import write_codes
from exmesh_graph.io.selection import displacement, grey_of, sharpness
from exmesh_graph.native import import_av

_SIDE, _THUMB = 640, 200  # pixels: the longer side in which sharpness and movement are measured, at most
_MARK = 0.01  # of the width: what moved less has not moved
_FEWEST = 3
_BRIGHT = {16: "PQ", 18: "HLG"}  # transfer characteristics of ITU-T H.273 that are not near sRGB's
_UNKNOWN, _HD, _BT709 = 2, 720, 1


def extract_frames(video: Path, count: int, folder: Path) -> tuple[list[Path], str]:
    """(at most `count` upright frames as 8-bit PNG in the order of time, a note on their colour or "").

    The way that pictures move is divided into `count` equal parts, and the sharpest frame of each is taken: a camera
    that stands still gives one frame, one that hurries as many as one that takes its time. Where nothing moves, time is
    divided instead.
    `folder` is new. Frames are called by their time, t0012_480 for 12.48 s. DataError where the file cannot be decoded,
    or has fewer than three frames; MissingLibraryError without PyAV.
    """
    av = import_av(video)
    folder.mkdir()
    try:
        seen, note = _looked_over(av, video)
        if len(seen) < _FEWEST:
            raise _unusable(video, f"gives {len(seen)} frames")
        chosen = sharpest_of_parts(np.array([one.way for one in seen]), np.array([one.sharp for one in seen]), count)
        if len(chosen) < min(_FEWEST, count):
            even = np.arange(len(seen), dtype=np.float64)
            chosen = sharpest_of_parts(even, np.array([one.sharp for one in seen]), count)
        frames = _written(av, video, {seen[k].number for k in chosen}, folder)
    except av.FFmpegError as error:
        raise _unusable(video, f"cannot be decoded ({error.strerror})") from error
    return frames, note


class _Seen(NamedTuple):
    """A frame: its number among those with a time, how far pictures have moved until it, how sharp it is."""

    number: int
    way: float
    sharp: float


def sharpest_of_parts(way: np.ndarray, sharp: np.ndarray, count: int) -> list[int]:
    """Of each of `count` equal parts of the way [N], which rises, the sharpest frame: indices in rising order."""
    length = float(way[-1] - way[0])
    part = np.minimum(((way - way[0]) / max(length, 1e-12) * count + 1e-6).astype(int), count - 1)
    best: dict[int, int] = {}
    for k, here in enumerate(part.tolist()):
        if here not in best or sharp[k] > sharp[best[here]]:
            best[here] = k
    return sorted(best.values())


def _looked_over(av: Any, video: Path) -> tuple[list[_Seen], str]:
    """Every frame with a time, and a note on the colours."""
    seen: list[_Seen] = []
    note, passed, mark = "", 0.0, None
    for frame in _decoded(av, video):
        note = note or _note(video, frame)
        luma = frame.to_ndarray(format="gray")[..., None]
        thumb = grey_of(luma, _THUMB)
        # from a mark, not from frame to frame: noise moves nothing, however many frames it lies in
        moved = 0.0 if mark is None else displacement(mark, thumb)
        if mark is None or not np.isfinite(moved):
            mark, moved = thumb, 0.0
        elif moved >= _MARK:
            mark, passed, moved = thumb, passed + moved, 0.0
        value = sharpness(grey_of(luma, _SIDE))
        seen.append(_Seen(len(seen), passed, value if np.isfinite(value) else 0.0))
    return seen, note


def _written(av: Any, video: Path, chosen: Collection[int], folder: Path) -> list[Path]:
    return [_write(frame, folder) for k, frame in enumerate(_decoded(av, video)) if k in chosen]


def _decoded(av: Any, video: Path) -> Iterator[Any]:
    with av.open(str(video)) as container:
        if not container.streams.video:
            raise _unusable(video, "holds no video")
        stream = container.streams.video[0]
        stream.thread_type = "AUTO"
        for frame in container.decode(stream):
            if frame.time is not None:
                yield frame


def _write(frame: Any, folder: Path) -> Path:
    unknown = int(frame.colorspace) == _UNKNOWN and frame.height >= _HD  # BT.709 by custom, BT.601 in smaller ones
    matrix = {"src_colorspace": _BT709} if unknown else {}
    codes = frame.reformat(format="rgb24", **matrix).to_ndarray()
    codes = np.rot90(codes, round(frame.rotation / 90))
    at = round(1000 * frame.time)
    path = folder / f"t{at // 1000:04d}_{at % 1000:03d}.png"
    write_codes(path, np.ascontiguousarray(codes))
    return path


def _note(video: Path, frame: Any) -> str:
    curve = _BRIGHT.get(int(frame.color_trc))
    if curve is None:
        return ""
    return f"{video.name} is HDR ({curve}): its colours are read as if they were not, so materials will be off"


def _unusable(video: Path, what: str) -> DataError:
    return DataError(
        f"the video {what}", where=str(video), expected="a whole video of three frames or more (H.264, HEVC, VP9, AV1)",
        fix="copy or export it again, or give a folder of its frames",
    )  # fmt: skip
