"""C++ of bilinear lookups in a stack of maps of several sizes, a level per lane."""

CORNERS = r"""
    // rows of a stack of maps around (u, v) in the level of each lane, and their weights
    auto corners = [&](vi level, vf u, vf v, vi* row, vf* w) {
        vi high, wide, start;
        for (int j = 0; j < 8; ++j) {
            high[j] = levels.data[3 * level[j]];
            wide[j] = levels.data[3 * level[j] + 1];
            start[j] = levels.data[3 * level[j] + 2];
        }
        const vf h = __builtin_convertvector(high, vf), x = u * __builtin_convertvector(wide, vf) - 0.5f;
        vf y = v * h - 0.5f;
        y = y > 0.f ? y : (vf)0.f;
        y = y < h - 1.f ? y : h - 1.f;
        const vf x0 = __builtin_elementwise_floor(x);
        vf y0 = __builtin_elementwise_floor(y);
        y0 = y0 < h - 2.f ? y0 : h - 2.f;
        y0 = y0 > 0.f ? y0 : (vf)0.f;
        const vf fx = x - x0, fy = y - y0;
        vi left = __builtin_convertvector(x0, vi), top = __builtin_convertvector(y0, vi);
        left = left < 0 ? left + wide : left;
        left = left >= wide ? left - wide : left;
        const vi right = left + 1 < wide ? left + 1 : (vi)0;
        const vi bottom = top + 1 < high ? top + 1 : top;
        const vi r[4] = {start + top * wide + left, start + top * wide + right,
                         start + bottom * wide + left, start + bottom * wide + right};
        for (int k = 0; k < 4; ++k) row[k] = r[k];
        w[0] = (1.f - fx) * (1.f - fy);
        w[1] = fx * (1.f - fy);
        w[2] = (1.f - fx) * fy;
        w[3] = fx * fy;
    };
"""
"""Wants `levels` int [L, 3]: the maps' height, width and first row (shading.envmap.bilinear, of a level per lane)."""
