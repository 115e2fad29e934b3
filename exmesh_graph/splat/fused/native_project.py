"""C++ of projection and its adjoint (kernels_draw), eight Gaussians at a time; formulas: kernels_project.

A drawn Gaussian leaves a record of 16 floats for blending, one line of the cache: with L = log2 e

    x, y;  A = -L a / 2, B = -L b, C = -L c / 2 of the conic (a, b, c);  log2 of the opacity;  plane distance;  0
    r, g, b;  normal;  0;  0

so that its opacity at (x + u, y + v) is 2 ^ (A u^2 + B u v + C v^2 + log2 o).
"""

from exmesh_graph.gpu.simd import MATHS

#: Gaussians of an item; whole vectors.
BLOCK = 256
#: Floats of a record, and of what the pass back leaves of a Gaussian in a tile.
RECORD = 16

SHUFFLES = """
    // rows to columns of 8 x 8 floats
    auto transposed = [](vf* r) {
        vf a[8], b[8];
        for (int k = 0; k < 8; k += 2) {
            a[k] = __builtin_shufflevector(r[k], r[k + 1], 0, 8, 2, 10, 4, 12, 6, 14);
            a[k + 1] = __builtin_shufflevector(r[k], r[k + 1], 1, 9, 3, 11, 5, 13, 7, 15);
        }
        for (int h = 0; h < 8; h += 4) for (int k = h; k < h + 2; ++k) {
            b[k] = __builtin_shufflevector(a[k], a[k + 2], 0, 1, 8, 9, 4, 5, 12, 13);
            b[k + 2] = __builtin_shufflevector(a[k], a[k + 2], 2, 3, 10, 11, 6, 7, 14, 15);
        }
        for (int k = 0; k < 4; ++k) {
            r[k] = __builtin_shufflevector(b[k], b[k + 4], 0, 1, 2, 3, 8, 9, 10, 11);
            r[k + 4] = __builtin_shufflevector(b[k], b[k + 4], 4, 5, 6, 7, 12, 13, 14, 15);
        }
    };
    // the sums of eight vectors
    auto sums_of = [](const vf* v) {
        vf a[4], b[2];
        for (int k = 0; k < 4; ++k)
            a[k] = __builtin_shufflevector(v[2 * k], v[2 * k + 1], 0, 8, 2, 10, 4, 12, 6, 14)
                 + __builtin_shufflevector(v[2 * k], v[2 * k + 1], 1, 9, 3, 11, 5, 13, 7, 15);
        for (int k = 0; k < 2; ++k)
            b[k] = __builtin_shufflevector(a[2 * k], a[2 * k + 1], 0, 1, 8, 9, 4, 5, 12, 13)
                 + __builtin_shufflevector(a[2 * k], a[2 * k + 1], 2, 3, 10, 11, 6, 7, 14, 15);
        return __builtin_shufflevector(b[0], b[1], 0, 1, 2, 3, 8, 9, 10, 11)
             + __builtin_shufflevector(b[0], b[1], 4, 5, 6, 7, 12, 13, 14, 15);
    };
"""

