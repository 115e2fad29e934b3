"""C++ of the propagation: eight pixels of one colour of a row at a time, for a CPU. Import through `propagate`.

A plane at a pixel is its inverse depth w and the change of it, du and dv, from pixel to pixel. Under it the pixel x of
the reference view lies at A (x, y, 1) + b w of a source view's homogeneous pixels (`sources.transfers`). Within a
window that map is taken as its linear part at the middle, so that there is one division for a window.

Layouts (`layout`), x = 2 k + p a column, p its parity:

    ref      grey 0 to 255 [N, H + 2 MARGIN, 2, S]: columns of one parity together, -1e4 outside picture and mask
    state    [N, 2, H, 4, S]: of the pixels of one colour (x + y) mod 2 of a row, w, du, dv and cost; 1e9: no pixel
    packed   int32 [N, H, W]: bytes g(x, y), g(x + 1, y), g(x, y + 1), g(x + 1, y + 1)
    inside   int32 [N, H, W]: 1 within the mask
    found    [N, 3, H, W]: w, du, dv of all views as an iteration found them, w 0 where there is none
"""

from exmesh_graph.gpu.simd import MATHS

PAD = 8
"""Columns of nothing on either side of a row of one parity."""
MARGIN = 12
"""Rows of nothing above and below `ref`; a window reaches no further, nor 2 PAD columns."""
MOST_SIDE, MOST_SOURCES, MOST_BEST = 9, 16, 8
"""Samples on a window's side, sources of a view, and costs that are averaged, at most."""
MATRIX = 24
"""Floats of a transfer: A (9), b (3) to the source, and the same back."""

