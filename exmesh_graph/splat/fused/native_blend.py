"""C++ of lists of Gaussians by tile, of blending and its adjoint (kernels_draw); formulas: kernels_blend.

A tile is blended in blocks of SIDE x SIDE pixels, whose sums lie plane by plane on the stack: one block stays in the
cache for all of its Gaussians. A row of a Gaussian's ellipse is taken eight pixels at a time from its first column on,
so that a Gaussian of up to eight columns costs one vector a row. A word for each row has a bit for each pixel that
still lets light through: what lies behind opaque pixels costs a few operations, not its ellipse.
"""

from exmesh_graph.gpu.simd import MATHS
from exmesh_graph.splat.fused.native_eight import SHUFFLES

#: Side of a block in pixels, bits of a word. A block's rows have eight more, which show nothing.
SIDE = 32

LIST_TILES = """
    const int begin = block * block_size, end = begin + block_size < count ? begin + block_size : count;
    for (int g = begin; g < end; ++g) {
        const int* b = box.data + 4 * (long)g;
        int slot = first_slot.data[g];
        if (slot == first_slot.data[g + 1]) continue;
        for (int y = b[1] / tile; y <= b[3] / tile; ++y)
            for (int x = b[0] / tile; x <= b[2] / tile; ++x) tile_of.data[slot++] = y * across + x;
    }
"""

# radix sort of the drawn Gaussians by depth (positive floats order as their bits do), then a counting sort by tile
SORT = """
    typedef unsigned int u32;
    int* keys = memory.data;                                      // (bits, Gaussian) twice; a tile's next place
    u32 tally[3][2048];
    for (int p = 0; p < 3; ++p) for (int k = 0; k < 2048; ++k) tally[p][k] = 0;
    int n = 0;
    for (int g = 0; g < count; ++g) {
        if (first_slot.data[g] == first_slot.data[g + 1]) continue;
        const u32 bits = ((const u32*)depth.data)[g];
        keys[2 * n] = (int)bits;
        keys[2 * n + 1] = g;
        ++n;
        for (int p = 0; p < 3; ++p) ++tally[p][(bits >> (11 * p)) & 2047];
    }
    int *from = keys, *to = keys + 2 * (long)count;
    for (int p = 0; p < 3; ++p) {
        u32 sum = 0;
        for (int k = 0; k < 2048; ++k) { const u32 here = tally[p][k]; tally[p][k] = sum; sum += here; }
        for (int k = 0; k < n; ++k) {
            const u32 place = tally[p][((u32)from[2 * k] >> (11 * p)) & 2047]++;
            to[2 * place] = from[2 * k];
            to[2 * place + 1] = from[2 * k + 1];
        }
        int* other = from; from = to; to = other;
    }
    for (int t = 0; t <= tiles; ++t) start.data[t] = 0;
    for (int s = 0; s < slots; ++s) ++start.data[tile_of.data[s] + 1];
    for (int t = 0; t < tiles; ++t) start.data[t + 1] += start.data[t];
    int* next = keys + 4 * (long)count;
    for (int t = 0; t < tiles; ++t) next[t] = start.data[t];
    for (int k = 0; k < n; ++k) {
        const int g = from[2 * k + 1];
        for (int slot = first_slot.data[g]; slot < first_slot.data[g + 1]; ++slot) {
            const int e = next[tile_of.data[slot]]++;
            entries.data[2 * (long)e] = slot;
            entries.data[2 * (long)e + 1] = g;
        }
    }
"""

SUM_SLOTS = (
    MATHS
    + """
    const int begin = block * block_size, end = begin + block_size < count ? begin + block_size : count;
    double seen = 0.0;
    vd thick = 0.0;
    for (int i = begin; i < end; i += LANES) {
        vf least = -1e30f;
        for (int g = i; g < i + LANES && g < end; ++g) {
            float sum = 0.f;
            for (int slot = first_slot.data[g]; slot < first_slot.data[g + 1]; ++slot) sum += weights.data[slot];
            weight.data[g] = sum;
            if (!(sum > 0.f)) continue;
            seen += 1.0;
            const float* s = scales.data + 3 * (long)g;
            const float low = s[0] < s[1] ? s[0] : s[1];
            least[g - i] = low < s[2] ? low : s[2];
        }
        thick += __builtin_convertvector(least > -1e30f ? vexp(least) : (vf)0.f, vd);
    }
    thickness.data[2 * block] = seen;
    thickness.data[2 * block + 1] = total(thick);
"""
)

