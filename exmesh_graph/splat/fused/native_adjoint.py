"""C++ of the adjoint of projection, which ends in the gradients or in a step of Adam; formulas: kernels_project.

A batch of eight Gaussians leaves its gradients on the stack, in the order in which the parameters lie in memory, so
that a step reads and writes parameters and moments once and gradients never reach memory.
"""

from exmesh_graph.splat.fused.native_eight import EIGHT

# what the ends below take of a batch: gradients, and who was seen; `thin` is the gradient of the flattening term in the
# thickness of a Gaussian that is seen
_BATCH = (
    EIGHT
    + """
    float by_means[24], by_scales[24], by_rotations[32], by_opacities[8], by_sh[8 * 48];
    vf screen, absolute;
    vi seen;
"""
)

_ADJOINT = """
    for (int i = begin; i < end; i += 8) {
        seen = lanes_at(i);
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
        if (!__builtin_reduce_or(seen)) { unseen(i, lanes); continue; }
        transposed(g);
        transposed(g + 8);
        vf r[16];
        sixteen(records.data, r);
        look();
        const vf a = r[2] * (-2.f / L), b = r[3] * (-1.f / L), c = r[4] * (-2.f / L);
        // sums over pixels of dL/dln(opacity) times 1; u, v; u^2, u v, v^2 (from the mean)
        const vf by_x = a * g[8] + b * g[9], by_y = b * g[8] + c * g[9];
        const vf ga = -0.5f * g[10], gb = -0.5f * g[11], gc = -0.5f * g[12];
        screen = root(by_x * by_x + by_y * by_y);
        absolute = root(g[13] * g[13] + g[14] * g[14]) * (1.f / L);

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
        V3 to_scale = g0.times(m[0]) + g1.times(m[1]);
        if (thin != 0.f) {                                        // shared by scales that are equally small
            const vf least = smaller(smaller(s.x, s.y), s.z), none = 0.f, one = 1.f;
            const V3 ties = {s.x == least ? one : none, s.y == least ? one : none, s.z == least ? one : none};
            to_scale = to_scale + ties * (thin * least / (ties.x + ties.y + ties.z));
        }
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
        for (int k = 3 * used; k < 48; ++k) to[k] = zero;
        for (int e = 0; e < 48; e += 8) {
            transposed(to + e);
            for (int k = 0; k < 8; ++k) STORE(by_sh + 48 * k + e, to[e + k]);
        }
        const vf *mean_of = &to_mean.x, *scale_of = &to_scale.x;
        for (int k = 0; k < 8; ++k) {
            for (int e = 0; e < 3; ++e) by_means[3 * k + e] = seen[k] ? mean_of[e][k] : 0.f;
            for (int e = 0; e < 3; ++e) by_scales[3 * k + e] = seen[k] ? scale_of[e][k] : 0.f;
            for (int e = 0; e < 4; ++e) by_rotations[4 * k + e] = seen[k] ? gq[e][k] : 0.f;
            by_opacities[k] = seen[k] ? to_opacity[k] : 0.f;
        }
        take(i, lanes);
    }
"""

GRADIENTS = (
    _BATCH
    + """
    auto copy = [](float* to, const float* from, int n) { for (int e = 0; e < n; ++e) to[e] = from ? from[e] : 0.f; };
    auto store = [&](long i, int lanes, bool any) {
        copy(to_means.data + 3 * i, any ? by_means : nullptr, 3 * lanes);
        copy(to_scales.data + 3 * i, any ? by_scales : nullptr, 3 * lanes);
        copy(to_rotations.data + 4 * i, any ? by_rotations : nullptr, 4 * lanes);
        copy(to_opacities.data + i, any ? by_opacities : nullptr, lanes);
        for (int k = 0; k < lanes; ++k) copy(to_sh.data + floats * (i + k), any ? by_sh + 48 * k : nullptr, floats);
        for (int k = 0; k < lanes; ++k) {
            on_screen.data[2 * (i + k)] = any && seen[k] ? screen[k] : 0.f;
            on_screen.data[2 * (i + k) + 1] = any && seen[k] ? absolute[k] : 0.f;
        }
    };
    auto unseen = [&](long i, int lanes) { store(i, lanes, false); };
    auto take = [&](long i, int lanes) { store(i, lanes, true); };
"""
    + _ADJOINT
)

