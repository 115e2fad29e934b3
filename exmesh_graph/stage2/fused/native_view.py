"""C++ of one view's pixels (kernels_view): radiance and image terms, and their gradient.

    L = (1 - m) a / pi  I  +  k F(R, r) c,   k = A(n.v, r) F0 + B(n.v, r),   F0 = (1 - m) 0.04 + m a

a, r, m: the material; I: irradiance; F: the prefiltered environment at roughness r; c: the measured factor. Tables of
colours have rows of four floats, so that a row is one load.
"""

from exmesh_graph.gpu.simd import MATHS
from exmesh_graph.stage2.fused.corners import CORNERS

#: Floats that `shade_view` keeps of a pixel for `pull_back`: I, F, dF/dr, d log-L1 / dL (3 each), A, B, dA/dr, dB/dr,
#: and for each channel of the material (5) the neighbours below less those above it.
RECORD = 21

COMMON = (
    MATHS
    + CORNERS
    + r"""
    typedef float v4 __attribute__((ext_vector_type(4), aligned(4)));
    auto load4 = [](const float* p) { return *(const v4*)p; };
    const int C = channels, begin = piece * grain, end = begin + grain < count ? begin + grain : count;
    const bool metals = C > 4;
    const float inverse_pi = 0.318309886f;
    int at[8];
    auto own = [&](const float* values, int i) {
        if (i + 8 <= end) return LOAD(values + i);
        vf v;
        for (int j = 0; j < 8; ++j) v[j] = values[at[j]];
        return v;
    };
    auto read = [&](const float* values, int stride, int c) {
        vf v;
        for (int j = 0; j < 8; ++j) v[j] = values[(long)at[j] * stride + c];
        return v;
    };
    // the level above the roughness, the share t of it (the rest is the level below), and 1 / (knots' distance)
    auto between = [&](vf r, vi& upper, vf& t, vf& slope) {
        upper = 1;
        for (int l = 1; l < 7; ++l) upper = r > knots.data[l] ? upper + 1 : upper;
        vf from, to;
        for (int j = 0; j < 8; ++j) {
            from[j] = knots.data[upper[j] - 1];
            to[j] = knots.data[upper[j]];
        }
        slope = 1.f / (to - from);
        t = (r - from) * slope;
        t = t > 0.f ? t : (vf)0.f;
        t = t < 1.f ? t : (vf)1.f;
    };
"""
)

