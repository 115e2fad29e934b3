"""Warp kernels of the Monte Carlo light: one source for CPU and CUDA. Import through `shade.kernels`.

A thread is a surface point and runs over its samples in registers: nothing per sample is written but a direction and a
weight. Formulas as in `shading.brdf` and `shading.sampling`; the adjoint below is their derivative by hand.
"""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

from exmesh_graph.shading import brdf

wp.set_module_options({"enable_backward": False})

PI = wp.constant(3.14159265358979)
ALPHA_MIN = wp.constant(brdf.ALPHA_MIN)
COSINE_MIN = wp.constant(brdf.COSINE_MIN)
DIELECTRIC_F0 = wp.constant(brdf.DIELECTRIC_F0)
SINE_MIN = wp.constant(1.0e-7)


@wp.struct
class Footprint:
    i00: int
    i01: int
    i10: int
    i11: int
    w00: float
    w01: float
    w10: float
    w11: float


@wp.func
def _uv(d: wp.vec3) -> wp.vec2:
    """Image coordinates of direction d, as `envmap.uv_of`."""
    u = 0.5 - wp.atan2(d[0], d[2]) / (2.0 * PI)
    return wp.vec2(u, wp.atan2(wp.sqrt(d[0] * d[0] + d[2] * d[2]), d[1]) / PI)


@wp.func
def _footprint(uv: wp.vec2, height: int, width: int) -> Footprint:
    """The four texels of `envmap.bilinear` under image coordinates uv."""
    x = uv[0] * float(width) - 0.5
    y = wp.clamp(uv[1] * float(height) - 0.5, 0.0, float(height - 1))
    x0 = wp.floor(x)
    y0 = wp.min(wp.floor(y), float(wp.max(height - 2, 0)))
    fx = x - x0
    fy = y - y0
    left = int(x0)
    if left < 0:
        left += width
    if left >= width:
        left -= width
    right = left + 1
    if right == width:
        right = 0
    top = int(y0)
    bottom = wp.min(top + 1, height - 1)
    f = Footprint()
    f.i00 = top * width + left
    f.i01 = top * width + right
    f.i10 = bottom * width + left
    f.i11 = bottom * width + right
    f.w00 = (1.0 - fx) * (1.0 - fy)
    f.w01 = fx * (1.0 - fy)
    f.w10 = (1.0 - fx) * fy
    f.w11 = fx * fy
    return f


@wp.func
def _environment_pdf(d: wp.vec3, uv: wp.vec2, density: wp.array(dtype=float), height: int, width: int) -> float:
    f = _footprint(uv, height, width)
    value = density[f.i00] * f.w00 + density[f.i01] * f.w01 + density[f.i10] * f.w10 + density[f.i11] * f.w11
    sine = wp.sqrt(d[0] * d[0] + d[2] * d[2])
    return value / (2.0 * PI * PI * wp.max(sine, SINE_MIN))


@wp.func
def _alpha(roughness: float) -> float:
    return wp.max(roughness * roughness, ALPHA_MIN)


@wp.func
def _ggx(sine2: float, a2: float) -> float:
    d = a2 + (1.0 - a2) * sine2
    return a2 / (PI * d * d)


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
        pdf += share * _ggx(wp.dot(across, across), a * a) / (2.0 * n_v * (1.0 + smith))
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
    block: wp.array(dtype=int),
    own_direction: wp.array(dtype=wp.vec3),
    own_uv: wp.array(dtype=wp.vec2),
    weight: wp.array(dtype=float),
):
    """Per point: its block of the pool, its own directions, and 1 / sum_i n_i p_i of each sample above the horizons."""
    i = wp.tid()
    n = normal[i]
    g = flat[i]
    v = view[i]
    a = _alpha(roughness[i])
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
        lit = wp.dot(n, d) > COSINE_MIN or (turning != 0 and s < pool_samples)
        if lit and wp.dot(g, d) > 0.0:
            mixed = 0.0
            if s < pool_samples:
                mixed = float(pool_samples) * pool_pdf[k]
            else:
                # the only place that finds a direction's place in the map: two arctangents are dear
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
    chosen: wp.array(dtype=wp.int64),
    block: wp.array(dtype=int),
    pool_direction: wp.array(dtype=wp.vec3),
    own_direction: wp.array(dtype=wp.vec3),
    pool_samples: int,
    own_samples: int,
    row: wp.array(dtype=int),
    direction: wp.array(dtype=wp.vec3),
):
    """Point and direction of the samples `chosen`, numbered point by point."""
    r = wp.tid()
    samples = pool_samples + own_samples
    i = int(chosen[r] / wp.int64(samples))
    s = int(chosen[r] - wp.int64(i) * wp.int64(samples))
    row[r] = i
    if s < pool_samples:
        direction[r] = pool_direction[block[i] * pool_samples + s]
    else:
        direction[r] = own_direction[i * own_samples + s - pool_samples]


