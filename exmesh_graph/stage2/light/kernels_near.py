"""Warp kernel of the pixels that share rays. CPU only: it calls a native snippet. Import through
`stage2.light.sparse`."""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

wp.set_module_options({"enable_backward": False})

CHUNK = wp.constant(4096)
"""Pixels that one item is for."""

_NEAR = """
    const int begin = chunk * each, end = begin + each < count ? begin + each : count;
    for (int i = begin; i < end; ++i) {
        const int row = place.data[i] / width, column = place.data[i] % width;
        const int down = row % every, right = column % every;
        const bool crossing = down == 0 && right == 0;
        const float y = (float)down / every, x = (float)right / every;
        const float *p = position.data + 3 * (long)i, *f = flat.data + 3 * (long)i, *r = reflected.data + 3 * (long)i;
        const float alpha = roughness.data[i] * roughness.data[i] > least
            ? roughness.data[i] * roughness.data[i] : least;
        for (int k = 0; k < 4; ++k) {
            int there = i;
            float share = 0.f;
            const int a = crossing ? row + (k == 2 ? -every : k == 3 ? every : 0) : row - down + (k / 2) * every;
            const int b = crossing ? column + (k == 0 ? -every : k == 1 ? every : 0)
                                   : column - right + (k % 2) * every;
            const float part = crossing ? 1.f : (k / 2 ? y : 1.f - y) * (k % 2 ? x : 1.f - x);
            if (part > 0.f && a >= 0 && b >= 0 && a < height && b < width) {
                const int j = grid.data[(long)a * width + b];
                if (j >= 0) {
                    const float *q = position.data + 3 * (long)j, *g = flat.data + 3 * (long)j;
                    const float *s = reflected.data + 3 * (long)j;
                    const float dx = p[0] - q[0], dy = p[1] - q[1], dz = p[2] - q[2];
                    const float length = __builtin_sqrtf(dx * dx + dy * dy + dz * dz);
                    const float mine = __builtin_fabsf(dx * f[0] + dy * f[1] + dz * f[2]);
                    const float other = __builtin_fabsf(dx * g[0] + dy * g[1] + dz * g[2]);
                    if ((mine > other ? mine : other) < 0.5f * (length > 1e-12f ? length : 1e-12f)) {
                        const float apart = r[0] * s[0] + r[1] * s[1] + r[2] * s[2] - 1.f;
                        there = j;
                        share = part * expf((apart < 0.f ? apart : 0.f) / (2.f * alpha * alpha));
                    }
                }
            }
            near.data[4 * (long)i + k] = there;
            shares.data[4 * (long)i + k] = share;
        }
    }
"""


@wp.func_native(_NEAR)
def _near(
    chunk: int,
    each: int,
    count: int,
    height: int,
    width: int,
    every: int,
    least: float,
    place: wp.array(dtype=int),
    grid: wp.array(dtype=int),
    position: wp.array(dtype=float),
    flat: wp.array(dtype=float),
    reflected: wp.array(dtype=float),
    roughness: wp.array(dtype=float),
    near: wp.array(dtype=int),
    shares: wp.array(dtype=float),
): ...


@wp.kernel
def find_near(
    first: int,
    count: int,
    height: int,
    width: int,
    every: int,
    least: float,
    place: wp.array(dtype=int),
    grid: wp.array(dtype=int),
    position: wp.array(dtype=float),
    flat: wp.array(dtype=float),
    reflected: wp.array(dtype=float),
    roughness: wp.array(dtype=float),
    near: wp.array(dtype=int),
    shares: wp.array(dtype=float),
):
    """Chunk `first + tid`: `sparse.plain_near` of its pixels; `least`: the smallest alpha."""
    _near(
        first + wp.tid(), CHUNK, count, height, width, every, least, place, grid, position, flat, reflected, roughness,
        near, shares,
    )  # fmt: skip
