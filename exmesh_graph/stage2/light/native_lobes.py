"""C++ of traced lobes (kernels_lobes): eight points side by side, sample after sample."""

from exmesh_graph.gpu.simd import CIRCLE, GROUPS, MATHS, PRELUDE
from exmesh_graph.stage2.fused.corners import CORNERS

MAKE_RAYS = (
    MATHS
    + CIRCLE
    + GROUPS
    + r"""
    // arctangent of y / x in [-pi, pi]: of a ratio in [0, 1], from 0.414 on turned by an eighth of the circle
    auto turn = [](vf y, vf x) {
        const vf ax = x < 0.f ? -x : x, ay = y < 0.f ? -y : y;
        const vf most = ax > ay ? ax : ay, least = ax > ay ? ay : ax;
        const vf q = least / (most > 1e-30f ? most : (vf)1e-30f);
        const vi wide = q > 0.41421356f;
        const vf t = wide ? (q - 1.f) / (q + 1.f) : q, z = t * t;
        vf p = 1.f / 17;
        p = p * z - 1.f / 15;
        p = p * z + 1.f / 13;
        p = p * z - 1.f / 11;
        p = p * z + 1.f / 9;
        p = p * z - 1.f / 7;
        p = p * z + 1.f / 5;
        p = p * z - 1.f / 3;
        p = p * z * t + t;
        p = wide ? p + 0.785398163f : p;
        p = ay > ax ? 1.57079633f - p : p;
        p = x < 0.f ? 3.14159265f - p : p;
        return y < 0.f ? -p : p;
    };
    for (int g = begin; g < end; ++g) {
        for (int j = 0; j < 8; ++j) at[j] = 8 * g + j < count ? 8 * g + j : count - 1;
        const vf nx = read(normal.data, 3, 0), ny = read(normal.data, 3, 1), nz = read(normal.data, 3, 2);
        const vf vx = read(view.data, 3, 0), vy = read(view.data, 3, 1), vz = read(view.data, 3, 2);
        const vf gx = read(flat.data, 3, 0), gy = read(flat.data, 3, 1), gz = read(flat.data, 3, 2);
        const vf move_x = read(shift.data, 2, 0), move_y = read(shift.data, 2, 1), r = read(roughness.data, 1, 0);
        const vf a = r * r > 3.6e-4f ? r * r : (vf)3.6e-4f, a2 = a * a;
        // two tangents of the normal (shading.brdf_sampling.basis)
        const vf sign = nz >= 0.f ? (vf)1.f : (vf)-1.f, slope = -1.f / (sign + nz), both = nx * ny * slope;
        const vf tx = 1.f + sign * nx * nx * slope, ty = sign * both, tz = -sign * nx;
        const vf bx = both, by = sign + ny * ny * slope, bz = -ny;
        vf lx = vx * tx + vy * ty + vz * tz, ly = vx * bx + vy * by + vz * bz, lz = vx * nx + vy * ny + vz * nz;
        lz = lz > 1e-4f ? lz : (vf)1e-4f;
        const vf long_ = root(lx * lx + ly * ly + lz * lz);
        lx /= long_;
        ly /= long_;
        lz /= long_;
        // the hemisphere seen by the stretched view: a cap of the sphere below the view direction
        vf sx = lx * a, sy = ly * a, sz = lz;
        const vf stretched = root(sx * sx + sy * sy + sz * sz);
        sx /= stretched;
        sy /= stretched;
        sz /= stretched;
        const vf smith_v = root(1.f + a2 * (1.f / (lz * lz) - 1.f));
        for (int s = 0; s < S; ++s) {
            vf x = grid.data[2 * s] + move_x, y = grid.data[2 * s + 1] + move_y;
            x = x >= 1.f ? x - 1.f : x;
            y = y >= 1.f ? y - 1.f : y;
            vf c, d;
            circle(x, d, c);
            const vf z = (1.f - y) * (1.f + sz) - sz, rest = 1.f - z * z;
            const vf radius = root(rest > 0.f ? rest : (vf)0.f);
            vf hx = (radius * c + sx) * a, hy = (radius * d + sy) * a, hz = z + sz;
            hz = hz > 0.f ? hz : (vf)0.f;
            const vf size = root(hx * hx + hy * hy + hz * hz), unit = size > 1e-20f ? size : (vf)1e-20f;
            hx /= unit;
            hy /= unit;
            hz /= unit;
            const vf v_h = lx * hx + ly * hy + lz * hz;
            const vf ox = 2.f * v_h * hx - lx, oy = 2.f * v_h * hy - ly, oz = 2.f * v_h * hz - lz;
            const vi lit = oz > 1e-4f;
            const vf n_l = lit ? oz : (vf)1.f;
            const vf smith_l = root(1.f + a2 * (1.f / (n_l * n_l) - 1.f));
            const vf sine2 = hx * hx + hy * hy, spread = a2 + (1.f - a2) * sine2;
            const vf pdf = a2 / (3.14159265f * spread * spread) / (2.f * lz * (1.f + smith_v));
            const vf wx = ox * tx + oy * bx + oz * nx, wy = ox * ty + oy * by + oz * ny;
            const vf wz = ox * tz + oy * bz + oz * nz;
            const vi useful = lit & (wx * gx + wy * gy + wz * gz > 0.f);
            vf missing = 1.f - v_h;
            missing = missing > 0.f ? missing : (vf)0.f;
            missing = missing < 1.f ? missing : (vf)1.f;
            const vf squared = missing * missing;
            const long ray = ((long)g * S + s) * 8;
            float* out = rays.data + 5 * ray;
            STORE(out, useful ? (1.f + smith_v) / (smith_v + smith_l) : (vf)0.f);
            STORE(out + 8, squared * squared * missing);
            STORE(out + 16, 0.5f - turn(wx, wz) * 0.159154943f);
            STORE(out + 24, turn(root(wx * wx + wz * wz), wy) * 0.318309886f);
            STORE(out + 32, vlog(1.f / ((float)S * pdf)) * 0.721347520f);
            STORE(reach.data + ray, useful ? (vf)INFINITY : (vf)0.f);
            float* to = direction.data + 3 * ray;
            for (int j = 0; j < 8; ++j) {
                to[3 * j] = wx[j];
                to[3 * j + 1] = wy[j];
                to[3 * j + 2] = wz[j];
            }
        }
    }
"""
)