_COMMON = (
    MATHS
    + SHUFFLES
    + f"""
    constexpr int SIDE = {SIDE}, STRIDE = SIDE + LANES, AREA = SIDE * STRIDE + 16;
"""
    + """
    const float MOST = 0.99f, OPAQUE = 1e-4f, LEAST_LOG = -7.9943534f;   // log2(1 / 255)
    const vf lane = {0.f, 1.f, 2.f, 3.f, 4.f, 5.f, 6.f, 7.f};
    typedef unsigned int u32;
    typedef bool vb __attribute__((ext_vector_type(LANES)));
    auto mask_of = [](vi m) { return (u32)__builtin_bit_cast(unsigned char, __builtin_convertvector(m, vb)); };
    auto fma = [](vf a, vf b, vf c) { return __builtin_elementwise_fma(a, b, c); };
    // 2^x for -126 <= x <= 0 by its series on |r| <= 1/2: within 2e-7 of it
    auto exp2_of = [&](vf x) {
        const vf n = __builtin_elementwise_rint(x), r = x - n;
        vf p = 1.54035304e-4f;
        p = fma(p, r, 1.33335581e-3f);
        p = fma(p, r, 9.61812911e-3f);
        p = fma(p, r, 5.55041087e-2f);
        p = fma(p, r, 2.40226507e-1f);
        p = fma(p, r, 6.93147181e-1f);
        p = fma(p, r, 1.f);
        return p * (vf)((__builtin_convertvector(n, vi) + 127) << 23);
    };
    // what an entry needs lies anywhere in memory: ask for it some entries ahead
    constexpr int AHEAD = 12;
    auto ask = [&](int e) {
        const long slot = entries.data[2 * (long)e], g = entries.data[2 * (long)e + 1];
        __builtin_prefetch(records.data + 16 * g);
        __builtin_prefetch(box.data + 4 * g);
        __builtin_prefetch(weights.data + slot);
    };
    const int n = (int)((long)item * spread % tiles);             // neighbours are items far apart: runs weigh alike
    const int left_of_tile = (n % across) * tile, top_of_tile = (n / across) * tile;
    const int from_entry = start.data[n], to_entry = start.data[n + 1];
    int x_low, y_low, wide, high;                                 // the block
    // rows [top, bottom] of a Gaussian in the block, and the columns (from the block's left) of each
    int top, bottom;
    float column_from[SIDE + LANES], column_to[SIDE + LANES];
    auto rows_of = [&](const float* r, const int* b) {
        top = b[1] > y_low ? b[1] : y_low;
        bottom = b[3] < y_low + high - 1 ? b[3] : y_low + high - 1;
        const float shrink = -0.5f / r[2], reach = r[5] - LEAST_LOG;
        for (int y = top; y <= bottom; y += LANES) {
            const vf dy = lane + ((float)y + 0.5f - r[1]), across_ = r[3] * dy;
            const vf inside = across_ * across_ - 4.f * r[2] * (r[4] * dy * dy + reach);
            const vf half = __builtin_elementwise_sqrt(inside > 0.f ? inside : (vf)0.f) * shrink + 0.02f;
            const vf middle = across_ * shrink + (r[0] - 0.5f - (float)x_low);
            vf low = __builtin_elementwise_ceil(middle - half), up = __builtin_elementwise_floor(middle + half);
            low = low > 0.f ? low : (vf)0.f;
            up = up < wide - 1.f ? up : (vf)(wide - 1.f);
            STORE(column_from + (y - top), low);
            STORE(column_to + (y - top), inside > -0.01f ? up : (vf)-1.f);
        }
    };
"""
)