@wp.func
def _horizon(specular: int) -> float:
    """n.l up to which no light counts: samples drawn above the normal lie under it once the normal has turned."""
    return wp.where(specular == 1, COSINE_MIN, 0.0)


@wp.kernel
def shade_light(
    normal: wp.array(dtype=wp.vec3),
    view: wp.array(dtype=wp.vec3),
    base_color: wp.array(dtype=wp.vec3),
    roughness: wp.array(dtype=float),
    metallic: wp.array(dtype=float),
    specular: int,
    pool_direction: wp.array(dtype=wp.vec3),
    pool_radiance: wp.array(dtype=wp.vec3),
    block: wp.array(dtype=int),
    own_direction: wp.array(dtype=wp.vec3),
    own_uv: wp.array(dtype=wp.vec2),
    weight: wp.array(dtype=float),
    environment: wp.array(dtype=wp.vec3),
    height: int,
    width: int,
    pool_samples: int,
    own_samples: int,
    out: wp.array(dtype=wp.vec3),
):
    """Per point: sum over its samples of weight E f n.l."""
    i = wp.tid()
    n = normal[i]
    v = view[i]
    n_v = wp.dot(n, v)
    diffuse = (1.0 - metallic[i]) / PI * base_color[i]
    f0 = (1.0 - metallic[i]) * wp.vec3(DIELECTRIC_F0, DIELECTRIC_F0, DIELECTRIC_F0) + metallic[i] * base_color[i]
    a = _alpha(roughness[i])
    a2 = a * a
    total = wp.vec3(0.0, 0.0, 0.0)
    horizon = _horizon(specular)
    samples = pool_samples + own_samples
    if specular == 0 or n_v > COSINE_MIN:
        for s in range(samples):
            w = weight[i * samples + s]
            if w > 0.0:
                l = wp.vec3(0.0, 1.0, 0.0)
                radiance = wp.vec3(0.0, 0.0, 0.0)
                if s < pool_samples:
                    k = block[i] * pool_samples + s
                    l = pool_direction[k]
                    radiance = pool_radiance[k]
                else:
                    k = i * own_samples + s - pool_samples
                    l = own_direction[k]
                    t = _footprint(own_uv[k], height, width)
                    radiance = (
                        t.w00 * environment[t.i00]
                        + t.w01 * environment[t.i01]
                        + t.w10 * environment[t.i10]
                        + t.w11 * environment[t.i11]
                    )
                n_l = wp.dot(n, l)
                if n_l <= horizon:
                    continue
                f = diffuse
                if specular == 1:
                    h = v + l
                    h = h / wp.sqrt(wp.max(wp.dot(h, h), 1.0e-20))
                    across = wp.cross(n, h)
                    root_v = wp.sqrt(a2 + (1.0 - a2) * n_v * n_v)
                    root_l = wp.sqrt(a2 + (1.0 - a2) * n_l * n_l)
                    scale = _ggx(wp.dot(across, across), a2) * 0.5 / (n_l * root_v + n_v * root_l)
                    m = 1.0 - wp.clamp(wp.dot(v, h), 0.0, 1.0)
                    m5 = m * m * m * m * m
                    f += scale * ((1.0 - m5) * f0 + wp.vec3(m5, m5, m5))
                total += (w * n_l) * wp.cw_mul(f, radiance)
    out[i] = total