LIGHT_RAYS = (
    MATHS
    + CORNERS
    + GROUPS
    + r"""
    typedef float v4 __attribute__((ext_vector_type(4), aligned(4)));
    auto load4 = [](const float* p) { return *(const v4*)p; };
    const int last = levels.shape[0] / 3 - 1, more = extra.shape[0];
    const long whole = levels.data[3 * last + 2] + (long)levels.data[3 * last] * levels.data[3 * last + 1];
    for (int g = begin; g < end; ++g) {
        const int lanes = count - 8 * g < 8 ? count - 8 * g : 8;
        const float* table[8];
        vf base[3], sum[3] = {0.f, 0.f, 0.f};
        for (int j = 0; j < 8; ++j) {
            at[j] = j < lanes ? 8 * g + j : count - 1;
            table[j] = texels.data + (more && extra.data[at[j]] ? 4 * whole : 0);
            for (int c = 0; c < 3; ++c) base[c][j] = f0.data[3 * (long)at[j] + c];
        }
        for (int s = 0; s < S; ++s) {
            const long ray = ((long)g * S + s) * 8;
            const float* kept = rays.data + 5 * ray;
            const int* met = slot.data + ray;
            const vf weight = LOAD(kept), p = LOAD(kept + 8), u = LOAD(kept + 16), v = LOAD(kept + 24);
            vf level = LOAD(kept + 32) - texel;
            level = level > 0.f ? level : (vf)0.f;
            level = level < (float)last ? level : (vf)(float)last;
            const vf low = __builtin_elementwise_floor(level), share = level - low;
            const vi lower = __builtin_convertvector(low, vi), upper = lower + 1 < last ? lower + 1 : (vi)last;
            vi row[2][4];
            vf w[2][4], E[3];
            corners(lower, u, v, row[0], w[0]);
            corners(upper, u, v, row[1], w[1]);
            for (int j = 0; j < 8; ++j) {
                v4 met_light = 0.f;
                if (weight[j] > 0.f && met[j] >= 0) met_light = load4(sent.data + 4 * (long)met[j]);
                if (weight[j] > 0.f && met[j] == -1) {
                    v4 a = 0.f, b = 0.f;
                    for (int k = 0; k < 4; ++k) {
                        a += w[0][k][j] * load4(table[j] + 4 * (long)row[0][k][j]);
                        b += w[1][k][j] * load4(table[j] + 4 * (long)row[1][k][j]);
                    }
                    met_light = a + share[j] * (b - a);
                }
                for (int c = 0; c < 3; ++c) E[c][j] = met_light[c];
            }
            for (int c = 0; c < 3; ++c) sum[c] += weight * E[c] * (base[c] + (1.f - base[c]) * p);
        }
        for (int j = 0; j < lanes; ++j)
            for (int c = 0; c < 3; ++c) result.data[3 * (long)at[j] + c] = sum[c][j] / (float)S;
    }
"""
)