SHADE = (
    COMMON
    + r"""
    const bool shown = image.shape[0] > 0;
    // ln(1 + L) - ln(1 + target), negative light taken as 0; 0 where the photograph is clipped and L is above it
    auto residual = [&](vf L, int c) {
        const vf t = read(target.data, 3, c);
        vf value = vlog1p(L < 0.f ? (vf)0.f : L) - vlog1p(t < 0.f ? (vf)0.f : t);
        vi cut;
        for (int j = 0; j < 8; ++j) cut[j] = clipped.data[(long)at[j] * 3 + c] ? -1 : 0;
        return (cut & (value > 0.f)) ? (vf)0.f : value;
    };
    vd loss = 0.0;
    double variation = 0.0;
    for (int i = begin; i < end; i += 8) {
        const int lanes = end - i < 8 ? end - i : 8;
        vf alive;
        for (int j = 0; j < 8; ++j) {
            at[j] = j < lanes ? i + j : end - 1;
            alive[j] = j < lanes ? 1.f : 0.f;
        }
        const vf r = read(material.data, C, 3), m = metals ? read(material.data, C, 4) : (vf)0.f;
        vi upper;
        vf t, slope, w[2][4];
        vi row[2][4];
        between(r, upper, t, slope);
        const vf u = own(env_u.data, i), v = own(env_v.data, i);
        corners(upper - 1, u, v, row[0], w[0]);
        corners(upper, u, v, row[1], w[1]);
        // A and B bilinear in (n.v, r) on 64 x 64; none beyond the outer centres
        vf x = own(n_v.data, i) * 64.f - 0.5f, y = r * 64.f - 0.5f;
        x = x > 0.f ? x : (vf)0.f;
        x = x < 62.999f ? x : (vf)62.999f;
        const vi inside = (y >= 0.f) & (y <= 62.999f);
        y = y > 0.f ? y : (vf)0.f;
        y = y < 62.999f ? y : (vf)62.999f;
        const vf x0 = __builtin_elementwise_floor(x), y0 = __builtin_elementwise_floor(y), fx = x - x0, fy = y - y0;
        const vi cell = __builtin_convertvector(x0 * 64.f + y0, vi);
        vf I[3], F[3], dF[3], A, B, dA, dB;
        for (int j = 0; j < 8; ++j) {
            const long n = at[j];
            v4 arriving = 0.f, low = 0.f, high = 0.f;
            for (int k = 0; k < 3; ++k)
                arriving += point_weight.data[3 * n + k] * load4(irradiance.data + 4 * (long)point.data[3 * n + k]);
            for (int s = 0; s < suns; ++s) arriving += transfer.data[n * suns + s] * load4(flux.data + 4 * s);
            for (int k = 0; k < 4; ++k) {
                low += w[0][k][j] * load4(stack.data + 4 * (long)row[0][k][j]);
                high += w[1][k][j] * load4(stack.data + 4 * (long)row[1][k][j]);
            }
            const v4 mean = low + t[j] * (high - low), rise = (high - low) * slope[j];
            for (int c = 0; c < 3; ++c) {
                I[c][j] = arriving[c];
                F[c][j] = mean[c];
                dF[c][j] = rise[c];
            }
            const v4 near = load4(table.data + 2 * cell[j]), far = load4(table.data + 2 * (cell[j] + 64));
            const v4 ab = near + fx[j] * (far - near);  // A, B at y0, A, B at y0 + 1
            A[j] = ab[0] + fy[j] * (ab[2] - ab[0]);
            B[j] = ab[1] + fy[j] * (ab[3] - ab[1]);
            dA[j] = inside[j] ? 64.f * (ab[2] - ab[0]) : 0.f;
            dB[j] = inside[j] ? 64.f * (ab[3] - ab[1]) : 0.f;
        }
        float* kept = record.data + (long)i * 21;
        const vf cover = alive * own(coverage.data, i);
        for (int c = 0; c < 3; ++c) {
            const vf a = read(material.data, C, c), f0 = 0.04f * (1.f - m) + m * a;
            const vf diffuse = a * (1.f - m) * inverse_pi * I[c];
            const vf L = exposure * (diffuse + (A * f0 + B) * F[c] * read(scale.data, 3, c));
            const vf miss = residual(L, c);
            loss += __builtin_convertvector(cover * (miss < 0.f ? -miss : miss), vd);
            const vf rise = cover / (1.f + L), signed_rise = miss < 0.f ? -rise : miss > 0.f ? rise : miss;
            STORE(kept + 8 * (9 + c), L >= 0.f ? signed_rise : (vf)0.f);
            for (int j = 0; j < lanes; ++j) predicted.data[(long)at[j] * 3 + c] = L[j];
            if (shown) {
                vf s = L > 0.f ? L : (vf)0.f;
                s = s < 1.f ? s : (vf)1.f;
                const vf power = 1.055f * vexp(vlog(s > 0.0031308f ? s : (vf)0.0031308f) * (1.f / 2.4f)) - 0.055f;
                s = s <= 0.0031308f ? 12.92f * s : power;
                for (int j = 0; j < lanes; ++j) image.data[3 * (long)box_pixel.data[at[j]] + c] = s[j];
            }
        }
        for (int c = 0; c < 3; ++c) {
            STORE(kept + 8 * c, I[c]);
            STORE(kept + 8 * (3 + c), F[c]);
            STORE(kept + 8 * (6 + c), dF[c]);
        }
        STORE(kept + 96, A);
        STORE(kept + 104, B);
        STORE(kept + 112, dA);
        STORE(kept + 120, dB);
        // |step| to each neighbour (a missing one is the pixel itself); each pair is met from both sides
        for (int j = 0; j < lanes; ++j) {
            const int* beside = neighbours.data + 4 * (long)at[j];
            const float* here = material.data + (long)at[j] * C;
            v4 way = 0.f, far = 0.f;
            float way_m = 0.f, far_m = 0.f;
            for (int k = 0; k < 4; ++k) {
                const float* there = material.data + (long)beside[k] * C;
                v4 step = load4(here) - load4(there);
                way += __builtin_convertvector(step < 0.f, v4) - __builtin_convertvector(step > 0.f, v4);
                if (floor > 0.f) {  // of the logarithm: in the same direction
                    vf pair = 1.f;
                    for (int c = 0; c < 3; ++c) {
                        pair[c] = here[c] + floor;
                        pair[4 + c] = there[c] + floor;
                    }
                    pair = vlog(pair);
                    for (int c = 0; c < 3; ++c) step[c] = pair[c] - pair[4 + c];
                }
                far += step < 0.f ? -step : step;
                if (!metals) continue;
                const float step_m = here[4] - there[4];
                way_m += step_m > 0.f ? 1.f : step_m < 0.f ? -1.f : 0.f;
                far_m += step_m < 0.f ? -step_m : step_m;
            }
            for (int c = 0; c < 3; ++c) kept[8 * (16 + c) + j] = floor > 0.f ? way[c] / (here[c] + floor) : way[c];
            kept[8 * 19 + j] = gloss * way[3];
            kept[8 * 20 + j] = gloss * way_m;
            variation += far[0] + far[1] + far[2] + gloss * (far[3] + far_m);
        }
    }
    sums.data[2 * piece] = total(loss);
    sums.data[2 * piece + 1] = variation;
"""
)

