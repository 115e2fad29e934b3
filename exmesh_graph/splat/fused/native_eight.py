"""C++ that projection and its adjoint share, eight Gaussians at a time; formulas: kernels_project, kernels_harmonics.

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

EIGHT = (
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