_COMMON = (
    MATHS
    + SHUFFLES
    + """
    const float BLUR = 0.1f, MARGIN = 0.15f, L = 1.44269504f, LEAST = 1.f / 255.f;
    const float* K = camera.data;
    const int begin = block * block_size, end = begin + block_size < count ? begin + block_size : count;
    struct V3 {
        vf x, y, z;
        V3 operator+(const V3& o) const { return {x + o.x, y + o.y, z + o.z}; }
        V3 operator-(const V3& o) const { return {x - o.x, y - o.y, z - o.z}; }
        V3 operator*(vf s) const { return {x * s, y * s, z * s}; }
        V3 times(const V3& o) const { return {x * o.x, y * o.y, z * o.z}; }
        vf dot(const V3& o) const { return x * o.x + y * o.y + z * o.z; }
        V3 cross(const V3& o) const { return {y * o.z - z * o.y, z * o.x - x * o.z, x * o.y - y * o.x}; }
    };
    auto chosen = [](vi m, const V3& a, const V3& b) { return V3{m ? a.x : b.x, m ? a.y : b.y, m ? a.z : b.z}; };
    auto larger = [](vf a, vf b) { return a > b ? a : b; };
    auto smaller = [](vf a, vf b) { return a < b ? a : b; };
    auto root = [](vf v) { return __builtin_elementwise_sqrt(v); };
    auto turned = [&](const V3& v) {
        return V3{K[0] * v.x + K[1] * v.y + K[2] * v.z, K[3] * v.x + K[4] * v.y + K[5] * v.z,
                  K[6] * v.x + K[7] * v.y + K[8] * v.z};
    };
    auto turned_back = [&](const V3& v) {
        return V3{K[0] * v.x + K[3] * v.y + K[6] * v.z, K[1] * v.x + K[4] * v.y + K[7] * v.z,
                  K[2] * v.x + K[5] * v.y + K[8] * v.z};
    };
    int at[8];
    auto three = [&](const float* p) {
        V3 v;
        for (int j = 0; j < 8; ++j) {
            v.x[j] = p[3 * (long)at[j]];
            v.y[j] = p[3 * (long)at[j] + 1];
            v.z[j] = p[3 * (long)at[j] + 2];
        }
        return v;
    };
    auto sixteen = [&](const float* p, vf* r) {
        for (int j = 0; j < 8; ++j) { r[j] = LOAD(p + 16 * (long)at[j]); r[8 + j] = LOAD(p + 16 * (long)at[j] + 8); }
        transposed(r);
        transposed(r + 8);
    };
    // slopes of the picture grown by MARGIN, for any principal point and skew
    float low_u = 1e30f, low_v = 1e30f, high_u = -1e30f, high_v = -1e30f;
    {
        const float area = K[12] * K[16] - K[13] * K[15];
        for (int corner = 0; corner < 4; ++corner) {
            const float px = (corner % 2 ? (1.f + MARGIN) * width : -MARGIN * width) - K[14];
            const float py = (corner / 2 ? (1.f + MARGIN) * height : -MARGIN * height) - K[17];
            const float a = (K[16] * px - K[13] * py) / area, b = (K[12] * py - K[15] * px) / area;
            low_u = a < low_u ? a : low_u;    high_u = a > high_u ? a : high_u;
            low_v = b < low_v ? b : low_v;    high_v = b > high_v ? b : high_v;
        }
    }
    // what both passes need of eight Gaussians; J's rows j, M's rows m = j W R diag(s)
    V3 mean, pc, s, axis[3], j[2], m[2], both;
    vf q[4], length, u, v, free_u, free_v, xx, yy, xy, spread;
    vi first_shorter, third_shortest;
    auto look = [&]() {
        mean = three(means.data);
        pc = turned(mean) + V3{(vf)K[9], (vf)K[10], (vf)K[11]};
        const V3 logs = three(scales.data);
        s = {vexp(logs.x), vexp(logs.y), vexp(logs.z)};
        vf raw[4];
        for (int k = 0; k < 8; ++k) for (int c = 0; c < 4; ++c) raw[c][k] = rotations.data[4 * (long)at[k] + c];
        length = root(raw[0] * raw[0] + raw[1] * raw[1] + raw[2] * raw[2] + raw[3] * raw[3]);
        for (int c = 0; c < 4; ++c) q[c] = raw[c] / length;
        const vf w = q[0], x = q[1], y = q[2], z = q[3];
        axis[0] = turned({1.f - 2.f * (y * y + z * z), 2.f * (x * y + w * z), 2.f * (x * z - w * y)});
        axis[1] = turned({2.f * (x * y - w * z), 1.f - 2.f * (x * x + z * z), 2.f * (y * z + w * x)});
        axis[2] = turned({2.f * (x * z + w * y), 2.f * (y * z - w * x), 1.f - 2.f * (x * x + y * y)});
        u = pc.x / pc.z;
        v = pc.y / pc.z;
        free_u = ((u < low_u) | (u > high_u)) ? (vf)0.f : (vf)1.f;
        free_v = ((v < low_v) | (v > high_v)) ? (vf)0.f : (vf)1.f;
        u = smaller(larger(u, low_u), high_u);
        v = smaller(larger(v, low_v), high_v);
        for (int r = 0; r < 2; ++r) {
            const float a = K[12 + 3 * r], b = K[13 + 3 * r];
            j[r] = {a / pc.z, b / pc.z, -(a * u + b * v) / pc.z};
            m[r] = V3{j[r].dot(axis[0]), j[r].dot(axis[1]), j[r].dot(axis[2])}.times(s);
        }
        xx = m[0].dot(m[0]);
        yy = m[1].dot(m[1]);
        xy = m[0].dot(m[1]);
        both = m[0].cross(m[1]);
        // det(M M^T + BLUR I) without the cancellation of xx yy - xy^2
        spread = both.dot(both) + BLUR * (xx + yy) + BLUR * BLUR;
        first_shorter = s.y < s.x;
        third_shortest = s.z < (first_shorter ? s.y : s.x);
    };
    auto shortest = [&](const V3* a) { return chosen(third_shortest, a[2], chosen(first_shorter, a[1], a[0])); };
    auto sigmoid_of = [&]() {
        vf o;
        for (int k = 0; k < 8; ++k) o[k] = opacities.data[at[k]];
        return sigmoid(o);
    };
    // harmonics (kernels_harmonics): values h and slopes (dx, dy, dz) of each at the direction d; `used` of them
    const int used = (degree + 1) * (degree + 1), floats = 3 * stored;
    vf h[16];
    auto basis = [&](const V3& d) {
        const vf x = d.x, y = d.y, z = d.z, x2 = x * x, y2 = y * y, z2 = z * z;
        h[0] = 0.28209479f;
        h[1] = -0.48860251f * y;
        h[2] = 0.48860251f * z;
        h[3] = -0.48860251f * x;
        h[4] = 1.09254843f * x * y;
        h[5] = -1.09254843f * y * z;
        h[6] = 0.31539157f * (2.f * z2 - x2 - y2);
        h[7] = -1.09254843f * x * z;
        h[8] = 0.54627422f * (x2 - y2);
        h[9] = -0.59004359f * y * (3.f * x2 - y2);
        h[10] = 2.89061144f * x * y * z;
        h[11] = -0.45704580f * y * (4.f * z2 - x2 - y2);
        h[12] = 0.37317633f * z * (2.f * z2 - 3.f * x2 - 3.f * y2);
        h[13] = -0.45704580f * x * (4.f * z2 - x2 - y2);
        h[14] = 1.44530572f * z * (x2 - y2);
        h[15] = -0.59004359f * x * (x2 - 3.f * y2);
    };
    // coefficients c of the harmonics k in use as sh_of[3 k + c]
    vf sh_of[48];
    auto coefficients = [&]() {
        if (floats % 8 == 0) {
            for (int c = 0; c < 3 * used; c += 8) {
                for (int k = 0; k < 8; ++k) sh_of[c + k] = LOAD(sh.data + floats * (long)at[k] + c);
                transposed(sh_of + c);
            }
        } else {
            for (int c = 0; c < 3 * used; ++c)
                for (int k = 0; k < 8; ++k) sh_of[c][k] = sh.data[floats * (long)at[k] + c];
        }
    };
    auto from_eye = [&]() { return mean - V3{(vf)K[18], (vf)K[19], (vf)K[20]}; };
    auto lanes_at = [&](int i) {
        vi alive;
        for (int k = 0; k < 8; ++k) { at[k] = i + k < end ? i + k : end - 1; alive[k] = i + k < end ? -1 : 0; }
        return alive;
    };
"""
)