BLEND = (
    _COMMON
    + """
    float passed[AREA], sums[7][AREA];                            // transmittance, and sums of w f
    int last_of[AREA];
    u32 open[SIDE];                                               // of each row, the pixels that let light through
    auto bits = [](int from, int to) { return (2u << to) - (1u << from); };
    for (y_low = top_of_tile; y_low < top_of_tile + tile && y_low < height; y_low += SIDE)
    for (x_low = left_of_tile; x_low < left_of_tile + tile && x_low < width; x_low += SIDE) {
        const int edge = tile < SIDE ? tile : SIDE;
        wide = width - x_low < edge ? width - x_low : edge;
        high = height - y_low < edge ? height - y_low : edge;
        for (int y = 0; y < high; ++y) for (int x = 0; x < STRIDE; ++x) {
            passed[y * STRIDE + x] = x < wide ? 1.f : 0.f;
            if (x < wide) middle.data[(long)(y_low + y) * width + x_low + x] = -1;
            last_of[y * STRIDE + x] = to_entry;
            for (int c = 0; c < 7; ++c) sums[c][y * STRIDE + x] = 0.f;
        }
        int live = wide * high;
        for (int y = 0; y < high; ++y) open[y] = bits(0, wide - 1);
        for (int e = from_entry; e < to_entry && live > 0; ++e) {
            if (e + AHEAD < to_entry) ask(e + AHEAD);
            const int slot = entries.data[2 * (long)e], g = entries.data[2 * (long)e + 1];
            const float* r = records.data + 16 * (long)g;
            const int* b = box.data + 4 * (long)g;
            u32 any = 0;
            for (int y = b[1] > y_low ? b[1] : y_low; y <= b[3] && y < y_low + high; ++y) any |= open[y - y_low];
            const int b_from = b[0] > x_low ? b[0] - x_low : 0, b_to = b[2] < x_low + wide ? b[2] - x_low : wide - 1;
            if (b_from > b_to || !(any & bits(b_from, b_to))) continue;
            rows_of(r, b);
            const vf f0 = r[8], f1 = r[9], f2 = r[10], f3 = r[11], f4 = r[12], f5 = r[13], f6 = r[6];
            vf total = 0.f;
            for (int y = top; y <= bottom; ++y) {
                const int row = (y - y_low) * STRIDE;
                const int c_from = (int)column_from[y - top], c_to = (int)column_to[y - top];
                if (c_from > c_to) continue;
                const u32 seen = open[y - y_low] & bits(c_from, c_to);
                if (!seen) continue;
                const float dy = (float)y + 0.5f - r[1], turn = r[3] * dy, base = r[4] * dy * dy + r[5];
                const int to = 31 - __builtin_clz(seen);
                for (int x = __builtin_ctz(seen); x <= to; x += LANES) {
                    const int at = row + x;
                    const vf t = LOAD(passed + at), dx = lane + ((float)(x_low + x) + 0.5f - r[0]);
                    const vf p = fma(dx, fma((vf)r[2], dx, (vf)turn), (vf)base);
                    const vi hit = (t >= OPAQUE) & (p >= LEAST_LOG);
                    if (!__builtin_reduce_or(hit)) continue;
                    vf alpha = exp2_of(p);
                    alpha = alpha < MOST ? alpha : (vf)MOST;
                    const vf w = hit ? t * alpha : (vf)0.f, after = t - w;
                    STORE(passed + at, after);
                    if (coloured) {
                        STORE(sums[0] + at, fma(w, f0, LOAD(sums[0] + at)));
                        STORE(sums[1] + at, fma(w, f1, LOAD(sums[1] + at)));
                        STORE(sums[2] + at, fma(w, f2, LOAD(sums[2] + at)));
                    }
                    STORE(sums[3] + at, fma(w, f3, LOAD(sums[3] + at)));
                    STORE(sums[4] + at, fma(w, f4, LOAD(sums[4] + at)));
                    STORE(sums[5] + at, fma(w, f5, LOAD(sums[5] + at)));
                    STORE(sums[6] + at, fma(w, f6, LOAD(sums[6] + at)));
                    total += w;
                    u32 half = mask_of((t >= 0.5f) & (after < 0.5f) & hit), full = mask_of(hit & (after < OPAQUE));
                    for (; half; half &= half - 1)
                        middle.data[(long)y * width + x_low + x + __builtin_ctz(half)] = g;
                    live -= __builtin_popcount(full);
                    open[y - y_low] &= ~(full << x);
                    for (; full; full &= full - 1) last_of[at + __builtin_ctz(full)] = e + 1;
                }
            }
            float sum = 0.f;
            for (int k = 0; k < LANES; ++k) sum += total[k];
            weights.data[slot] += sum;
        }
        for (int y = 0; y < high; ++y) {
            const long pixel = (long)(y_low + y) * width + x_low;
            for (int x = 0; x < wide; ++x) {
                const int at = y * STRIDE + x;
                for (int c = 0; c < 3; ++c) {
                    colour.data[3 * (pixel + x) + c] = sums[c][at];
                    normal.data[3 * (pixel + x) + c] = sums[3 + c][at];
                }
                distance.data[pixel + x] = sums[6][at];
                alpha_out.data[pixel + x] = 1.f - passed[at];
                left.data[pixel + x] = passed[at];
                last.data[pixel + x] = last_of[at];
            }
        }
    }
"""
)

