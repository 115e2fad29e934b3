"""Depth maps from EXR, NPY and 16-bit PNG, their units, and what is refused."""

import numpy as np
import pytest

from exmesh_graph.errors import DataError
from exmesh_graph.io.depth import depth_file, depth_files, load_depths, read_depth
from exmesh_graph.io.images import write_image
from exmesh_graph.io.normalise import make_frame
from exmesh_graph.io.settings import DepthOptions
from exmesh_graph.types import Views

H, W = 4, 6
NORMALISED = DepthOptions(units="normalised")


@pytest.fixture
def views():
    eye = np.repeat(np.eye(4)[None], 2, axis=0)
    return Views(
        names=("test_000", "test_001"),
        images=np.zeros((2, H, W, 3), np.float32),
        alpha=np.ones((2, H, W), np.float32),
        intrinsics=eye[:, :3, :3].copy(),
        camera_to_world=eye,
        split="train",
    )


def ramp(i=0):
    return (np.arange(H * W, dtype=np.float32).reshape(H, W) + i) / 8


@pytest.mark.parametrize("ending", [".exr", ".npy", ".png"])
def test_formats(tmp_path, views, ending):
    for i, name in enumerate(views.names):
        file = tmp_path / (name + ending)
        if ending == ".npy":
            np.save(file, ramp(i))
        elif ending == ".exr":
            write_image(file, ramp(i), "float")
        else:
            write_image(file, ramp(i) * 8 / 65535, "uint16")
    loaded = load_depths(views, tmp_path, DepthOptions(units="normalised", scale=0.125 if ending == ".png" else 1))
    assert loaded.names == views.names
    assert np.array_equal(loaded.depth, np.stack([ramp(0), ramp(1)]))
    assert loaded.depth.dtype == np.float32
    assert len(depth_files(tmp_path)) == 2


def test_pattern_units_and_larger_maps(tmp_path, views):
    frame = make_frame(np.zeros(3), 1.9, np.eye(4))  # 1 normalised unit is 2 scene units
    for stem in ("000", "001"):
        np.save(tmp_path / f"{stem}_depth.npy", np.repeat(np.repeat(ramp(), 3, 0), 3, 1))
    loaded = load_depths(views, tmp_path, DepthOptions(pattern="{stem}_depth"), frame)
    assert loaded.depth[1] == pytest.approx(ramp() / 2)


def test_missing_and_wrong_size(tmp_path, views):
    np.save(tmp_path / "test_000.npy", ramp())
    with pytest.raises(DataError, match=r"test_001: the depth map does not exist"):
        load_depths(views, tmp_path, NORMALISED)
    np.save(tmp_path / "test_001.npy", ramp().T)
    with pytest.raises(DataError, match=r"test_001\.npy: the depth map is 4 x 6, its view 6 x 4"):
        load_depths(views, tmp_path, NORMALISED)
    with pytest.raises(DataError, match="pattern"):
        depth_file(tmp_path, "{other}", views.names[0])
    with pytest.raises(DataError, match="does not exist"):
        depth_files(tmp_path / "no")


@pytest.mark.parametrize("ending", [".exr", ".npy"])
def test_nan_is_counted_and_placed(tmp_path, ending):
    depth = ramp()
    depth[2, 3:5] = np.nan
    depth[3, 0] = np.inf
    file = tmp_path / f"d{ending}"
    if ending == ".npy":
        np.save(file, depth)
    else:
        write_image(file, depth, "float")
    with pytest.raises(DataError, match=rf"d{ending}: 3 pixels are NaN or Inf, the first at column 3, row 2"):
        read_depth(file)


def test_negative_coarse_and_damaged(tmp_path):
    np.save(tmp_path / "n.npy", -ramp())
    with pytest.raises(DataError, match="23 depths are negative, the first at column 1, row 0"):
        read_depth(tmp_path / "n.npy")
    write_image(tmp_path / "c.png", ramp() / 8)
    with pytest.raises(DataError, match="8-bit depth"):
        read_depth(tmp_path / "c.png")
    (tmp_path / "x.npy").write_bytes(b"no")
    with pytest.raises(DataError, match="cannot be read"):
        read_depth(tmp_path / "x.npy")
    np.save(tmp_path / "s.npy", np.ones((2, 3, 4, 5)))
    with pytest.raises(DataError, match="shape"):
        read_depth(tmp_path / "s.npy")


def test_relative_maps_keep_every_value_and_lose_their_units(tmp_path, views):
    """Zero is a depth here, and two files that differ by scale and shift alone are the same map."""
    write_image(tmp_path / "test_000.png", ramp() * 8 / 65535, "uint16")
    write_image(tmp_path / "test_001.png", (3 * 8 * ramp() + 100) / 65535, "uint16")
    loaded = load_depths(views, tmp_path, DepthOptions(units="relative"))
    assert loaded.units == "relative"
    assert loaded.depth[0] == pytest.approx(1 + ramp() / ramp().max())
    assert loaded.depth[1] == pytest.approx(loaded.depth[0], abs=1e-6)
    write_image(tmp_path / "test_001.png", np.full((H, W), 0.5, np.float32), "uint16")
    with pytest.raises(DataError, match="all depths are equal"):
        load_depths(views, tmp_path, DepthOptions(units="relative"))
