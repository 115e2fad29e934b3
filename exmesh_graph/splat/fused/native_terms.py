"""C++ of the terms of a picture (kernels_terms): colour and coverage against the photograph, normals against depth.

Plain forms: `losses.l1`, `render.plane_depth`, `consistency.single_view_normal`.
Planes that are read beside a pixel have eight floats more at either end.
"""

from exmesh_graph.gpu.simd import MATHS

#: Rows of a picture that an item is for.
ROWS = 16
#: Floats before and after a padded plane.
MARGIN = 8

_COMMON = (
    MATHS
    + f"""
    constexpr int MARGIN = {MARGIN};
"""
    + """
    const int top = band * rows, bottom = top + rows < height ? top + rows : height;
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
    // channel c of interleaved colours or vectors
    auto channel = [](const float* p, int c, int lanes) {
        vf v = 0.f;
        for (int k = 0; k < LANES; ++k) if (k < lanes) v[k] = p[3 * k + c];
        return v;
    };
    auto size_of = [](vf v) { return __builtin_elementwise_abs(v); };
    auto sign_of = [](vf v) { return v > 0.f ? (vf)1.f : (v < 0.f ? (vf)-1.f : (vf)0.f); };
    auto sum_of = [](vf v) { double s = 0.0; for (int k = 0; k < LANES; ++k) s += v[k]; return s; };
"""
)

# rays of pixels have z = 1 and are affine in the pixel: (L0 x + L1 y + L2, L3 x + L4 y + L5), L the inverse of K
_RAYS = """
    const float* L = lens.data;
    const vf lane = {0.f, 1.f, 2.f, 3.f, 4.f, 5.f, 6.f, 7.f};
    auto ray_x = [&](vf x, float y) { return L[0] * x + (L[1] * y + L[2]); };
    auto ray_y = [&](vf x, float y) { return L[3] * x + (L[4] * y + L[5]); };
"""

COMPARE = (
    _COMMON
    + """
    double miss = 0.0, square = 0.0, uncovered = 0.0;
    const int n = 3 * width;
    for (int y = top; y < bottom; ++y) {
        const float *c = colour.data + (long)y * n, *t = target.data + (long)y * n;
        float* g = to_colour.data + (long)y * n;
        vf row_miss = 0.f, row_square = 0.f, row_uncovered = 0.f;
        for (int i = 0; i < n; i += LANES) {
            const int lanes = n - i;
            const vf d = part(c + i, lanes) - part(t + i, lanes);
            row_miss += size_of(d);
            row_square += d * d;
            put(g + i, by_miss * sign_of(d), lanes);
        }
        if (y >= box_top && y < box_bottom) {
            const int wide = 3 * (box_right - box_left);
            const float* s = in_box.data + (long)(y - box_top) * wide;
            float* h = g + 3 * box_left;
            for (int i = 0; i < wide; i += LANES) {
                const int lanes = wide - i;
                put(h + i, part(h + i, lanes) + by_ssim * part(s + i, lanes), lanes);
            }
        }
        if (gained) for (int x = 0; x < width; ++x) for (int k = 0; k < 3; ++k) g[3 * x + k] *= gain.data[k];
        const float *a = alpha.data + (long)y * width, *m = mask.data + (long)y * width;
        float* h = to_alpha.data + (long)y * width;
        for (int x = 0; x < width; x += LANES) {
            const int lanes = width - x;
            const vf d = part(a + x, lanes) - part(m + x, lanes);
            row_uncovered += size_of(d);
            put(h + x, by_alpha * sign_of(d), lanes);
        }
        miss += sum_of(row_miss);
        square += sum_of(row_square);
        uncovered += sum_of(row_uncovered);
    }
    totals.data[3 * band] = miss;
    totals.data[3 * band + 1] = square;
    totals.data[3 * band + 2] = uncovered;
"""
)

DEPTH = (
    _COMMON
    + _RAYS
    + """
    for (int y = top; y < bottom; ++y)
    for (int x = 0; x < width; x += LANES) {
        const long p = (long)y * width + x;
        const int lanes = width - x;
        const float* c = image.data + 3 * p;
        const vf sum = channel(c, 0, lanes) + channel(c, 1, lanes) + channel(c, 2, lanes);
        put(grey.data + MARGIN + p, sum * (1.f / 3), lanes);
        const vi covered = part(alpha.data + p, lanes) > 0.5f;
        vf z = 0.f;
        if (__builtin_reduce_or(covered)) {
            const vf nx = channel(normal.data + 3 * p, 0, lanes), ny = channel(normal.data + 3 * p, 1, lanes);
            const vf nz = channel(normal.data + 3 * p, 2, lanes), d = part(distance.data + p, lanes);
            const vf rx = ray_x(lane + (x + 0.5f), y + 0.5f), ry = ray_y(lane + (x + 0.5f), y + 0.5f);
            const vf facing = nx * rx + ny * ry + nz;
            const vf length = __builtin_elementwise_sqrt((nx * nx + ny * ny + nz * nz) * (rx * rx + ry * ry + 1.f));
            const vi valid = covered & (facing < -grazing * length) & (d < 0.f);
            z = valid ? d / facing : z;
        }
        put(depth.data + MARGIN + p, z, lanes);
    }
"""
)