BLEND_ADJOINT = (
    _COMMON
    + """
    float passed[AREA], behind[AREA], to[8][AREA];                // to: dL/d(rgb, normal, distance, alpha)
    int last_of[AREA];
    bool again = false;
    for (y_low = top_of_tile; y_low < top_of_tile + tile && y_low < height; y_low += SIDE)
    for (x_low = left_of_tile; x_low < left_of_tile + tile && x_low < width; x_low += SIDE) {
        const int edge = tile < SIDE ? tile : SIDE;
        wide = width - x_low < edge ? width - x_low : edge;
        high = height - y_low < edge ? height - y_low : edge;
        for (int y = 0; y < high; ++y) {
            const long pixel = (long)(y_low + y) * width + x_low;
            for (int x = 0; x < STRIDE; ++x) {
                const int at = y * STRIDE + x;
                const bool in = x < wide;
                passed[at] = in ? left.data[pixel + x] : 1.f;
                last_of[at] = in ? last.data[pixel + x] : 0;
                behind[at] = 0.f;
                for (int c = 0; c < 3; ++c) {
                    to[c][at] = in ? to_colour.data[3 * (pixel + x) + c] : 0.f;
                    to[3 + c][at] = in ? to_normal.data[3 * (pixel + x) + c] : 0.f;
                }
                to[6][at] = in ? to_distance.data[pixel + x] : 0.f;
                to[7][at] = in ? to_alpha.data[pixel + x] : 0.f;
            }
        }
        for (int e = to_entry - 1; e >= from_entry; --e) {
            if (e - AHEAD >= from_entry) ask(e - AHEAD);
            if (e - AHEAD / 2 >= from_entry) {
                const long next = entries.data[2 * (long)(e - AHEAD / 2)];
                if (weights.data[next] > 0.f) __builtin_prefetch(slots.data + 16 * next, 1);
            }
            const int slot = entries.data[2 * (long)e], g = entries.data[2 * (long)e + 1];
            if (!(weights.data[slot] > 0.f)) continue;
            const float* r = records.data + 16 * (long)g;
            rows_of(r, box.data + 4 * (long)g);
            const vf f0 = r[8], f1 = r[9], f2 = r[10], f3 = r[11], f4 = r[12], f5 = r[13], f6 = r[6];
            vf sum[16];                                           // features 7; s 1, u, v, u^2, u v, v^2; |.| 2
            for (int k = 0; k < 16; ++k) sum[k] = 0.f;
            for (int y = top; y <= bottom; ++y) {
                const float dy = (float)y + 0.5f - r[1], turn = r[3] * dy, base = r[4] * dy * dy + r[5];
                const int row = (y - y_low) * STRIDE, end = (int)column_to[y - top];
                vf row_s = 0.f, row_su = 0.f;
                for (int x = (int)column_from[y - top]; x <= end; x += LANES) {
                    const int at = row + x;
                    const vf dx = lane + ((float)(x_low + x) + 0.5f - r[0]);
                    const vf p = fma(dx, fma((vf)r[2], dx, (vf)turn), (vf)base);
                    const vi hit = (e < *(const vi*)(last_of + at)) & (p >= LEAST_LOG);
                    if (!__builtin_reduce_or(hit)) continue;
                    const vf raw = exp2_of(p);
                    vf alpha = raw < MOST ? raw : (vf)MOST;
                    alpha = hit ? alpha : (vf)0.f;
                    const vf inverse = 1.f / (1.f - alpha), t = LOAD(passed + at) * inverse, w = t * alpha;
                    STORE(passed + at, t);
                    vf u = LOAD(to[7] + at), h;
                    h = LOAD(to[0] + at); u = fma(h, f0, u); sum[0] = fma(w, h, sum[0]);
                    h = LOAD(to[1] + at); u = fma(h, f1, u); sum[1] = fma(w, h, sum[1]);
                    h = LOAD(to[2] + at); u = fma(h, f2, u); sum[2] = fma(w, h, sum[2]);
                    h = LOAD(to[3] + at); u = fma(h, f3, u); sum[3] = fma(w, h, sum[3]);
                    h = LOAD(to[4] + at); u = fma(h, f4, u); sum[4] = fma(w, h, sum[4]);
                    h = LOAD(to[5] + at); u = fma(h, f5, u); sum[5] = fma(w, h, sum[5]);
                    h = LOAD(to[6] + at); u = fma(h, f6, u); sum[6] = fma(w, h, sum[6]);
                    const vf back = LOAD(behind + at);
                    STORE(behind + at, fma(w, u, back));
                    const vf s = (hit & (raw <= MOST)) ? raw * (t * u - back * inverse) : (vf)0.f;
                    const vf su = s * dx;
                    row_s += s;
                    row_su += su;
                    sum[10] = fma(su, dx, sum[10]);
                    const vf by_x = s * fma((vf)(2.f * r[2]), dx, (vf)turn);
                    const vf by_y = s * fma((vf)r[3], dx, (vf)(2.f * r[4] * dy));
                    sum[13] += __builtin_elementwise_abs(by_x);
                    sum[14] += __builtin_elementwise_abs(by_y);
                }
                sum[7] += row_s;
                sum[8] += row_su;
                sum[9] = fma(row_s, (vf)dy, sum[9]);
                sum[11] = fma(row_su, (vf)dy, sum[11]);
                sum[12] = fma(row_s, (vf)(dy * dy), sum[12]);
            }
            float* out = slots.data + 16 * (long)slot;
            const vf low = sums_of(sum), up = sums_of(sum + 8);
            STORE(out, again ? LOAD(out) + low : low);
            STORE(out + 8, again ? LOAD(out + 8) + up : up);
        }
        again = true;
    }
"""
)