PROJECT = (
    _COMMON
    + """
    for (int i = begin; i < end; i += 8) {
        const vi alive = lanes_at(i);
        const int lanes = end - i < 8 ? end - i : 8;
        look();
        const vf x = (K[12] * pc.x + K[13] * pc.y) / pc.z + K[14], y = (K[15] * pc.x + K[16] * pc.y) / pc.z + K[17];
        const vf sum = spread + x + y + xx + yy, o = root(both.dot(both) / spread) * sigmoid_of();
        vi drawn = alive & (pc.z > near) & (length > 0.f) & (sum - sum == 0.f) & (o >= LEAST);
        const vf safe = drawn ? o : (vf)1.f, reach = 2.f * vlog(safe * 255.f);
        const vf half_x = root(reach * (xx + BLUR)), half_y = root(reach * (yy + BLUR));
        auto held = [&](vf value, float low, float high) { return smaller(larger(value, low), high); };
        const vf edges[4] = {
            __builtin_elementwise_ceil(held(x - half_x - 0.5f, 0.f, width)),
            __builtin_elementwise_ceil(held(y - half_y - 0.5f, 0.f, height)),
            __builtin_elementwise_floor(held(x + half_x - 0.5f, -1.f, width - 1.f)),
            __builtin_elementwise_floor(held(y + half_y - 0.5f, -1.f, height - 1.f))};
        drawn = drawn & (edges[2] >= edges[0]) & (edges[3] >= edges[1]);
        for (int k = 0; k < lanes; ++k) {
            int* b = box.data + 4 * (long)(i + k);
            int touched = 0;
            for (int c = 0; c < 4; ++c) b[c] = drawn[k] ? (int)edges[c][k] : c == 2 ? -1 : 0;
            if (drawn[k]) touched = (b[2] / tile - b[0] / tile + 1) * (b[3] / tile - b[1] / tile + 1);
            tiles_of.data[i + k] = touched;
            depth.data[i + k] = pc.z[k];
        }
        if (!__builtin_reduce_or(drawn)) continue;
        V3 n = shortest(axis);
        n = chosen(n.dot(pc) > 0.f, n * (vf)-1.f, n);
        const vf zero = 0.f;
        V3 colour = {zero, zero, zero};
        if (coloured) {
            const V3 offset = from_eye();
            basis(offset * (1.f / root(offset.dot(offset))));
            coefficients();
            for (int k = 0; k < used; ++k)
                colour = colour + V3{sh_of[3 * k], sh_of[3 * k + 1], sh_of[3 * k + 2]} * h[k];
            colour = {larger(colour.x + 0.5f, zero), larger(colour.y + 0.5f, zero), larger(colour.z + 0.5f, zero)};
        }
        vf r[16] = {x, y, -0.5f * L * ((yy + BLUR) / spread), L * (xy / spread), -0.5f * L * ((xx + BLUR) / spread),
                    vlog(safe) * L, n.dot(pc), zero, colour.x, colour.y, colour.z, n.x, n.y, n.z, zero, zero};
        transposed(r);
        transposed(r + 8);
        for (int k = 0; k < lanes; ++k) {
            STORE(records.data + 16 * (long)(i + k), r[k]);
            STORE(records.data + 16 * (long)(i + k) + 8, r[8 + k]);
        }
    }
"""
)