ADAM = (
    _BATCH
    + """
    auto part = [](const float* p, int lanes) {
        if (lanes >= LANES) return LOAD(p);
        vf v = 0.f;
        for (int k = 0; k < lanes; ++k) v[k] = p[k];
        return v;
    };
    auto put = [](float* p, vf v, int lanes) {
        if (lanes >= LANES) STORE(p, v);
        else for (int k = 0; k < lanes; ++k) p[k] = v[k];
    };
    // one vector; `on`: lanes that step
    auto step = [&](float* x, float* m, float* v, vf g, vi on, vf first, vf second, vf rate, int lanes) {
        const vf m0 = part(m, lanes), v0 = part(v, lanes), x0 = part(x, lanes);
        const vf a = 0.9f * m0 + 0.1f * g, b = 0.999f * v0 + 0.001f * g * g;
        const vf x1 = x0 - rate * (a / first) / (root(b / second) + epsilon);
        put(m, on ? a : m0, lanes);
        put(v, on ? b : v0, lanes);
        put(x, on ? x1 : x0, lanes);
    };
    float first_of[8], second_of[8];
    auto rows = [&](float* x, float* m, float* v, const float* g, int wide, float rate, long i, int lanes) {
        const int n = wide * lanes;
        for (int e = 0; e < n; e += LANES) {
            vf first = 1.f, second = 1.f;
            vi on = 0;
            for (int l = 0; l < LANES; ++l) {
                const int k = (e + l) / wide;
                if (k >= 8) continue;
                first[l] = first_of[k]; second[l] = second_of[k]; on[l] = seen[k];
            }
            const long at = wide * i + e;
            step(x + at, m + at, v + at, LOAD(g + e), on, first, second, (vf)rate, n - e);
        }
    };
    auto unseen = [](long i, int lanes) {};
    auto take = [&](long i, int lanes) {
        for (int k = 0; k < 8; ++k) {
            first_of[k] = second_of[k] = 1.f;
            if (!seen[k]) continue;
            const float n = steps.data[i + k] += 1.f;
            first_of[k] = bias.data[2 * (int)n];
            second_of[k] = bias.data[2 * (int)n + 1];
            gradient_sums.data[2 * (i + k)] += half_width * screen[k];
            gradient_sums.data[2 * (i + k) + 1] += half_width * absolute[k];
            views.data[i + k] += 1.f;
            const float w = weight.data[i + k], most = most_weight.data[i + k];
            most_weight.data[i + k] = w > most ? w : most;
        }
        rows(means.data, m_means.data, v_means.data, by_means, 3, rates.data[0], i, lanes);
        rows(scales.data, m_scales.data, v_scales.data, by_scales, 3, rates.data[1], i, lanes);
        rows(rotations.data, m_rotations.data, v_rotations.data, by_rotations, 4, rates.data[2], i, lanes);
        rows(opacities.data, m_opacities.data, v_opacities.data, by_opacities, 1, rates.data[3], i, lanes);
        vf of_colour = rates.data[5];
        for (int c = 0; c < 3; ++c) of_colour[c] = rates.data[4];
        const vi all = -1;
        for (int k = 0; k < lanes; ++k) {
            if (!seen[k]) continue;
            for (int e = 0; e < 3 * used; e += LANES) {           // what is not in use has no moments
                const long at = floats * (i + k) + e;
                step(sh.data + at, m_sh.data + at, v_sh.data + at, LOAD(by_sh + 48 * k + e), all, (vf)first_of[k],
                     (vf)second_of[k], e ? (vf)rates.data[5] : of_colour, floats - e);
            }
        }
    };
"""
    + _ADJOINT
)
