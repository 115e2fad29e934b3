"""C++ of rays towards small suns (kernels_suns): eight points side by side, sample after sample, sun after sun."""

from exmesh_graph.gpu.simd import CIRCLE, GROUPS, MATHS

AIM = (
    MATHS
    + CIRCLE
    + GROUPS
    + r"""
    const int K = first.shape[0] - 1;
    // a number in [-1, 1] with density 1 - |x| (shading.env_sampling.tent)
    auto tent = [&](vf x) {
        const vf low = 2.f * x, high = 2.f * (1.f - x);
        return x < 0.5f ? root(low > 0.f ? low : (vf)0.f) - 1.f : 1.f - root(high > 0.f ? high : (vf)0.f);
    };
    auto wrap = [](vf x) { return x - __builtin_elementwise_floor(x); };
    for (int g = begin; g < end; ++g) {
        for (int j = 0; j < 8; ++j) at[j] = 8 * g + j < count ? 8 * g + j : count - 1;
        const vf nx = read(normal.data, 3, 0), ny = read(normal.data, 3, 1), nz = read(normal.data, 3, 2);
        const vf gx = read(flat.data, 3, 0), gy = read(flat.data, 3, 1), gz = read(flat.data, 3, 2);
        for (int s = 0; s < S; ++s) {
            const vf pick = wrap(grid.data[3 * s] + read(shift.data, 3, 0));
            const vf dy = tent(wrap(grid.data[3 * s + 1] + read(shift.data, 3, 1)));
            const vf dx = tent(wrap(grid.data[3 * s + 2] + read(shift.data, 3, 2)));
            for (int k = 0; k < K; ++k) {
                vf row, column;
                for (int j = 0; j < 8; ++j) {
                    int t = first.data[k];
                    while (t < first.data[k + 1] - 1 && cumulated.data[t] < pick[j]) ++t;
                    row[j] = (float)(texel.data[t] / width);
                    column[j] = (float)(texel.data[t] % width);
                }
                // what a tent throws over a pole folds back
                const vf whole = (float)height;
                vf y = row + 0.5f + dy;
                y = y < 0.f ? -y : y;
                y = y > whole ? 2.f * whole - y : y;
                vf sine, cosine, across, along;
                circle(y / (2.f * whole), sine, cosine);
                circle(wrap((column + 0.5f + dx) / (float)width), across, along);
                const vf wx = sine * across, wz = -sine * along, wy = cosine;
                const vf n_l = wx * nx + wy * ny + wz * nz;
                const vi lit = (n_l > 0.f) & (wx * gx + wy * gy + wz * gz > 0.f);
                const long ray = (((long)g * S + s) * K + k) * 8;
                STORE(seen.data + ray, lit ? n_l : (vf)0.f);
                float* to = direction.data + 3 * ray;
                for (int j = 0; j < 8; ++j) {
                    to[3 * j] = wx[j];
                    to[3 * j + 1] = wy[j];
                    to[3 * j + 2] = wz[j];
                }
            }
        }
        for (int j = count - 8 * g; j < 8; ++j)
            for (long ray = 0; ray < S * K; ++ray) seen.data[((long)g * S * K + ray) * 8 + j] = 0.f;
    }
"""
)

REFLECT = (
    MATHS
    + GROUPS
    + r"""
    const int K = flux.shape[0] / 3;
    for (int g = begin; g < end; ++g) {
        for (int j = 0; j < 8; ++j) at[j] = 8 * g + j < count ? 8 * g + j : count - 1;
        const vf nx = read(normal.data, 3, 0), ny = read(normal.data, 3, 1), nz = read(normal.data, 3, 2);
        const vf vx = read(view.data, 3, 0), vy = read(view.data, 3, 1), vz = read(view.data, 3, 2);
        const vf r = read(roughness.data, 1, 0), n_v = nx * vx + ny * vy + nz * vz;
        const vf a = r * r > 3.6e-4f ? r * r : (vf)3.6e-4f, a2 = a * a, b2 = 1.f - a2;
        const vf masked = root(a2 + b2 * n_v * n_v);
        vf f_d[3], f_0[3], sum[3] = {0.f, 0.f, 0.f};
        for (int c = 0; c < 3; ++c) {
            f_d[c] = read(diffuse.data, 3, c);
            f_0[c] = read(f0.data, 3, c);
        }
        for (int s = 0; s < S; ++s)
            for (int k = 0; k < K; ++k) {
                const long ray = (((long)g * S + s) * K + k) * 8;
                const vf cosine = LOAD(seen.data + ray);
                float any = 0.f;
                for (int j = 0; j < 8; ++j) any += cosine[j];
                if (any == 0.f) continue;
                vf wx, wy, wz;
                for (int j = 0; j < 8; ++j) {
                    wx[j] = direction.data[3 * (ray + j)];
                    wy[j] = direction.data[3 * (ray + j) + 1];
                    wz[j] = direction.data[3 * (ray + j) + 2];
                }
                const vf n_l = wx * nx + wy * ny + wz * nz;
                vf hx = vx + wx, hy = vy + wy, hz = vz + wz;
                const vf squared = hx * hx + hy * hy + hz * hz, size = root(squared > 1e-20f ? squared : (vf)1e-20f);
                hx /= size;
                hy /= size;
                hz /= size;
                // sin^2 of the half vector by its cross product with the normal: a narrow lobe needs its digits
                const vf x = ny * hz - nz * hy, y = nz * hx - nx * hz, z = nx * hy - ny * hx;
                const vf d = a2 + b2 * (x * x + y * y + z * z);
                const vf V = 0.5f / (n_l * masked + n_v * root(a2 + b2 * n_l * n_l));
                const vi shines = (n_l > 1e-4f) & (n_v > 1e-4f) & (a >= least);
                const vf f_s = shines ? a2 / (3.14159265f * d * d) * V : (vf)0.f;
                vf missing = 1.f - (vx * hx + vy * hy + vz * hz);
                missing = missing > 0.f ? missing : (vf)0.f;
                missing = missing < 1.f ? missing : (vf)1.f;
                const vf m2 = missing * missing, p = m2 * m2 * missing;
                for (int c = 0; c < 3; ++c)
                    sum[c] += (f_d[c] + f_s * (f_0[c] + (1.f - f_0[c]) * p)) * cosine * flux.data[3 * k + c];
            }
        for (int j = 0; j < 8 && 8 * g + j < count; ++j)
            for (int c = 0; c < 3; ++c) result.data[3 * (long)at[j] + c] = sum[c][j] / (float)S;
    }
"""
)