PULL_BACK = (
    COMMON
    + r"""
    const bool shown = image_gradient.shape[0] > 0, sky = to_stack.shape[0] > 0;
    float* arriving = to_irradiance.data + 4 * (long)piece * points;
    float* leaving = to_stack.data + 4 * (long)piece * rows;
    float* sunny = to_flux.data + 4 * (long)piece * suns;
    for (long i = 0; i < 4 * (long)points; ++i) arriving[i] = 0.f;
    for (long i = 0; sky && i < 4 * (long)rows; ++i) leaving[i] = 0.f;
    for (int i = 0; i < 4 * suns; ++i) sunny[i] = 0.f;
    for (int i = begin; i < end; i += 8) {
        const int lanes = end - i < 8 ? end - i : 8;
        for (int j = 0; j < 8; ++j) at[j] = j < lanes ? i + j : end - 1;
        const float* kept = record.data + (long)i * 21;
        const vf A = LOAD(kept + 96), B = LOAD(kept + 104), dA = LOAD(kept + 112), dB = LOAD(kept + 120);
        const vf r = read(material.data, C, 3), m = metals ? read(material.data, C, 4) : (vf)0.f;
        vf to[5] = {0.f, 0.f, 0.f, 0.f, 0.f}, to_I[3], to_F[3];
        for (int c = 0; c < 3; ++c) {
            const vf L = read(predicted.data, 3, c);
            vf g = image_weight * LOAD(kept + 8 * (9 + c));
            if (shown) {
                vf by;
                for (int j = 0; j < 8; ++j) by[j] = image_gradient.data[3 * (long)box_pixel.data[at[j]] + c];
                // of the display curve, constant outside [0, 1]
                const vf s = L > 0.0031308f ? L : (vf)0.0031308f;
                const vf rise = 1.055f / 2.4f * vexp(vlog(s) * (1.f / 2.4f - 1.f));
                by *= L > 0.0031308f ? rise : (vf)12.92f;
                by *= ssim_weight;
                g += ((L >= 0.f) & (L <= 1.f)) ? by : (vf)0.f;
            }
            g *= exposure;
            const vf a = read(material.data, C, c), f0 = 0.04f * (1.f - m) + m * a;
            const vf I = LOAD(kept + 8 * c), F = LOAD(kept + 8 * (3 + c)), dF = LOAD(kept + 8 * (6 + c));
            const vf k = A * f0 + B, coat = g * read(scale.data, 3, c);
            to[c] = g * (1.f - m) * inverse_pi * I + coat * A * m * F;
            to[3] += coat * ((dA * f0 + dB) * F + k * dF);
            to[4] += coat * A * (a - 0.04f) * F - g * a * inverse_pi * I;
            to_I[c] = g * a * (1.f - m) * inverse_pi;
            to_F[c] = coat * k;
        }
        for (int c = 0; variation_weight != 0.f && c < C; ++c) to[c] += variation_weight * LOAD(kept + 8 * (16 + c));
        for (int j = 0; j < lanes; ++j)
            for (int c = 0; c < C; ++c) to_material.data[(long)at[j] * C + c] = to[c][j];
        vi upper;
        vf t, slope, w[2][4];
        vi row[2][4];
        between(r, upper, t, slope);
        if (sky) {
            const vf u = own(env_u.data, i), v = own(env_v.data, i);
            corners(upper - 1, u, v, row[0], w[0]);
            corners(upper, u, v, row[1], w[1]);
        }
        for (int j = 0; j < lanes; ++j) {
            const long n = at[j];
            const v4 g = {to_I[0][j], to_I[1][j], to_I[2][j], 0.f}, h = {to_F[0][j], to_F[1][j], to_F[2][j], 0.f};
            for (int k = 0; k < 3; ++k)
                *(v4*)(arriving + 4 * (long)point.data[3 * n + k]) += point_weight.data[3 * n + k] * g;
            for (int s = 0; s < suns; ++s) *(v4*)(sunny + 4 * s) += transfer.data[n * suns + s] * g;
            if (!sky) continue;
            for (int k = 0; k < 4; ++k) {
                *(v4*)(leaving + 4 * (long)row[0][k][j]) += (1.f - t[j]) * w[0][k][j] * h;
                *(v4*)(leaving + 4 * (long)row[1][k][j]) += t[j] * w[1][k][j] * h;
            }
        }
    }
"""
)

ADD_PIECES = (
    MATHS
    + r"""
    const long begin = (long)item * grain, end = begin + grain < size ? begin + grain : size;
    for (long i = begin; i < end; i += 8) {
        vf sum = LOAD(values.data + i);
        for (int k = 1; k < pieces; ++k) sum += LOAD(values.data + k * (long)size + i);
        STORE(values.data + i, sum);
    }
"""
)