NORMALS = (
    _COMMON
    + _RAYS
    + """
    const long plane = (long)width * height + 2 * MARGIN;
    double sum = 0.0;
    for (int y = top; y < bottom; ++y)
    for (int x = 0; x < width; x += LANES) {
        const long p = (long)y * width + x;
        const int lanes = width - x < LANES ? width - x : LANES;
        const float* z = depth.data + MARGIN + p;
        float* g = to_normal.data + 3 * p;
        float* out = pulls.data + MARGIN + p;                     // of the depths to the right, left, below, above
        vi inner = 0;
        vf east = 0.f, west = 0.f, south = 0.f, north = 0.f;
        if (y > 0 && y < height - 1) {
            east = LOAD(z + 1); west = LOAD(z - 1);
            south = part(z + width, lanes); north = LOAD(z - width);
            inner = (LOAD(z) > 0.f) & (east > 0.f) & (west > 0.f) & (south > 0.f) & (north > 0.f);
            for (int k = 0; k < LANES; ++k) if (x + k == 0 || x + k >= width - 1) inner[k] = 0;
        }
        vf s[3] = {0.f, 0.f, 0.f}, a[4] = {0.f, 0.f, 0.f, 0.f};
        if (__builtin_reduce_or(inner)) {
            const vf at = lane + (x + 0.5f);
            const float h = y + 0.5f;
            const vf ex = ray_x(at + 1.f, h), ey = ray_y(at + 1.f, h), wx = ray_x(at - 1.f, h), wy = ray_y(at - 1.f, h);
            const vf sx = ray_x(at, h + 1.f), sy = ray_y(at, h + 1.f), nx = ray_x(at, h - 1.f), ny = ray_y(at, h - 1.f);
            const vf ax = east * ex - west * wx, ay = east * ey - west * wy, az = east - west;
            const vf dx = south * sx - north * nx, dy = south * sy - north * ny, dz = south - north;
            const vf cx = dy * az - dz * ay, cy = dz * ax - dx * az, cz = dx * ay - dy * ax;   // down x across
            const vf square = cx * cx + cy * cy + cz * cz;
            inner = inner & (square > 0.f);
            const vf inverse = 1.f / __builtin_elementwise_sqrt(inner ? square : (vf)1.f);
            const vf unit[3] = {cx * inverse, cy * inverse, cz * inverse};
            const float* e = grey.data + MARGIN + p;
            const vf across = (LOAD(e + 1) - LOAD(e - 1)) * 0.5f;
            const vf down = (part(e + width, lanes) - LOAD(e - width)) * 0.5f;
            vf w = 1.f - __builtin_elementwise_sqrt(across * across + down * down) * (1.f / strongest);
            w = inner ? w * w : (vf)0.f;
            const vf cover = part(alpha.data + p, lanes);
            vf by[3], along = 0.f;
            for (int c = 0; c < 3; ++c) {
                const vf d = unit[c] * cover - channel(normal.data + 3 * p, c, lanes);
                sum += sum_of(w * size_of(d));
                s[c] = weight * w * sign_of(d);
                by[c] = s[c] * cover;
                along += by[c] * unit[c];
            }
            for (int c = 0; c < 3; ++c) by[c] = (by[c] - along * unit[c]) * inverse;
            // down x across: across receives by x down, down receives across x by
            const vf tx = by[1] * dz - by[2] * dy, ty = by[2] * dx - by[0] * dz, tz = by[0] * dy - by[1] * dx;
            const vf ux = ay * by[2] - az * by[1], uy = az * by[0] - ax * by[2], uz = ax * by[1] - ay * by[0];
            a[0] = tx * ex + ty * ey + tz;
            a[1] = tx * wx + ty * wy + tz;
            a[2] = ux * sx + uy * sy + uz;
            a[3] = ux * nx + uy * ny + uz;
        }
        for (int c = 0; c < 3; ++c) for (int k = 0; k < lanes; ++k) g[3 * k + c] = -s[c][k];
        for (int k = 0; k < 4; ++k) put(out + k * plane, inner ? a[k] : (vf)0.f, lanes);
    }
    totals.data[band] = sum;
"""
)

PULL_BACK = (
    _COMMON
    + _RAYS
    + """
    const long plane = (long)width * height + 2 * MARGIN;
    for (int y = top; y < bottom; ++y)
    for (int x = 0; x < width; x += LANES) {
        const long p = (long)y * width + x;
        const int lanes = width - x;
        const float *a = pulls.data + MARGIN + p;
        vf by = LOAD(a - 1) - LOAD(a + plane + 1);
        if (y > 0) by += LOAD(a + 2 * plane - width);
        if (y < height - 1) by -= part(a + 3 * plane + width, lanes);
        const vf z = part(depth.data + MARGIN + p, lanes);
        const vi held = (z > 0.f) & (by != 0.f);
        vf to_d = 0.f;
        if (__builtin_reduce_or(held)) {
            // z = d / (n . r): dz/dd = 1 / (n . r) = z / d, dz/dn = -z / (n . r) r
            const vf rx = ray_x(lane + (x + 0.5f), y + 0.5f), ry = ray_y(lane + (x + 0.5f), y + 0.5f);
            const vf d = part(distance.data + p, lanes);
            to_d = held ? by * z / d : to_d;
            const vf to_n = -to_d * z;
            for (int k = 0; k < LANES; ++k) if (k < lanes && held[k]) {
                to_normal.data[3 * (p + k)] += to_n[k] * rx[k];
                to_normal.data[3 * (p + k) + 1] += to_n[k] * ry[k];
                to_normal.data[3 * (p + k) + 2] += to_n[k];
            }
        }
        put(to_distance.data + p, to_d, lanes);
    }
"""
)
