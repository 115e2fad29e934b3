"""Warp kernels that sum light samples to radiance, and their adjoint: one source for CPU and CUDA.

A thread is a surface point and runs over its samples in registers. Formulas as in `shading.brdf`; the adjoint is their
derivative by hand. Imported after Warp has been configured.
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
def footprint_at(uv: wp.vec2, height: int, width: int) -> Footprint:
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
def alpha_of(roughness: float) -> float:
    return wp.max(roughness * roughness, ALPHA_MIN)


@wp.func
def ggx(sine2: float, a2: float) -> float:
    d = a2 + (1.0 - a2) * sine2
    return a2 / (PI * d * d)


@wp.func
def _horizon(specular: int) -> float:
    """n.l up to which no light counts: samples drawn above the normal lie under it once the normal has turned."""
    return wp.where(specular == 1, COSINE_MIN, 0.0)


@wp.kernel
def shade_light(
    first: int,
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
    """Point `first + tid`: sum over its samples of weight E f n.l."""
    i = first + wp.tid()
    n = normal[i]
    v = view[i]
    n_v = wp.dot(n, v)
    diffuse = (1.0 - metallic[i]) / PI * base_color[i]
    f0 = (1.0 - metallic[i]) * wp.vec3(DIELECTRIC_F0, DIELECTRIC_F0, DIELECTRIC_F0) + metallic[i] * base_color[i]
    a = alpha_of(roughness[i])
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
                    t = footprint_at(own_uv[k], height, width)
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
                    scale = ggx(wp.dot(across, across), a2) * 0.5 / (n_l * root_v + n_v * root_l)
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
    a = alpha_of(rough)
    a2 = a * a
    to_normal = wp.vec3(0.0, 0.0, 0.0)
    to_diffuse = wp.vec3(0.0, 0.0, 0.0)
    to_f0 = wp.vec3(0.0, 0.0, 0.0)
    to_a2 = float(0.0)  # noqa: UP018  a Warp constant may not change inside a loop
    horizon = _horizon(specular)
    samples = pool_samples + own_samples
    seen = (specular == 0 or n_v > COSINE_MIN) and (g[0] != 0.0 or g[1] != 0.0 or g[2] != 0.0)
    if seen:
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
                    t = footprint_at(own_uv[k], height, width)
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
                    spread = a2 / (PI * d * d)
                    root_v = wp.sqrt(a2 + (1.0 - a2) * n_v * n_v)
                    root_l = wp.sqrt(a2 + (1.0 - a2) * n_l * n_l)
                    masked = n_l * root_v + n_v * root_l
                    smith = 0.5 / masked
                    scale = spread * smith
                    m = 1.0 - wp.clamp(wp.dot(v, h), 0.0, 1.0)
                    m5 = m * m * m * m * m
                    fresnel = (1.0 - m5) * f0 + wp.vec3(m5, m5, m5)
                    f += scale * fresnel
                    to_f0 += (n_l * scale * (1.0 - m5)) * g_light
                    # chain through D(sine2, a2) and V(n_l, n_v, a2)
                    to_scale = n_l * wp.dot(g_light, fresnel)
                    ggx_a2 = 1.0 / (PI * d * d) - 2.0 * spread * (1.0 - sine2) / d
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