VISIBLE_SHARE = (
    PRELUDE
    + r"""
    typedef unsigned char vb __attribute__((ext_vector_type(8), aligned(1)));
    const int begin = item * grain, end = begin + grain < count ? begin + grain : count;
    const int whole = lights / 8 * 8;
    const float a2 = alpha * alpha, one = 1.f;
    for (int i = begin; i < end; ++i) {
        const float x = reflected.data[3 * i], y = reflected.data[3 * i + 1], z = reflected.data[3 * i + 2];
        const unsigned char* row[3];
        float share[3];
        for (int k = 0; k < 3; ++k) {
            row[k] = visible.data + (long)point.data[3 * i + k] * lights;
            share[k] = weight.data[3 * i + k];
        }
        vf seen = 0.f, all = 0.f;
        auto add = [&](vf dx, vf dy, vf dz, vb b0, vb b1, vb b2) {
            const vf c = x * dx + y * dy + z * dz;
            vf s = 0.5f * (one - c);
            s = s > 0.f ? s : (vf)0.f;
            s = s < 1.f ? s : (vf)1.f;
            const vf d = a2 + (one - a2) * s, w = (c > 0.f ? c : (vf)0.f) / (d * d);
            all += w;
            seen += w * (share[0] * __builtin_convertvector(b0, vf) + share[1] * __builtin_convertvector(b1, vf)
                         + share[2] * __builtin_convertvector(b2, vf));
        };
        const float* d = directions.data;
        for (int k = 0; k < whole; k += 8)
            add(LOAD(d + k), LOAD(d + lights + k), LOAD(d + 2 * lights + k), *(const vb*)(row[0] + k),
                *(const vb*)(row[1] + k), *(const vb*)(row[2] + k));
        if (whole < lights) {
            vf u[3];
            vb b[3];
            for (int j = 0; j < 8; ++j) {
                const bool there = whole + j < lights;
                for (int c = 0; c < 3; ++c) {
                    u[c][j] = there ? d[c * lights + whole + j] : 0.f;  // no direction has no cosine, so no weight
                    b[c][j] = there ? row[c][whole + j] : 0;
                }
            }
            add(u[0], u[1], u[2], b[0], b[1], b[2]);
        }
        float top = 0.f, bottom = 0.f;
        for (int j = 0; j < 8; ++j) {
            top += seen[j];
            bottom += all[j];
        }
        result.data[i] = top / bottom;
    }
"""
)
