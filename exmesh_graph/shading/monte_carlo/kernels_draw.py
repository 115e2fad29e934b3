"""Warp kernels that draw light samples: one source for CPU and CUDA.

A thread is a surface point; nothing per sample is written but a direction and a weight. Formulas as in `reference`
(lobes) and `shading.env_sampling`. Imported after Warp has been configured.
"""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

from exmesh_graph.shading.monte_carlo.kernels_shade import COSINE_MIN, PI, alpha_of, footprint_at, ggx

wp.set_module_options({"enable_backward": False})

SINE_MIN = wp.constant(1.0e-7)


@wp.func
def _uv(d: wp.vec3) -> wp.vec2:
    """Image coordinates of direction d, as `envmap.uv_of`."""
    u = 0.5 - wp.atan2(d[0], d[2]) / (2.0 * PI)
    return wp.vec2(u, wp.atan2(wp.sqrt(d[0] * d[0] + d[2] * d[2]), d[1]) / PI)


@wp.func
def _environment_pdf(d: wp.vec3, uv: wp.vec2, density: wp.array(dtype=float), height: int, width: int) -> float:
    f = footprint_at(uv, height, width)
    value = density[f.i00] * f.w00 + density[f.i01] * f.w01 + density[f.i10] * f.w10 + density[f.i11] * f.w11
    sine = wp.sqrt(d[0] * d[0] + d[2] * d[2])
    return value / (2.0 * PI * PI * wp.max(sine, SINE_MIN))


@wp.func
def _lobe_pdf(n: wp.vec3, v: wp.vec3, l: wp.vec3, a: float, share: float) -> float:
    """(1 - share) cosine + share reflected visible normals, per steradian."""
    n_l = wp.dot(n, l)
    if n_l <= 0.0:
        return 0.0
    pdf = (1.0 - share) * n_l / PI
    if share > 0.0 and n_l > COSINE_MIN:
        n_v = wp.max(wp.dot(n, v), COSINE_MIN)
        h = wp.normalize(v + l)
        across = wp.cross(n, h)
        smith = wp.sqrt(1.0 + a * a * (1.0 / (n_v * n_v) - 1.0))
        pdf += share * ggx(wp.dot(across, across), a * a) / (2.0 * n_v * (1.0 + smith))
    return pdf


@wp.func
def _first_tangent(n: wp.vec3) -> wp.vec3:
    sign = 1.0
    if n[2] < 0.0:
        sign = -1.0
    a = -1.0 / (sign + n[2])
    return wp.vec3(1.0 + sign * n[0] * n[0] * a, sign * n[0] * n[1] * a, -sign * n[0])


@wp.func
def _second_tangent(n: wp.vec3) -> wp.vec3:
    sign = 1.0
    if n[2] < 0.0:
        sign = -1.0
    a = -1.0 / (sign + n[2])
    return wp.vec3(n[0] * n[1] * a, sign + n[1] * n[1] * a, -n[1])


@wp.func
def _sample_lobe(n: wp.vec3, v: wp.vec3, a: float, share: float, p: wp.vec2) -> wp.vec3:
    """A direction of density `_lobe_pdf`; p's first coordinate also chooses the lobe."""
    tangent = _first_tangent(n)
    bitangent = _second_tangent(n)
    if p[0] < share:
        u0 = p[0] / share
        x = wp.dot(v, tangent)
        y = wp.dot(v, bitangent)
        z = wp.max(wp.dot(v, n), COSINE_MIN)
        local = wp.normalize(wp.vec3(x, y, z))
        std = wp.normalize(wp.vec3(local[0] * a, local[1] * a, local[2]))
        phi = 2.0 * PI * u0
        cap = (1.0 - p[1]) * (1.0 + std[2]) - std[2]
        radius = wp.sqrt(wp.max(1.0 - cap * cap, 0.0))
        h = wp.vec3(
            (radius * wp.cos(phi) + std[0]) * a,
            (radius * wp.sin(phi) + std[1]) * a,
            wp.max(cap + std[2], 0.0),
        )
        h = wp.normalize(h)
        l = 2.0 * wp.dot(local, h) * h - local
        return wp.normalize(l[0] * tangent + l[1] * bitangent + l[2] * n)
    u0 = (p[0] - share) / (1.0 - share)
    phi = 2.0 * PI * u0
    radius = wp.sqrt(p[1])
    return wp.normalize(radius * wp.cos(phi) * tangent + radius * wp.sin(phi) * bitangent + wp.sqrt(1.0 - p[1]) * n)


