"""Meshes with atlases for the topology tests, and what must hold after an operation."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from hypothesis import strategies as st

from benchmarks.meshes import grid, is_vertex_manifold, is_winding_consistent, tetrahedron, torus
from exmesh_graph.geometry.adjacency import boundary_edges, components, euler_characteristic
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.types.edges import edges_of, has_collapsed_faces, is_edge_manifold
from exmesh_graph.uv.unwrap import unwrap

SHAPES = {
    "tetrahedron": lambda: tetrahedron(),
    "icosahedron": lambda: icosphere(0),
    "sphere": lambda: icosphere(2),
    "torus": lambda: torus(9, 5),
    "neck": lambda: torus(12, 3, minor=0.1),
    "strip": lambda: grid(12, 1),
    "sheet": lambda: grid(6, 5),
}


@lru_cache
def unwrapped(name):
    vertices, faces = SHAPES[name]()
    return vertices, faces, *unwrap(vertices, faces, 256)


@st.composite
def meshes(draw, noise=(0.0, 0.05, 0.3), names=tuple(SHAPES)):
    """(vertices, faces, uvs, uv_faces, gradient): regular, roughened, with zero-area faces, or coplanar."""
    name = draw(st.sampled_from(names))
    vertices, faces, uvs, uv_faces = unwrapped(name)
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    strength = draw(st.sampled_from(noise))
    vertices = vertices + rng.normal(size=vertices.shape).astype(np.float32) * np.float32(strength * 0.3)
    if draw(st.booleans()) and len(vertices) > 8:  # pinch some vertices onto a neighbour: faces without area
        edges = edges_of(faces).vertices
        for a, b in edges[rng.choice(len(edges), 3, replace=False)]:
            vertices[a] = vertices[b]
    gradient = rng.random(len(vertices)).astype(np.float32) * draw(st.sampled_from([0.0, 1.0]))
    return vertices, faces, uvs, uv_faces, gradient


def uv_areas(uvs, uv_faces):
    a, b, c = (uvs[uv_faces[:, k]].astype(np.float64) for k in range(3))
    return 0.5 * ((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1]))


def check_topology(before, after):
    """What every operation keeps: manifoldness, winding, Euler number, boundary loops, separate islands."""
    _, faces, uvs, uv_faces = before
    assert after.faces.shape == after.uv_faces.shape
    assert after.faces.dtype == faces.dtype
    assert after.uv_faces.dtype == uv_faces.dtype
    assert after.vertices.dtype == np.float32
    assert after.uvs.dtype == np.float32
    assert not has_collapsed_faces(after.faces)
    assert is_edge_manifold(after.faces)
    assert is_vertex_manifold(after.faces)
    assert is_winding_consistent(after.faces)
    assert euler_characteristic(after.faces) == euler_characteristic(faces)
    assert boundary_loops(after.faces) == boundary_loops(faces)
    assert len(np.unique(np.sort(after.faces, axis=1), axis=0)) == len(after.faces)
    assert after.faces.min() >= 0
    assert after.faces.max() < len(after.vertices)
    assert after.uv_faces.min() >= 0
    assert after.uv_faces.max() < len(after.uvs)
    # no UV belongs to two vertices, and no island holds parts of two old islands
    pairs = np.unique(np.stack([after.uv_faces.reshape(-1), after.faces.reshape(-1)], axis=1), axis=0)
    assert len(np.unique(pairs[:, 0])) == len(pairs)
    old = components(uv_faces)[after.face_source]
    new = components(after.uv_faces)
    assert len(np.unique(np.stack([new, old], axis=1), axis=0)) == len(np.unique(new))
    flipped_before = (uv_areas(uvs, uv_faces) <= 0).any()
    assert flipped_before or (uv_areas(after.uvs, after.uv_faces) > 0).all()


def boundary_loops(faces):
    """The number of closed lines that the boundary consists of (the mesh is a manifold: none meet)."""
    after = dict(boundary_edges(faces).tolist())
    loops = 0
    while after:
        at = next(iter(after))
        while at in after:
            at = after.pop(at)
        loops += 1
    return loops


def canonical(faces, uvs, uv_faces):
    """Faces turned to start at their lowest vertex, sorted, each with its corners' UV coordinates."""
    rows = []
    for face, corner in zip(np.asarray(faces).tolist(), np.asarray(uv_faces).tolist(), strict=True):
        k = face.index(min(face))
        turn = [(k + i) % 3 for i in range(3)]
        rows.append(([face[t] for t in turn], [corner[t] for t in turn]))
    rows.sort()
    return [row[0] for row in rows], np.array([[uvs[c] for c in row[1]] for row in rows]), [r[1] for r in rows]


def same_sharing(a, b):
    """Whether two corner-to-UV maps share coordinates in the same places, whatever their numbering."""
    a, b = np.asarray(a).reshape(-1), np.asarray(b).reshape(-1)
    pairs = len(np.unique(np.stack([a, b], axis=1), axis=0))
    return pairs == len(np.unique(a)) == len(np.unique(b))
