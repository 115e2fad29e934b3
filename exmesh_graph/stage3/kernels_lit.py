"""Warp kernels of vertices under the light that was found; Warp derives their adjoints. Import through
`stage3.fused`.

Sums over a vertex's faces are added by whoever draws a face, in the faces' order: launch those kernels whole.
"""
# mypy: ignore-errors

import warp as wp

from exmesh_graph.stage2.surface import GRAZING

#: Longitude has no derivative at the poles: a direction nearer to one is taken as one next to it.
NEAR_POLE = wp.constant(1.0 - 1e-6)
LEAST_NORMAL = wp.constant(1e-12)
LEAST_CROSS = wp.constant(1e-20)
GRAZED = wp.constant(GRAZING)


@wp.func
def unit(v: wp.vec3, least: float):
    return v / wp.max(wp.length(v), least)


@wp.kernel
def add_normals(
    first: int,
    least_sine: float,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    angles: wp.array(dtype=wp.vec3),
    sums: wp.array(dtype=wp.vec3),
):
    """Add the unit normal of face `first + tid`, times its angle at each corner, to its corners' `sums`."""
    f = first + wp.tid()
    corner, angle = faces[f], angles[f]
    a = vertices[corner[0]]
    out, back = vertices[corner[1]] - a, vertices[corner[2]] - a
    cross = wp.cross(out, back)
    if wp.length(cross) > least_sine * wp.length(out) * wp.length(back):
        normal = unit(cross, LEAST_CROSS)
        wp.atomic_add(sums, corner[0], angle[0] * normal)
        wp.atomic_add(sums, corner[1], angle[1] * normal)
        wp.atomic_add(sums, corner[2], angle[2] * normal)


@wp.func
def bilinear_level(rows: wp.array(dtype=wp.vec3), levels: wp.array(dtype=wp.vec3i), level: int, u: float, v: float):
    """The prefiltered map at image coordinates (u, v) of one of its levels (height, width, first row)."""
    size = levels[level]
    height, width = float(size[0]), float(size[1])
    x = u * width - 0.5
    y = wp.min(wp.max(v * height - 0.5, 0.0), height - 1.0)
    x0 = wp.floor(x)
    y0 = wp.min(wp.floor(y), wp.max(height - 2.0, 0.0))
    fx, fy = x - x0, y - y0
    left = int(x0) % size[1]
    if left < 0:
        left = left + size[1]
    right = (left + 1) % size[1]
    top = size[2] + int(y0) * size[1]
    bottom = size[2] + wp.min(int(y0) + 1, size[0] - 1) * size[1]
    above = (1.0 - fx) * rows[top + left] + fx * rows[top + right]
    below = (1.0 - fx) * rows[bottom + left] + fx * rows[bottom + right]
    return (1.0 - fy) * above + fy * below


@wp.func
def reflected_share(table: wp.array2d(dtype=wp.vec2), n_v: float, roughness: float):
    """A and B (shading.specular.directional_albedo)."""
    cells = float(table.shape[0])
    x = wp.min(wp.max(n_v * cells - 0.5, 0.0), cells - 1.001)
    y = wp.min(wp.max(roughness * cells - 0.5, 0.0), cells - 1.001)
    i, j = int(x), int(y)
    fx, fy = x - float(i), y - float(j)
    near = (1.0 - fy) * table[i, j] + fy * table[i, j + 1]
    far = (1.0 - fy) * table[i + 1, j] + fy * table[i + 1, j + 1]
    return (1.0 - fx) * near + fx * far


@wp.func
def encoded(linear: float):
    """The sRGB curve (colour.linear_to_srgb)."""
    result = 12.92 * linear
    if linear > 0.0031308:
        result = 1.055 * wp.pow(linear, 1.0 / 2.4) - 0.055
    return result


@wp.kernel
def light_vertices(
    first: int,
    chosen: wp.array(dtype=wp.int32),
    camera: wp.vec3,
    vertices: wp.array(dtype=wp.vec3),
    sums: wp.array(dtype=wp.vec3),
    start: wp.array(dtype=wp.vec3),
    diffuse: wp.array(dtype=wp.vec3),
    irradiance: wp.array(dtype=wp.vec3),
    towards_x: wp.array(dtype=wp.vec3),
    towards_y: wp.array(dtype=wp.vec3),
    towards_z: wp.array(dtype=wp.vec3),
    level: wp.array(dtype=wp.int32),
    share: wp.array(dtype=float),
    rows: wp.array(dtype=wp.vec3),
    levels: wp.array(dtype=wp.vec3i),
    f0: wp.array(dtype=wp.vec3),
    roughness: wp.array(dtype=float),
    table: wp.array2d(dtype=wp.vec2),
    scale: wp.array(dtype=wp.vec3),
    out: wp.array(dtype=wp.vec3),
):
    """What vertex `chosen[first + tid]` sends towards the camera, sRGB-encoded.

    diffuse, irradiance     f_d and E(n_0) of each vertex; towards_x, y, z: F, the vector irradiance of three colours
    level, share            the sharper of two levels of `rows` that its roughness lies between, and the other's share
    table                   A and B of the split sum by n.v and roughness (shading.specular.reflectance_table)
    scale                   of each chosen vertex: c
    """
    k = first + wp.tid()
    v = chosen[k]
    normal = unit(sums[v], LEAST_NORMAL)
    view = wp.normalize(camera - vertices[v])
    turned = normal - start[v]
    arriving = irradiance[v] + turned[0] * towards_x[v] + turned[1] * towards_y[v] + turned[2] * towards_z[v]
    arriving = wp.vec3(wp.max(arriving[0], 0.0), wp.max(arriving[1], 0.0), wp.max(arriving[2], 0.0))
    short = wp.max(GRAZED - wp.dot(normal, view), 0.0)
    bent = unit(normal + short * view, LEAST_NORMAL)
    n_v = wp.min(wp.max(wp.dot(bent, view), 1.0e-3), 1.0)
    mirrored = unit(2.0 * n_v * bent - view, LEAST_NORMAL)
    if wp.abs(mirrored[1]) > NEAR_POLE:
        mirrored = wp.vec3(1.0e-3, 1.0, 0.0) * wp.sign(mirrored[1])
    across = wp.sqrt(mirrored[0] * mirrored[0] + mirrored[2] * mirrored[2])
    place_u = 0.5 - wp.atan2(mirrored[0], mirrored[2]) / (2.0 * wp.pi)
    place_v = wp.atan2(across, mirrored[1]) / wp.pi
    sharper = bilinear_level(rows, levels, level[v], place_u, place_v)
    duller = bilinear_level(rows, levels, level[v] + 1, place_u, place_v)
    sent = (1.0 - share[v]) * sharper + share[v] * duller
    ab = reflected_share(table, n_v, roughness[v])
    lobe = ab[0] * f0[v] + ab[1] * wp.vec3(1.0, 1.0, 1.0)
    light = wp.cw_mul(diffuse[v], arriving) + wp.cw_mul(wp.cw_mul(lobe, sent), scale[k])
    out[k] = wp.vec3(encoded(light[0]), encoded(light[1]), encoded(light[2]))
