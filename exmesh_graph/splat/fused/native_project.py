"""C++ of the projection of Gaussians to records (native_eight) and pixel boxes."""

from exmesh_graph.splat.fused.native_eight import EIGHT

PROJECT = (
    EIGHT
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
