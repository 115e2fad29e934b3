"""Triangle mesh files: OBJ and PLY (ASCII and binary), positions and faces only, with checks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from exmesh_graph.errors import DataError

_PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip


def read_mesh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """(vertices float64 [V, 3], faces int32 [F, 3]) of an OBJ or PLY file; polygons are cut into fans.

    Raises DataError for a missing, malformed or empty file, indices out of range, and positions that are not finite.
    """
    path = Path(path)
    readers = {".obj": _read_obj, ".ply": _read_ply}
    with _reading(path, "the mesh", "export it again"):
        if path.suffix.lower() not in readers:
            raise DataError(f"cannot read {path.suffix!r} meshes", where=str(path), expected=".obj or .ply")
        vertices, faces = readers[path.suffix.lower()](path)
    check_mesh(vertices, faces, str(path))
    return vertices, faces


def read_points(path: Path) -> np.ndarray:
    """Positions float64 [N, 3] of a PLY file, which may be a point cloud. DataError as for `read_mesh`."""
    path = Path(path)
    with _reading(path, "the point cloud", "copy it again"):
        points, _ = _read_ply(path)
    if len(points) == 0 or not np.isfinite(points).all():
        raise DataError(f"the point cloud has {len(points)} points or values that are not finite", where=str(path))
    return points


def read_vertex_table(path: Path) -> np.ndarray:
    """All vertex properties of a binary PLY file: a structured array with a field for each.

    Raises DataError for a file that is missing, cut short, not a binary PLY, or whose first element is not vertices.
    """
    path = Path(path)
    with _reading(path, "the file", "export or copy it again", expected="a binary PLY file"):
        form, elements, body = _ply_parts(path.read_bytes())
        name, count, properties = elements[0]
        if form == "ascii" or name != "vertex" or any(len(p) > 2 for p in properties):
            raise ValueError("its first element is not a binary table of vertices")
        layout = np.dtype(
            [(p[0], (">" if form == "binary_big_endian" else "<") + _PLY_TYPES[p[1]]) for p in properties]
        )
        if len(body) < count * layout.itemsize:
            raise ValueError(f"it ends early: {count} vertices are announced")
        return np.frombuffer(body, layout, count)


@contextmanager
def _reading(path: Path, what: str, fix: str, expected: str = "") -> Iterator[None]:
    if not path.is_file():
        raise DataError(f"{what} does not exist", where=str(path), fix="correct the path")
    try:
        yield
    except (ValueError, IndexError, KeyError) as error:
        raise DataError(f"{what} cannot be read ({error})", where=str(path), expected=expected, fix=fix) from error


def check_mesh(vertices: np.ndarray, faces: np.ndarray, where: str) -> None:
    """DataError unless there are faces, all indices are in range and all positions finite."""
    if len(vertices) == 0 or len(faces) == 0:
        raise DataError(f"the mesh is empty ({len(vertices)} vertices, {len(faces)} faces)", where=where,
                        expected="a mesh, not a point cloud", fix="export the mesh with its faces")  # fmt: skip
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise DataError(f"a face refers to vertex {int(faces.max())}, there are {len(vertices)}", where=where,
                        fix="export the mesh again")  # fmt: skip
    bad = ~np.isfinite(vertices).all(1)
    if bad.any():
        raise DataError(f"{int(bad.sum())} vertices are NaN or Inf, the first is {int(bad.argmax())}", where=where,
                        fix="export the mesh again without them")  # fmt: skip


def _fans(polygons: list[list[int]]) -> np.ndarray:
    return np.array([[p[0], p[i], p[i + 1]] for p in polygons for i in range(1, len(p) - 1)], dtype=np.int32).reshape(
        -1, 3
    )


def _read_obj(path: Path) -> tuple[np.ndarray, np.ndarray]:
    vertices: list[list[float]] = []
    polygons: list[list[int]] = []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        if line.startswith("v "):
            vertices.append([float(x) for x in line.split()[1:4]])
        elif line.startswith("f "):
            corners = [int(c.split("/")[0]) for c in line.split()[1:]]
            # Indices count from 1; negative ones count back from the vertices read so far.
            polygons.append([c - 1 if c > 0 else len(vertices) + c for c in corners])
    return np.array(vertices, dtype=np.float64).reshape(-1, 3), _fans(polygons)


def _read_ply(path: Path) -> tuple[np.ndarray, np.ndarray]:
    form, elements, body = _ply_parts(path.read_bytes())
    if form == "ascii":
        return _ply_ascii(body.decode("ascii").split(), elements)
    return _ply_binary(body, elements, "<" if form == "binary_little_endian" else ">")


_Element = tuple[str, int, list[tuple[str, ...]]]


def _ply_parts(data: bytes) -> tuple[str, list[_Element], bytes]:
    """(format, [(element, count, [(name, type) or (name, count type, item type)])], what follows the header)."""
    end = data.find(b"end_header")
    if not data.startswith(b"ply") or end < 0:
        raise ValueError("no PLY header")
    form, elements = "", []  # type: str, list[_Element]
    for line in data[:end].decode("ascii", errors="replace").splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == "format":
            form = words[1]
        elif words[0] == "element":
            elements.append((words[1], int(words[2]), []))
        elif words[0] == "property" and words[1] == "list":
            elements[-1][2].append((words[4], words[2], words[3]))
        elif words[0] == "property":
            elements[-1][2].append((words[2], words[1]))
    if form not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise ValueError(f"unknown PLY format {form!r}")
    return form, elements, data[data.index(b"\n", end) + 1 :]


def _ply_ascii(words: list[str], elements: list[_Element]) -> tuple[np.ndarray, np.ndarray]:
    vertices, polygons, at = np.zeros((0, 3)), [], 0
    for name, count, properties in elements:
        names = [p[0] for p in properties]
        if all(len(p) == 2 for p in properties):
            table = np.array(words[at : at + count * len(names)], dtype=np.float64).reshape(count, len(names))
            at += count * len(names)
            if name == "vertex":
                vertices = table[:, [names.index(a) for a in "xyz"]]
            continue
        for _ in range(count):
            for prop in properties:
                length = int(words[at]) if len(prop) == 3 else 0
                items = words[at + 1 : at + 1 + length]
                at += 1 + length
                if name == "face" and prop[0] in ("vertex_indices", "vertex_index"):
                    polygons.append([int(i) for i in items])
    return vertices, _fans(polygons)


def _ply_binary(body: bytes, elements: list[_Element], order: str) -> tuple[np.ndarray, np.ndarray]:
    vertices, faces, at = np.zeros((0, 3)), np.zeros((0, 3), np.int32), 0
    for name, count, properties in elements:
        if all(len(p) == 2 for p in properties):
            layout = np.dtype([(p[0], order + _PLY_TYPES[p[1]]) for p in properties])
            table = np.frombuffer(body, layout, count, at)
            at += count * layout.itemsize
            if name == "vertex":
                vertices = np.stack([table[a].astype(np.float64) for a in "xyz"], axis=1)
            continue
        polygons, at = _ply_lists(body, at, count, properties, order, name)
        if name == "face":
            faces = polygons
    return vertices, faces


def _ply_lists(
    body: bytes, at: int, count: int, properties: list[tuple[str, ...]], order: str, name: str
) -> tuple[np.ndarray, int]:
    """Fans of an element with list properties, and the offset after it. All-triangle files are read at once."""
    fields: list[tuple] = []
    for i, p in enumerate(properties):
        if len(p) == 3:
            fields += [(f"n{i}", order + _PLY_TYPES[p[1]]), (f"v{i}", order + _PLY_TYPES[p[2]], (3,))]
        else:
            fields.append((f"s{i}", order + _PLY_TYPES[p[1]]))
    layout = np.dtype(fields)
    wanted = [i for i, p in enumerate(properties) if len(p) == 3 and p[0] in ("vertex_indices", "vertex_index")]
    if at + count * layout.itemsize <= len(body):
        table = np.frombuffer(body, layout, count, at)
        if all((table[f"n{i}"] == 3).all() for i, p in enumerate(properties) if len(p) == 3):
            faces = table[f"v{wanted[0]}"].astype(np.int32) if wanted else np.zeros((0, 3), np.int32)
            return faces, at + count * layout.itemsize
    polygons: list[list[int]] = []
    for _ in range(count):
        for i, p in enumerate(properties):
            if len(p) == 2:
                at += np.dtype(_PLY_TYPES[p[1]]).itemsize
                continue
            size, item = np.dtype(order + _PLY_TYPES[p[1]]), np.dtype(order + _PLY_TYPES[p[2]])
            length = int(np.frombuffer(body, size, 1, at)[0])
            values = np.frombuffer(body, item, length, at + size.itemsize)
            at += size.itemsize + length * item.itemsize
            if name == "face" and i in wanted:
                polygons.append([int(v) for v in values])
    return _fans(polygons), at