ROW = (
    MATHS
    + f"""
    constexpr int PAD = {PAD}, MARGIN = {MARGIN}, MOST = {MOST_SIDE * MOST_SIDE}, BEST = {MOST_BEST};
    constexpr int MATRIX = {MATRIX};
"""
    + r"""
    typedef unsigned int vu __attribute__((ext_vector_type(8), aligned(4)));
    const float NONE = 1e8f;                                      // costs above: no pixel
    const float WORST = 2.f;
    const float EPS = 0.5f;                                       // of a variance in grey levels squared: flat
    const float* F = numbers.data;
    const float colour_spread = F[0], far_weight = F[1], far_most = F[2];
    const float least_exponent = F[3], most_exponent = F[4], bend_exponent = F[5], tilt = F[6];
    const float w_least = bounds.data[view * 4], w_most = bounds.data[view * 4 + 1], unit = bounds.data[view * 4 + 2];
    const float focal = bounds.data[view * 4 + 3];
    const int S = stride, side = 2 * radius + 1, samples = side * side;
    const long plane = (long)height * width;
    float* own = state.data + (((long)view * 2 + colour) * height + row) * 4 * S + PAD;
    auto other_row = [&](int j) {                                 // of the opposite colour
        const int c = colour ^ 1;
        return state.data + (((long)view * 2 + c) * height + row + j) * 4 * S + PAD;
    };
    const int p = (row + colour) & 1;
    const float* M = matrices.data + (long)view * sources * MATRIX;
    const int* J = chosen.data + (long)view * sources;
    const float y = row + 0.5f;
    const vf lane = {0.f, 1.f, 2.f, 3.f, 4.f, 5.f, 6.f, 7.f};
    const vi lane_i = {0, 1, 2, 3, 4, 5, 6, 7};
    auto absolute = [](vf v) { return v < 0.f ? -v : v; };
    auto gather = [](const int* base, vi at) {
        vi q;
        for (int j = 0; j < LANES; ++j) q[j] = base[at[j]];
        return q;
    };
    auto gather_f = [](const float* base, vi at) {
        vf q;
        for (int j = 0; j < LANES; ++j) q[j] = base[at[j]];
        return q;
    };
    auto clamp = [](vf v, float a, float b) {
        v = v > a ? v : (vf)a;                                    // not a number becomes a
        return v < b ? v : (vf)b;
    };

    for (int k0 = 0; 2 * k0 < width; k0 += LANES) {
        float* st = own + k0;
        vf w = LOAD(st), du = LOAD(st + S), dv = LOAD(st + 2 * S), cost = LOAD(st + 3 * S);
        const vi active = cost < NONE;
        int any = 0;
        for (int j = 0; j < LANES; ++j) any |= active[j];
        if (!any) continue;
        const vf x = 2.f * (lane + (float)k0) + (p + 0.5f);

        // bilateral weights of the window, and weights times grey less the mean
        vf wt[MOST], wr[MOST], sum = 0.f, mean = 0.f, variance = 0.f;
        {
            auto grey = [&](int i, int j) {
                const int q = p + i;
                const long line = (long)view * (height + 2 * MARGIN) + row + MARGIN + j;
                return LOAD(ref.data + (line * 2 + (q & 1)) * S + PAD + k0 + (q >> 1));
            };
            const vf middle = grey(0, 0);
            int n = 0;
            for (int j = -radius; j <= radius; ++j) for (int i = -radius; i <= radius; ++i, ++n) {
                const vf g = grey(i * step, j * step), d = (g - middle) * colour_spread;
                const float away = (float)(i * i + j * j) / (2.f * radius * radius);
                const vf e = g < -1.f ? (vf)0.f : vexp(-d * d - away);
                wt[n] = e;
                wr[n] = g;
                sum += e;
                mean += e * g;
            }
            const vf scale = 1.f / (sum > 0.f ? sum : (vf)1.f);
            mean *= scale;
            for (n = 0; n < samples; ++n) {
                wt[n] *= scale;
                const vf d = wr[n] - mean;
                wr[n] = wt[n] > 0.f ? wt[n] * d : (vf)0.f;
                variance += wt[n] > 0.f ? wr[n] * d : (vf)0.f;
            }
        }

        // mean of the `best` least costs of the sources under a plane
        auto evaluate = [&](vf w0, vf a, vf b) -> vf {
            vf least[BEST];
            for (int k = 0; k < best; ++k) least[k] = (vf)1e6f;
            for (int s = 0; s < sources; ++s) {
                const int source = J[s];
                if (source < 0) continue;
                const float* m = M + s * MATRIX;
                const vf pz = m[6] * x + (m[7] * y + m[8]) + m[11] * w0;
                const vf inverse = 1.f / (pz > 1e-6f ? pz : (vf)1e-6f);
                const vf u = (m[0] * x + (m[1] * y + m[2]) + m[9] * w0) * inverse;
                const vf v = (m[3] * x + (m[4] * y + m[5]) + m[10] * w0) * inverse;
                vi ok = (pz > 1e-6f) & (u > 0.f) & (u < (float)width) & (v > 0.f) & (v < (float)height);
                const vi cell = __builtin_convertvector(clamp(v, 0.f, height - 1.f), vi) * width
                    + __builtin_convertvector(clamp(u, 0.f, width - 1.f), vi);
                ok = ok & (gather(inside.data + source * plane, cell) != 0);
                const vf zx = m[6] + m[11] * a, zy = m[7] + m[11] * b;
                const vf ux = (m[0] + m[9] * a - u * zx) * inverse * (float)step;
                const vf uy = (m[1] + m[9] * b - u * zy) * inverse * (float)step;
                const vf vx = (m[3] + m[10] * a - v * zx) * inverse * (float)step;
                const vf vy = (m[4] + m[10] * b - v * zy) * inverse * (float)step;
                const int* picture = packed.data + source * plane;
                vf S1 = 0.f, S2 = 0.f, S12 = 0.f;
                int n = 0;
                const float right = width - 1.001f, bottom = height - 1.001f;
                for (int j = -radius; j <= radius; ++j) {
                    vf su = u - 0.5f + (float)j * uy - (float)radius * ux;
                    vf sv = v - 0.5f + (float)j * vy - (float)radius * vx;
                    for (int i = 0; i < side; ++i, ++n) {
                        const vf cu = clamp(su, 0.f, right), cv = clamp(sv, 0.f, bottom);
                        const vi iu = __builtin_convertvector(cu, vi), iv = __builtin_convertvector(cv, vi);
                        const vf fu = cu - __builtin_convertvector(iu, vf), fv = cv - __builtin_convertvector(iv, vf);
                        const vi q = gather(picture, iv * width + iu);
                        const vf g0 = __builtin_convertvector(q & 255, vf);
                        const vf g1 = __builtin_convertvector((q >> 8) & 255, vf);
                        const vf g2 = __builtin_convertvector((q >> 16) & 255, vf);
                        const vf g3 = __builtin_convertvector((q >> 24) & 255, vf);
                        const vf top = g0 + fu * (g1 - g0), below = g2 + fu * (g3 - g2);
                        const vf g = top + fv * (below - top) - mean, weighted = wt[n] * g;
                        S1 += weighted;
                        S2 += weighted * g;
                        S12 += wr[n] * g;
                        su += ux;
                        sv += vx;
                    }
                }
                vf spread = S2 - S1 * S1;
                spread = spread > 0.f ? spread : (vf)0.f;
                vf c = 1.f - S12 / __builtin_elementwise_sqrt((variance + EPS) * (spread + EPS));
                if (far_weight > 0.f) {                           // there and back by the source's own depth
                    const float* o = found.data + source * 3 * plane;
                    const vf du_s = u - 0.5f - __builtin_convertvector(cell % width, vf);
                    const vf dv_s = v - 0.5f - __builtin_convertvector(cell / width, vf);
                    const vf there = gather_f(o, cell);
                    const vf ws = there + gather_f(o + plane, cell) * du_s + gather_f(o + 2 * plane, cell) * dv_s;
                    const vf bz = m[18] * u + m[19] * v + m[20] + m[23] * ws;
                    const vf back = 1.f / (bz > 1e-6f ? bz : (vf)1e-6f);
                    const vf ex = (m[12] * u + m[13] * v + m[14] + m[21] * ws) * back - x;
                    const vf ey = (m[15] * u + m[16] * v + m[17] + m[22] * ws) * back - y;
                    vf miss = __builtin_elementwise_sqrt(ex * ex + ey * ey);
                    miss = ((there > 0.f) & (bz > 1e-6f) & (miss < far_most)) ? miss : (vf)far_most;
                    c += far_weight * miss;
                }
                c = ok ? c : (vf)(WORST + far_weight * far_most);
                for (int k = 0; k < best; ++k) {
                    const vf low = c < least[k] ? c : least[k];
                    c = c < least[k] ? least[k] : c;
                    least[k] = low;
                }
            }
            vf total = 0.f;
            for (int k = 0; k < best; ++k) total += least[k] < 1e5f ? least[k] : (vf)WORST;
            return total * (1.f / best);
        };
        auto attempt = [&](vf w0, vf a, vf b) {
            const vf most = tilt * w0;                            // of a slope in inverse depth over a focal length
            vi valid = active & (w0 >= w_least) & (w0 <= w_most);
            valid = valid & (absolute(a) * focal <= most) & (absolute(b) * focal <= most);
            int some = 0;
            for (int j = 0; j < LANES; ++j) some |= valid[j];
            if (!some) return;
            const vf c = evaluate(w0, a, b);
            const vi better = valid & (c < cost);
            w = better ? w0 : w;
            du = better ? a : du;
            dv = better ? b : dv;
            cost = better ? c : cost;
        };

        if (refresh) {
            const vf c = evaluate(w, du, dv);
            cost = active ? c : cost;
        }

        // of each of four sides, the plane of the neighbour that fits best where it is
        const int reach[4][5][2] = {{{0, -1}, {-1, -2}, {1, -2}, {0, -3}, {0, -5}},
                                    {{0, 1}, {-1, 2}, {1, 2}, {0, 3}, {0, 5}},
                                    {{-1, 0}, {-2, -1}, {-2, 1}, {-3, 0}, {-5, 0}},
                                    {{1, 0}, {2, -1}, {2, 1}, {3, 0}, {5, 0}}};
        vf near_w[4], near_cost[4];
        for (int side_of = 0; side_of < 4; ++side_of) {
            vf bw = 0.f, ba = 0.f, bb = 0.f, bc = (vf)1e9f;
            near_w[side_of] = 0.f;
            near_cost[side_of] = (vf)1e9f;
            for (int t = 0; t < 5; ++t) {
                const int i = reach[side_of][t][0], j = reach[side_of][t][1];
                if (row + j < 0 || row + j >= height) continue;
                const float* o = other_row(j) + k0 + ((p + i) >> 1);
                const vf c = LOAD(o + 3 * S), ow = LOAD(o), oa = LOAD(o + S), ob = LOAD(o + 2 * S);
                if (t == 0) {
                    near_w[side_of] = ow;
                    near_cost[side_of] = c;
                }
                const vi lower = c < bc;
                bw = lower ? ow - (float)i * oa - (float)j * ob : bw;
                ba = lower ? oa : ba;
                bb = lower ? ob : bb;
                bc = lower ? c : bc;
            }
            attempt(bc < NONE ? bw : (vf)-1.f, ba, bb);
        }
        // the plane through the four neighbours
        {
            vi whole = active;
            for (int t = 0; t < 4; ++t) whole = whole & (near_cost[t] < NONE);
            const vf middle = 0.25f * (near_w[0] + near_w[1] + near_w[2] + near_w[3]);
            attempt(whole ? middle : (vf)-1.f, 0.5f * (near_w[3] - near_w[2]), 0.5f * (near_w[1] - near_w[0]));
        }
        // trials around the best: of depth, then of slope, over several sizes
        vu hash = __builtin_convertvector(lane_i + k0, vu) * 2u + (unsigned)p;
        hash = (hash * 0x9E3779B1u) ^ ((unsigned)(row + 1) * 0x85EBCA77u) ^ ((unsigned)(view + 1) * 0xC2B2AE3Du)
            ^ ((unsigned)(turn + 1) * 0x27D4EB2Fu);
        auto random = [&]() -> vf {                               // in [0, 1)
            hash = hash * 747796405u + 2891336453u;
            vu word = ((hash >> ((hash >> 28) + 4u)) ^ hash) * 277803737u;
            word = (word >> 22) ^ word;
            return __builtin_convertvector((vi)(word >> 8), vf) * (1.f / 16777216.f);
        };
        random();
        for (int t = 0; t < trials; ++t) {
            const vf size = vexp(0.69314718f * (least_exponent + (most_exponent - least_exponent) * random()));
            const vf sign = random() < 0.5f ? (vf)-1.f : (vf)1.f;
            const vf turn_u = 2.f * random() - 1.f, turn_v = 2.f * random() - 1.f;
            const int kind = t % 2;
            const vf shift = kind == 0 ? sign * size * unit : (vf)0.f;
            const vf change = vexp(0.69314718f * (-4.f * random() + bend_exponent));
            const vf bend = kind == 0 ? (vf)0.f : change * w * (1.f / focal);
            attempt(w + shift, du + turn_u * bend, dv + turn_v * bend);
        }

        STORE(st, w);
        STORE(st + S, du);
        STORE(st + 2 * S, dv);
        STORE(st + 3 * S, cost);
    }
"""
)
