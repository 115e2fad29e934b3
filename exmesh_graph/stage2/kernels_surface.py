"""Surface samples in one pass, for a CPU. Import through `surface`, whose `plain_samples` is the reference."""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def _unit(v: wp.vec3) -> wp.vec3:
    return v / wp.max(wp.length(v), 1.0e-12)


@wp.kernel
def surface_samples(
    first: int,
    grazing: float,
    camera: wp.array(dtype=wp.vec3),
    face: wp.array(dtype=wp.int64),
    bary: wp.array(dtype=wp.vec3),
    vertices: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.int64),
    face_normals: wp.array(dtype=wp.vec3),
    uvs: wp.array(dtype=wp.vec2),
    uv_faces: wp.array(dtype=wp.int64),
    position: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    flat: wp.array(dtype=wp.vec3),
    view: wp.array(dtype=wp.vec3),
    reflected: wp.array(dtype=wp.vec3),
    n_v: wp.array(dtype=float),
    uv: wp.array(dtype=wp.vec2),
):
    i = first + wp.tid()
    corner = 3 * int(face[i])
    b = bary[i]
    v0 = int(faces[corner])
    v1 = int(faces[corner + 1])
    v2 = int(faces[corner + 2])
    p = vertices[v0] * b[0] + vertices[v1] * b[1] + vertices[v2] * b[2]
    n = _unit(normals[v0] * b[0] + normals[v1] * b[1] + normals[v2] * b[2])
    v = _unit(camera[0] - p)
    g = face_normals[int(face[i])]
    if wp.dot(g, v) < 0.0:
        g = -g
    facing = wp.dot(n, v)
    if facing < grazing:
        n = _unit(n + (grazing - facing) * v)
    facing = wp.clamp(wp.dot(n, v), 1.0e-3, 1.0)
    position[i] = p
    normal[i] = n
    flat[i] = g
    view[i] = v
    n_v[i] = facing
    reflected[i] = _unit(2.0 * facing * n - v)
    t0 = uvs[int(uv_faces[corner])]
    t1 = uvs[int(uv_faces[corner + 1])]
    t2 = uvs[int(uv_faces[corner + 2])]
    uv[i] = t0 * b[0] + t1 * b[1] + t2 * b[2]