@wp.kernel
def draw_light(
    first: int,
    normal: wp.array(dtype=wp.vec3),
    flat: wp.array(dtype=wp.vec3),
    view: wp.array(dtype=wp.vec3),
    roughness: wp.array(dtype=float),
    share: wp.array(dtype=float),
    pool_direction: wp.array(dtype=wp.vec3),
    pool_pdf: wp.array(dtype=float),
    density: wp.array(dtype=float),
    height: int,
    width: int,
    lobe_points: wp.array(dtype=wp.vec2),
    pool_samples: int,
    own_samples: int,
    blocks: int,
    seed: int,
    turning: int,
    placed: int,
    block: wp.array(dtype=int),
    own_direction: wp.array(dtype=wp.vec3),
    own_uv: wp.array(dtype=wp.vec2),
    weight: wp.array(dtype=float),
):
    """Point `first + tid`: its block of the pool, its own directions (and their places in the environment where they
    are to be `placed`), and 1 / sum_i n_i p_i of each sample above the horizons."""
    i = first + wp.tid()
    n = normal[i]
    g = flat[i]
    v = view[i]
    a = alpha_of(roughness[i])
    q = share[i]
    state = wp.rand_init(seed, i)
    chosen = wp.randi(state, 0, blocks)
    shift = wp.vec2(wp.randf(state), wp.randf(state))
    block[i] = chosen
    samples = pool_samples + own_samples
    for s in range(samples):
        d = wp.vec3(0.0, 1.0, 0.0)
        k = 0
        if s < pool_samples:
            k = chosen * pool_samples + s
            d = pool_direction[k]
        else:
            k = i * own_samples + s - pool_samples
            p = lobe_points[s - pool_samples] + shift
            d = _sample_lobe(n, v, a, q, wp.vec2(p[0] - wp.floor(p[0]), p[1] - wp.floor(p[1])))
            own_direction[k] = d
        w = 0.0
        # a normal that will turn may find light under its present horizon: the pool has samples there
        above = wp.dot(n, d) > COSINE_MIN or (turning != 0 and s < pool_samples)
        if above and wp.dot(g, d) > 0.0:
            mixed = 0.0
            if s < pool_samples:
                mixed = float(pool_samples) * pool_pdf[k]
            else:
                # the only place that finds a direction's place in the map: two arctangents are dear
                uv = wp.vec2(0.0, 0.0)
                if placed != 0 or pool_samples > 0:
                    uv = _uv(d)
                    own_uv[k] = uv
                if pool_samples > 0:
                    mixed = float(pool_samples) * _environment_pdf(d, uv, density, height, width)
            if own_samples > 0:
                mixed += float(own_samples) * _lobe_pdf(n, v, d, a, q)
            if mixed > 0.0:
                w = 1.0 / mixed
        weight[i * samples + s] = w


@wp.kernel
def ray_directions(
    first: int,
    chosen: wp.array(dtype=wp.int64),
    block: wp.array(dtype=int),
    pool_direction: wp.array(dtype=wp.vec3),
    own_direction: wp.array(dtype=wp.vec3),
    pool_samples: int,
    own_samples: int,
    row: wp.array(dtype=int),
    direction: wp.array(dtype=wp.vec3),
):
    """Point and direction of the samples `chosen`, numbered point by point, from `first` on."""
    r = first + wp.tid()
    samples = pool_samples + own_samples
    i = int(chosen[r] / wp.int64(samples))
    s = int(chosen[r] - wp.int64(i) * wp.int64(samples))
    row[r] = i
    if s < pool_samples:
        direction[r] = pool_direction[block[i] * pool_samples + s]
    else:
        direction[r] = own_direction[i * own_samples + s - pool_samples]
