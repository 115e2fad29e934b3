"""A video in place of a folder: the sharpest frames, upright, called by their time, in the key."""

import sys

import numpy as np
import pytest
from exmesh_nodes import data as nodes
from scipy.ndimage import gaussian_filter

from exmesh_graph.errors import DataError, MissingLibraryError
from exmesh_graph.io.images import read_raw
from exmesh_graph.io.photos import list_photos
from exmesh_graph.io.video import extract_frames, sharpest_of_parts

WIDTH, HEIGHT, COUNT, SHARP = 96, 64, 30, (2, 9, 12, 19, 24)


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """Three seconds of noise, most of it out of focus; the upper left quarter is red."""
    av = pytest.importorskip("av", reason="pip install 'exmesh-graph[video]'")
    path = tmp_path_factory.mktemp("video") / "clip.mp4"
    rng = np.random.default_rng(0)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=10)
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = WIDTH, HEIGHT, "yuv420p", 4_000_000
        for k in range(COUNT):
            grey = gaussian_filter(rng.random((HEIGHT, WIDTH)), 0.8 if k in SHARP else 2.5)
            rgb = np.repeat(255 * (grey - grey.min())[..., None] / np.ptp(grey), 3, axis=2)
            rgb[: HEIGHT // 2, : WIDTH // 2] = 200, 20, 20
            frame = av.VideoFrame.from_ndarray(rgb.astype(np.uint8), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def test_the_sharpest_frame_of_each_part_by_its_time(video, tmp_path):
    frames, note = extract_frames(video, 5, tmp_path / "f")
    assert [frame.stem for frame in frames] == [f"t{k // 10:04d}_{k % 10}00" for k in SHARP]
    assert note == ""
    codes = read_raw(frames[0])
    assert codes.shape == (HEIGHT, WIDTH, 3)
    assert np.abs(codes[4:24, 4:40].astype(int) - [200, 20, 20]).mean() < 12


def test_a_camera_that_stands_still_gives_few_frames(tmp_path):
    """It moves for a second, stands for four, and moves for another: by time two thirds would be of one place."""
    av = pytest.importorskip("av", reason="pip install 'exmesh-graph[video]'")
    path = tmp_path / "pan.mp4"
    rng = np.random.default_rng(1)
    wall = gaussian_filter(rng.random((HEIGHT, 4 * WIDTH)), 1.5)
    wall = 255 * (wall - wall.min()) / np.ptp(wall)
    places = [*range(0, 60, 6), *[60] * 40, *range(66, 126, 6)]
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=10)
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = WIDTH, HEIGHT, "yuv420p", 4_000_000
        for left in places:
            grey = wall[:, left : left + WIDTH] + rng.normal(0, 2, (HEIGHT, WIDTH))
            rgb = np.repeat(grey.clip(0, 255)[..., None], 3, axis=2).astype(np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(rgb, format="rgb24")))
        container.mux(stream.encode())
    frames, _ = extract_frames(path, 6, tmp_path / "f")
    still = [frame for frame in frames if "t0001_000" <= frame.stem < "t0005_000"]
    assert len(frames) == 6
    assert len(still) <= 2


def test_the_sharpest_of_equal_parts_of_the_way():
    way = np.array([0.0, 0.1, 0.2, 0.2, 0.2, 0.6, 1.0])
    sharp = np.array([1.0, 3.0, 2.0, 5.0, 1.0, 2.0, 3.0])
    assert sharpest_of_parts(way, sharp, 2) == [3, 6]
    assert sharpest_of_parts(np.zeros(3), np.array([1.0, 2.0, 0.0]), 4) == [1]


def test_more_frames_than_there_are_gives_all(video, tmp_path):
    assert len(extract_frames(video, 500, tmp_path / "f")[0]) == COUNT


def test_a_phone_held_upright_gives_upright_frames(video, tmp_path):
    """The matrix of the track header says: turn by a quarter to the right (ISO 14496-12, 8.3.2)."""
    data = bytearray(video.read_bytes())
    at = data.index(b"tkhd") + 4 + 40
    one = (1 << 16).to_bytes(4, "big")
    minus, none = (2**32 - (1 << 16)).to_bytes(4, "big"), bytes(4)
    far = (HEIGHT << 16).to_bytes(4, "big")
    data[at : at + 36] = none + one + none + minus + none + none + far + none + (1 << 30).to_bytes(4, "big")
    turned = tmp_path / "turned.mp4"
    turned.write_bytes(data)
    codes = read_raw(extract_frames(turned, 5, tmp_path / "f")[0][0])
    assert codes.shape == (WIDTH, HEIGHT, 3)
    assert np.abs(codes[4:40, -24:-4].astype(int) - [200, 20, 20]).mean() < 12  # now the upper right


def test_the_file_is_in_the_key_and_lies_anywhere(video):
    """And so is the version of what decodes it."""
    files = dict(nodes._photo_files(nodes.PhotosParams(path=video)))
    assert files.pop("av/METADATA").is_file()
    assert files == {"clip.mp4": video}


def test_what_is_no_video_is_refused_by_name(video, tmp_path, monkeypatch):
    (tmp_path / "cut.mp4").write_bytes(video.read_bytes()[:500])
    with pytest.raises(DataError, match=r"cut\.mp4.*cannot be decoded"):
        extract_frames(tmp_path / "cut.mp4", 5, tmp_path / "f")
    (tmp_path / "notes.txt").write_text("a")
    with pytest.raises(DataError, match="not a video"):
        nodes._photo_files(nodes.PhotosParams(path=tmp_path / "notes.txt"))
    with pytest.raises(DataError, match=r"for the video in it give the file: path: .*cut\.mp4"):
        list_photos(tmp_path)
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(MissingLibraryError, match=r"(?s)clip\.mp4.*exmesh-graph\[video\]"):
        nodes._photo_files(nodes.PhotosParams(path=video))
