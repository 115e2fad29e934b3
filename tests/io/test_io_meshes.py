"""Mesh files: round trips, foreign spellings, and damaged files."""

import struct

import numpy as np
import pytest

from benchmarks.meshes import write_obj, write_ply
from exmesh_graph.errors import DataError
from exmesh_graph.io.meshes import read_mesh


@pytest.fixture
def mesh():
    rng = np.random.default_rng(0)
    return rng.normal(size=(10, 3)).astype(np.float32), rng.permuted(np.tile(np.arange(10), (7, 1)), axis=1)[:, :3]


@pytest.mark.parametrize("name", ["m.ply", "m.obj"])
def test_round_trip_is_exact(tmp_path, mesh, name):
    (write_ply if name.endswith("ply") else write_obj)(tmp_path / name, *mesh)
    vertices, faces = read_mesh(tmp_path / name)
    assert np.array_equal(vertices.astype(np.float32), mesh[0])
    assert np.array_equal(faces, mesh[1])
    assert faces.dtype == np.int32


def test_obj_with_texture_indices_quads_and_negative_indices(tmp_path):
    (tmp_path / "m.obj").write_text(
        "# c\no thing\nv 0 0 0 1 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\nf 1/1/1 2//1 3/1 4\nf -4 -3 -2\n"
    )
    vertices, faces = read_mesh(tmp_path / "m.obj")
    assert len(vertices) == 4
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 2]]


def test_ascii_ply_with_more_properties(tmp_path):
    (tmp_path / "m.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float nx\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_index\nend_header\n"
        "9 0 0 0\n9 1 0 0\n9 1 1 0\n9 0 1 0\n4 0 1 2 3\n"
    )
    vertices, faces = read_mesh(tmp_path / "m.ply")
    assert vertices[1].tolist() == [1, 0, 0]
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_big_endian_ply_with_mixed_polygons_and_scalars(tmp_path):
    header = (
        "ply\nformat binary_big_endian 1.0\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\n"
        "property uchar red\nelement face 2\nproperty uchar flag\nproperty list uchar uint vertex_indices\nend_header\n"
    )
    body = b"".join(struct.pack(">dddB", *p, 7) for p in ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)))
    body += struct.pack(">BBIIII", 1, 4, 0, 1, 2, 3) + struct.pack(">BBIII", 1, 3, 3, 2, 1)
    (tmp_path / "m.ply").write_bytes(header.encode() + body)
    vertices, faces = read_mesh(tmp_path / "m.ply")
    assert vertices[2].tolist() == [1, 1, 0]
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3], [3, 2, 1]]


@pytest.mark.parametrize(
    ("name", "text", "match"),
    [
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "refers to vertex 8, there are 3"),
        ("b.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "empty"),
        ("c.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "NaN"),
        ("d.obj", "v 0 0 x\n", "cannot be read"),
        ("e.ply", "not a ply", "cannot be read"),
        ("f.stl", "", "cannot read"),
    ],
)
def test_bad_files_are_named(tmp_path, name, text, match):
    (tmp_path / name).write_text(text)
    with pytest.raises(DataError, match=f"{name}.*{match}"):
        read_mesh(tmp_path / name)


def test_missing_and_cut_files(tmp_path, mesh):
    with pytest.raises(DataError, match="does not exist"):
        read_mesh(tmp_path / "no.ply")
    write_ply(tmp_path / "m.ply", *mesh)
    data = (tmp_path / "m.ply").read_bytes()
    (tmp_path / "m.ply").write_bytes(data[:-20])
    with pytest.raises(DataError, match="cannot be read"):
        read_mesh(tmp_path / "m.ply")