@wp.kernel
def shade_light_adjoint(
    normal: wp.array(dtype=wp.vec3),
    view: wp.array(dtype=wp.vec3),
    base_color: wp.array(dtype=wp.vec3),
    roughness: wp.array(dtype=float),
    metallic: wp.array(dtype=float),
    specular: int,
    pool_direction: wp.array(dtype=wp.vec3),
    pool_radiance: wp.array(dtype=wp.vec3),
    block: wp.array(dtype=int),
    own_direction: wp.array(dtype=wp.vec3),
    own_uv: wp.array(dtype=wp.vec2),
    weight: wp.array(dtype=float),
    environment: wp.array(dtype=wp.vec3),
    height: int,
    width: int,
    pool_samples: int,
    own_samples: int,
    grad: wp.array(dtype=wp.vec3),
    with_environment: int,
    grad_normal: wp.array(dtype=wp.vec3),
    grad_base: wp.array(dtype=wp.vec3),
    grad_roughness: wp.array(dtype=float),
    grad_metallic: wp.array(dtype=float),
    grad_pool: wp.array(dtype=wp.vec3),
    grad_environment: wp.array(dtype=wp.vec3),
):
    """Vector-Jacobian product of `shade_light`; adds to grad_pool and grad_environment."""
    i = wp.tid()
    g = grad[i]
    n = normal[i]
    v = view[i]
    n_v = wp.dot(n, v)
    base = base_color[i]
    metal = metallic[i]
    diffuse = (1.0 - metal) / PI * base
    dielectric = wp.vec3(DIELECTRIC_F0, DIELECTRIC_F0, DIELECTRIC_F0)
    f0 = (1.0 - metal) * dielectric + metal * base
    rough = roughness[i]
    a = _alpha(rough)
    a2 = a * a
    to_normal = wp.vec3(0.0, 0.0, 0.0)
    to_diffuse = wp.vec3(0.0, 0.0, 0.0)
    to_f0 = wp.vec3(0.0, 0.0, 0.0)
    to_a2 = float(0.0)  # noqa: UP018  a Warp constant may not change inside a loop
    horizon = _horizon(specular)
    samples = pool_samples + own_samples
    lit = (specular == 0 or n_v > COSINE_MIN) and (g[0] != 0.0 or g[1] != 0.0 or g[2] != 0.0)
    if lit:
        for s in range(samples):
            w = weight[i * samples + s]
            if w > 0.0:
                l = wp.vec3(0.0, 1.0, 0.0)
                radiance = wp.vec3(0.0, 0.0, 0.0)
                k = 0
                t = Footprint()
                if s < pool_samples:
                    k = block[i] * pool_samples + s
                    l = pool_direction[k]
                    radiance = pool_radiance[k]
                else:
                    k = i * own_samples + s - pool_samples
                    l = own_direction[k]
                    t = _footprint(own_uv[k], height, width)
                    radiance = (
                        t.w00 * environment[t.i00]
                        + t.w01 * environment[t.i01]
                        + t.w10 * environment[t.i10]
                        + t.w11 * environment[t.i11]
                    )
                n_l = wp.dot(n, l)
                if n_l <= horizon:
                    continue
                f = diffuse
                g_light = w * wp.cw_mul(g, radiance)
                if specular == 1:
                    h = v + l
                    h = h / wp.sqrt(wp.max(wp.dot(h, h), 1.0e-20))
                    across = wp.cross(n, h)
                    sine2 = wp.dot(across, across)
                    d = a2 + (1.0 - a2) * sine2
                    ggx = a2 / (PI * d * d)
                    root_v = wp.sqrt(a2 + (1.0 - a2) * n_v * n_v)
                    root_l = wp.sqrt(a2 + (1.0 - a2) * n_l * n_l)
                    masked = n_l * root_v + n_v * root_l
                    smith = 0.5 / masked
                    scale = ggx * smith
                    m = 1.0 - wp.clamp(wp.dot(v, h), 0.0, 1.0)
                    m5 = m * m * m * m * m
                    fresnel = (1.0 - m5) * f0 + wp.vec3(m5, m5, m5)
                    f += scale * fresnel
                    to_f0 += (n_l * scale * (1.0 - m5)) * g_light
                    # chain through D(sine2, a2) and V(n_l, n_v, a2)
                    to_scale = n_l * wp.dot(g_light, fresnel)
                    ggx_a2 = 1.0 / (PI * d * d) - 2.0 * ggx * (1.0 - sine2) / d
                    masked_a2 = 0.5 * (n_l * (1.0 - n_v * n_v) / root_v + n_v * (1.0 - n_l * n_l) / root_l)
                    to_a2 += to_scale * (ggx_a2 * smith - scale / masked * masked_a2)
                    to_masked = -to_scale * scale / masked
                    to_nl = to_masked * (root_v + n_v * (1.0 - a2) * n_l / root_l)
                    to_nv = to_masked * (root_l + n_l * (1.0 - a2) * n_v / root_v)
                    to_sine2 = -2.0 * to_scale * scale * (1.0 - a2) / d
                    to_normal += to_nl * l + to_nv * v + (2.0 * to_sine2) * (n - wp.dot(n, h) * h)
                to_diffuse += n_l * g_light
                to_normal += wp.dot(g_light, f) * l
                if with_environment == 1:
                    to_light = (w * n_l) * wp.cw_mul(g, f)
                    if s < pool_samples:
                        wp.atomic_add(grad_pool, k, to_light)
                    else:
                        wp.atomic_add(grad_environment, t.i00, t.w00 * to_light)
                        wp.atomic_add(grad_environment, t.i01, t.w01 * to_light)
                        wp.atomic_add(grad_environment, t.i10, t.w10 * to_light)
                        wp.atomic_add(grad_environment, t.i11, t.w11 * to_light)
    grad_normal[i] = to_normal
    grad_base[i] = (1.0 - metal) / PI * to_diffuse + metal * to_f0
    grad_metallic[i] = -wp.dot(base, to_diffuse) / PI + wp.dot(base - dielectric, to_f0)
    to_rough = 0.0
    if rough * rough >= ALPHA_MIN:
        to_rough = to_a2 * 4.0 * rough * rough * rough
    grad_roughness[i] = to_rough