ADJOINT = (
    _COMMON
    + """
    for (int i = begin; i < end; i += 8) {
        vi seen = lanes_at(i);
        const int lanes = end - i < 8 ? end - i : 8;
        const vf zero = 0.f;
        vf g[16];
        for (int k = 0; k < 8; ++k) {
            g[k] = g[8 + k] = zero;
            seen[k] = k < lanes && weight.data[i + k] > 0.f ? -1 : 0;
            if (!seen[k]) continue;
            for (int slot = first_slot.data[i + k]; slot < first_slot.data[i + k + 1]; ++slot) {
                if (!(slot_weights.data[slot] > 0.f)) continue;
                g[k] += LOAD(slots.data + 16 * (long)slot);
                g[8 + k] += LOAD(slots.data + 16 * (long)slot + 8);
            }
        }
        if (!__builtin_reduce_or(seen)) {
            for (int k = 0; k < lanes; ++k) {
                for (int c = 0; c < 3; ++c) to_means.data[3 * (long)(i + k) + c] = 0.f;
                for (int c = 0; c < 3; ++c) to_scales.data[3 * (long)(i + k) + c] = 0.f;
                for (int c = 0; c < 4; ++c) to_rotations.data[4 * (long)(i + k) + c] = 0.f;
                for (int c = 0; c < floats; ++c) to_sh.data[floats * (long)(i + k) + c] = 0.f;
                for (int c = 0; c < 2; ++c) on_screen.data[2 * (long)(i + k) + c] = 0.f;
                to_opacities.data[i + k] = 0.f;
            }
            continue;
        }
        transposed(g);
        transposed(g + 8);
        vf r[16];
        sixteen(records.data, r);
        look();
        const vf a = r[2] * (-2.f / L), b = r[3] * (-1.f / L), c = r[4] * (-2.f / L);
        // sums over pixels of dL/dln(opacity) times 1; u, v; u^2, u v, v^2 (from the mean)
        const vf by_x = a * g[8] + b * g[9], by_y = b * g[8] + c * g[9];
        const vf ga = -0.5f * g[10], gb = -0.5f * g[11], gc = -0.5f * g[12];
        const vf screen = root(by_x * by_x + by_y * by_y), absolute = root(g[13] * g[13] + g[14] * g[14]) * (1.f / L);

        // conic -> Sigma' : dL/dSigma' = -conic G conic, G the symmetric gradient
        const vf h00 = a * ga + b * gb, h01 = a * gb + b * gc, h10 = b * ga + c * gb, h11 = b * gb + c * gc;
        const vf s00 = -(h00 * a + h01 * b), s01 = -(h00 * b + h01 * c), s11 = -(h10 * b + h11 * c);
        V3 g0 = (m[0] * s00 + m[1] * s01) * (vf)2.f, g1 = (m[0] * s01 + m[1] * s11) * (vf)2.f;
        // o' = o |c| / sqrt(det), c = m0 x m1: dL/dln o' reaches the logit, |c| and det
        const vf o = sigmoid_of(), by_log = g[7];
        const V3 by_both = both * (by_log * (1.f / both.dot(both) - 1.f / spread));
        const vf by_trace = by_log * BLUR / spread;
        g0 = g0 + m[1].cross(by_both) - m[0] * by_trace;
        g1 = g1 + by_both.cross(m[0]) - m[1] * by_trace;
        const vf to_opacity = by_log * (1.f - o);
        const V3 to_scale = g0.times(m[0]) + g1.times(m[1]);
        g0 = g0.times(s);
        g1 = g1.times(s);
        // dL/d(W R), column by column
        V3 to_axis[3] = {j[0] * g0.x + j[1] * g1.x, j[0] * g0.y + j[1] * g1.y, j[0] * g0.z + j[1] * g1.z};
        const V3 gj0 = axis[0] * g0.x + axis[1] * g0.y + axis[2] * g0.z;
        const V3 gj1 = axis[0] * g1.x + axis[1] * g1.y + axis[2] * g1.z;

        // the mean: through its place on screen, through J, through its plane
        const vf z = pc.z, wu = K[12] * by_x + K[15] * by_y, wv = K[13] * by_x + K[16] * by_y;
        V3 gp = {wu / z, wv / z, -(wu * pc.x + wv * pc.y) / (z * z)};
        const vf by_u = -(K[12] * gj0.z + K[15] * gj1.z) / z, by_v = -(K[13] * gj0.z + K[16] * gj1.z) / z;
        const vf by_z = -(gj0.dot(j[0]) + gj1.dot(j[1])) / z;
        gp = gp + V3{free_u * by_u / z, free_v * by_v / z,
                     by_z - (free_u * by_u * pc.x + free_v * by_v * pc.y) / (z * z)};
        const V3 n = {r[11], r[12], r[13]};
        V3 gn = V3{g[3], g[4], g[5]} + pc * g[6];
        gp = gp + n * g[6];
        gn = chosen(shortest(axis).dot(pc) > 0.f, gn * (vf)-1.f, gn);
        const V3 none = {zero, zero, zero};
        to_axis[2] = to_axis[2] + chosen(third_shortest, gn, none);
        to_axis[1] = to_axis[1] + chosen(~third_shortest & first_shorter, gn, none);
        to_axis[0] = to_axis[0] + chosen(~third_shortest & ~first_shorter, gn, none);

        // colour; max(0, .) lets nothing through where it cut
        const vf gcol[3] = {r[8] > 0.f ? g[0] : zero, r[9] > 0.f ? g[1] : zero, r[10] > 0.f ? g[2] : zero};
        const V3 offset = from_eye();
        const vf far = root(offset.dot(offset));
        const V3 d = offset * (1.f / far);
        basis(d);
        coefficients();
        vf by_h[16];
        for (int k = 0; k < used; ++k)
            by_h[k] = sh_of[3 * k] * gcol[0] + sh_of[3 * k + 1] * gcol[1] + sh_of[3 * k + 2] * gcol[2];
        for (int k = used; k < 16; ++k) by_h[k] = zero;
        const vf x = d.x, y = d.y, w = d.z, x2 = x * x, y2 = y * y, w2 = w * w;
        V3 gd = {-0.48860251f * by_h[3], -0.48860251f * by_h[1], 0.48860251f * by_h[2]};
        if (degree > 1) {
            const vf c4 = 1.09254843f * by_h[4], c5 = 1.09254843f * by_h[5], c6 = 0.63078313f * by_h[6];
            const vf c7 = 1.09254843f * by_h[7], c8 = 1.09254843f * by_h[8];
            gd = gd + V3{y * c4 - x * c6 - w * c7 + x * c8, x * c4 - w * c5 - y * c6 - y * c8,
                         -y * c5 + 2.f * w * c6 - x * c7};
        }
        if (degree > 2) {
            const vf d9 = 0.59004359f * by_h[9], d10 = 2.89061144f * by_h[10], d11 = 0.45704580f * by_h[11];
            const vf d12 = 0.37317633f * by_h[12], d13 = 0.45704580f * by_h[13], d14 = 1.44530572f * by_h[14];
            const vf d15 = 0.59004359f * by_h[15];
            gd.x += -6.f * x * y * d9 + y * w * d10 + 2.f * x * y * d11 - 6.f * x * w * d12
                  + (3.f * x2 + y2 - 4.f * w2) * d13 + 2.f * x * w * d14 + 3.f * (y2 - x2) * d15;
            gd.y += 3.f * (y2 - x2) * d9 + x * w * d10 + (x2 + 3.f * y2 - 4.f * w2) * d11
                  - 6.f * y * w * d12 + 2.f * x * y * d13 - 2.f * y * w * d14 + 6.f * x * y * d15;
            gd.z += x * y * d10 - 8.f * y * w * d11 + 3.f * (2.f * w2 - x2 - y2) * d12
                  - 8.f * x * w * d13 + (x2 - y2) * d14;
        }
        const V3 to_mean = turned_back(gp) + (gd - d * gd.dot(d)) * (1.f / far);

        // rotation matrix -> unit quaternion -> raw quaternion
        const V3 c0 = turned_back(to_axis[0]), c1 = turned_back(to_axis[1]), c2 = turned_back(to_axis[2]);
        const vf q0 = q[0], q1 = q[1], q2 = q[2], q3 = q[3];
        vf gq[4] = {
            2.f * (q1 * (c1.z - c2.y) + q2 * (c2.x - c0.z) + q3 * (c0.y - c1.x)),
            2.f * (q2 * (c1.x + c0.y) + q3 * (c2.x + c0.z) + q0 * (c1.z - c2.y) - 2.f * q1 * (c1.y + c2.z)),
            2.f * (q1 * (c1.x + c0.y) + q3 * (c2.y + c1.z) + q0 * (c2.x - c0.z) - 2.f * q2 * (c0.x + c2.z)),
            2.f * (q1 * (c2.x + c0.z) + q2 * (c2.y + c1.z) + q0 * (c0.y - c1.x) - 2.f * q3 * (c0.x + c1.y))};
        const vf along = gq[0] * q0 + gq[1] * q1 + gq[2] * q2 + gq[3] * q3;
        for (int k = 0; k < 4; ++k) gq[k] = (gq[k] - along * q[k]) / length;

        // dL/dsh is the product of the harmonics and the colour's gradient
        vf to[48];
        for (int k = 0; k < used; ++k) for (int e = 0; e < 3; ++e) to[3 * k + e] = seen ? h[k] * gcol[e] : zero;
        for (int k = 3 * used; k < floats; ++k) to[k] = zero;
        if (floats % 8 == 0) {
            for (int e = 0; e < floats; e += 8) {
                transposed(to + e);
                for (int k = 0; k < lanes; ++k) STORE(to_sh.data + floats * (long)(i + k) + e, to[e + k]);
            }
        } else {
            for (int k = 0; k < lanes; ++k)
                for (int e = 0; e < floats; ++e) to_sh.data[floats * (long)(i + k) + e] = to[e][k];
        }
        auto store3 = [&](float* p, const V3& value) {
            for (int k = 0; k < lanes; ++k) {
                p[3 * (long)(i + k)] = seen[k] ? value.x[k] : 0.f;
                p[3 * (long)(i + k) + 1] = seen[k] ? value.y[k] : 0.f;
                p[3 * (long)(i + k) + 2] = seen[k] ? value.z[k] : 0.f;
            }
        };
        store3(to_means.data, to_mean);
        store3(to_scales.data, to_scale);
        for (int k = 0; k < lanes; ++k) {
            for (int e = 0; e < 4; ++e) to_rotations.data[4 * (long)(i + k) + e] = seen[k] ? gq[e][k] : 0.f;
            to_opacities.data[i + k] = seen[k] ? to_opacity[k] : 0.f;
            on_screen.data[2 * (long)(i + k)] = seen[k] ? screen[k] : 0.f;
            on_screen.data[2 * (long)(i + k) + 1] = seen[k] ? absolute[k] : 0.f;
        }
    }
"""
)
