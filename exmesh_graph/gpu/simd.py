"""Explicit vectors for kernels written in C++ (`warp.func_native`), on a CPU.

Warp's compiler knows the processor but leaves loops scalar; clang's vector types do not depend on it. Plain loops took
2.6 times as long in SSIM. Vectors have 8 lanes whatever the processor is: one AVX register, or two of NEON or SSE.
"""

LANES = 8

PRELUDE = f"""
    constexpr int LANES = {LANES};
    typedef float vf __attribute__((ext_vector_type({LANES}), aligned(4)));
#define LOAD(p) (*(const vf*)(p))
#define STORE(p, v) (*(vf*)(p) = (v))
"""
"""At the head of a snippet: `vf` is a vector of floats, LOAD and STORE take any address of a float."""

MATHS = (
    PRELUDE
    + r"""
    typedef double vd __attribute__((ext_vector_type(8), aligned(8)));
    typedef int vi __attribute__((ext_vector_type(8), aligned(4)));
    auto total = [](vd v) { double s = 0.0; for (int j = 0; j < 8; ++j) s += v[j]; return s; };
    // e^x = 2^n e^r, |r| <= ln 2 / 2
    auto vexp = [](vf x) {
        x = x < -87.f ? (vf)-87.f : x;
        x = x > 87.f ? (vf)87.f : x;
        const vf n = __builtin_elementwise_floor(x * 1.44269504f + 0.5f);
        const vf r = x - n * 0.693359375f + n * 2.12194440e-4f;
        vf p = 1.f / 5040;
        p = p * r + 1.f / 720;
        p = p * r + 1.f / 120;
        p = p * r + 1.f / 24;
        p = p * r + 1.f / 6;
        p = p * r + 0.5f;
        p = p * r + 1.f;
        p = p * r + 1.f;
        return p * (vf)((__builtin_convertvector(n, vi) + 127) << 23);
    };
    // ln x = e ln 2 + 2 artanh(s), s = (m - 1) / (m + 1), x = 2^e m, m in [sqrt 1/2, sqrt 2]; x a normal number > 0
    auto vlog = [](vf x) {
        const vi bits = (vi)x;
        const vi e = (bits - 0x3f3504f3) >> 23;
        const vf m = (vf)(bits - (e << 23));
        const vf s = (m - 1.f) / (m + 1.f), z = s * s;
        vf p = 2.f / 9;
        p = p * z + 2.f / 7;
        p = p * z + 2.f / 5;
        p = p * z + 2.f / 3;
        p = p * z + 2.f;
        return s * p + __builtin_convertvector(e, vf) * 0.69314718f;
    };
    // ln(1 + x) for x >= 0, to the last digits of a small x too
    auto vlog1p = [&](vf x) {
        const vf u = 1.f + x;
        return x < 1e30f ? vlog(u) + (x - (u - 1.f)) / u : x;
    };
    auto sigmoid = [&](vf x) {
        const vf e = vexp(x < 0.f ? x : -x), t = 1.f / (1.f + e);
        return x < 0.f ? e * t : t;
    };
"""
)
"""`PRELUDE`, and functions of vectors. `vexp` and `vlog` are Taylor's series on a reduced argument, within 2e-7 of the
exact value (relative; of the logarithm absolute where it is below 1). What is not a number comes out of `vlog1p` as
such."""


CIRCLE = r"""
    // sine and cosine of 2 pi x, x in [0, 1], of the rest of x after quarters of the circle
    auto circle = [](vf x, vf& sine, vf& cosine) {
        const vf quarter = __builtin_elementwise_floor(4.f * x + 0.5f);
        const vf t = 6.28318531f * (x - 0.25f * quarter), tt = t * t;
        vf s = 1.f / 362880, c = -1.f / 3628800;
        s = s * tt - 1.f / 5040;
        s = s * tt + 1.f / 120;
        s = s * tt - 1.f / 6;
        s = s * tt * t + t;
        c = c * tt + 1.f / 40320;
        c = c * tt - 1.f / 720;
        c = c * tt + 1.f / 24;
        c = c * tt - 0.5f;
        c = c * tt + 1.f;
        const vi q = __builtin_convertvector(quarter, vi);
        const vi odd = (q & 1) == 1;
        cosine = odd ? s : c;
        sine = odd ? c : s;
        cosine = (((q + 1) & 2) == 2) ? -cosine : cosine;
        sine = ((q & 2) == 2) ? -sine : sine;
    };
"""
"""After `MATHS`: `circle`, sine and cosine by their series on an eighth of the circle, within 3e-7."""

GROUPS = r"""
    const int S = samples, all = (count + 7) / 8, begin = item * groups;
    const int end = begin + groups < all ? begin + groups : all;
    int at[8];
    auto read = [&](const float* values, int stride, int c) {
        vf v;
        for (int j = 0; j < 8; ++j) v[j] = values[(long)at[j] * stride + c];
        return v;
    };
    auto root = [](vf x) { return __builtin_elementwise_sqrt(x); };
"""
"""After `MATHS`: an item's groups of eight points, of `count` in all, whose numbers are to be put in `at`; `read`."""


def padded(count: int) -> int:
    """`count` floats rounded up to whole vectors."""
    return -(-count // LANES) * LANES
