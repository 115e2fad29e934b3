"""Frames of a video as photographs: the sharpest of each of so many equal parts of its time.

Through PyAV (FFmpeg's libraries). Every frame is decoded once; the best of a part is the only one kept meanwhile.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.images import write_codes
from exmesh_graph.io.selection import grey_of, sharpness
from exmesh_graph.native import import_av

_SIDE = 640
_BRIGHT = {16: "PQ", 18: "HLG"}  # transfer characteristics of ITU-T H.273 that are not near sRGB's
_UNKNOWN, _HD, _BT709 = 2, 720, 1


def extract_frames(video: Path, count: int, folder: Path) -> tuple[list[Path], str]:
    """(at most `count` upright frames as 8-bit PNG in the order of time, a note on their colour or "").

    `folder` is new. Frames are called by their time, t0012_480 for 12.48 s. DataError where the file cannot be decoded,
    says no duration, or has fewer than three frames; MissingLibraryError without PyAV.
    """
    av = import_av(video)
    folder.mkdir()
    frames: list[Path] = []
    note = ""
    part, best, sharp = -1, None, -1.0
    try:
        with av.open(str(video)) as container:
            if not container.streams.video:
                raise _unusable(video, "holds no video")
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            start, length = _span(container, stream, av.time_base)
            if length <= 0:
                raise _unusable(video, "does not say how long it is")
            for frame in container.decode(stream):
                if frame.time is None:
                    continue
                note = note or _note(video, frame)
                here = min(int((frame.time - start) / length * count + 1e-6), count - 1)
                if here != part and best is not None:
                    frames.append(_write(best, folder))
                    best, sharp = None, -1.0
                part = here
                value = _sharpness(frame)
                if best is None or value > sharp:
                    best, sharp = frame, value
    except av.FFmpegError as error:
        raise _unusable(video, f"cannot be decoded ({error.strerror})") from error
    if best is not None:
        frames.append(_write(best, folder))
    if len(frames) < 3:
        raise _unusable(video, f"gives {len(frames)} frames")
    return frames, note


def _span(container: Any, stream: Any, ticks: int) -> tuple[float, float]:
    """(first time, duration) in seconds; 0 where nothing says it."""
    start = 0.0 if stream.start_time is None else float(stream.start_time * stream.time_base)
    if stream.duration is not None:
        return start, float(stream.duration * stream.time_base)
    return start, 0.0 if container.duration is None else container.duration / ticks


def _sharpness(frame: Any) -> float:
    """Of the brightness alone, as it is coded; 0 where nothing shows."""
    luma = frame.to_ndarray(format="gray")[..., None]
    value = sharpness(grey_of(luma, _SIDE))
    return value if np.isfinite(value) else 0.0


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
