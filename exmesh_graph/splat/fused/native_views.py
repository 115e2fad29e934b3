"""C++ of the terms between two views (kernels_terms), pixel by pixel; plain form: `consistency.multi_view`.

relation: 9 turn, 3 shift from the view's camera to the neighbour's; 6 first rows of K and 6 of its inverse, of the view
and then of the neighbour; 9 linear and 3 offset of the homographies (K of the neighbour times turn, times shift).
"""

from exmesh_graph.gpu.simd import MATHS
from exmesh_graph.splat.fused.native_terms import MARGIN

#: Compared pixels of an item.
SAMPLES = 64

COMPARE_VIEWS = (
    MATHS
    + f"""
    constexpr int MARGIN = {MARGIN};
"""
    + """
    constexpr int PATCH = 3;
    const float MISMATCH = 0.9f, CONTRAST = 0.01f * 0.01f;
    const float *turn = relation.data, *shift = turn + 9, *K = turn + 12, *L = turn + 18, *K2 = turn + 24;
    const float *L2 = turn + 30, *linear = turn + 36, *offset = turn + 45;
    const vf lane = {0.f, 1.f, 2.f, 3.f, 4.f, 5.f, 6.f, 7.f};
    const vi in_patch = lane < 2.f * PATCH + 0.5f;
    const float *z = depth.data + MARGIN, *z2 = other_depth.data + MARGIN;
    const float *mine = grey.data + MARGIN, *theirs = other_grey.data + MARGIN;
    auto all_sum = [](vf v) { float s = 0.f; for (int k = 0; k < LANES; ++k) s += v[k]; return s; };
    const int begin = item * samples, end = begin + samples < count ? begin + samples : count;
    double geometric = 0.0, photometric = 0.0;
    for (int i = begin; i < end; ++i) {
        const long pixel = pixels.data[i];
        const int column = (int)(pixel % width), row = (int)(pixel / width);
        if (!(z[pixel] > 0.f)) continue;
        const float px = column + 0.5f, py = row + 0.5f;
        const float r[3] = {L[0] * px + L[1] * py + L[2], L[3] * px + L[4] * py + L[5], 1.f};
        // to the neighbour's picture
        float m[3], way[3];                                       // way: dm / dz
        for (int k = 0; k < 3; ++k) {
            way[k] = turn[3 * k] * r[0] + turn[3 * k + 1] * r[1] + turn[3 * k + 2];
            m[k] = z[pixel] * way[k] + shift[k];
        }
        if (!(m[2] > 1e-6f)) continue;
        const float u = m[0] / m[2], v = m[1] / m[2];
        const float qx = K2[0] * u + K2[1] * v + K2[2], qy = K2[3] * u + K2[4] * v + K2[5];
        if (!(qx > 0.5f && qx < width - 0.5f && qy > 0.5f && qy < height - 0.5f)) continue;
        // the depth there, where all four pixels around have one
        const float fx = qx - 0.5f < width - 1.001f ? qx - 0.5f : width - 1.001f;
        const float fy = qy - 0.5f < height - 1.001f ? qy - 0.5f : height - 1.001f;
        const int left = (int)fx, above = (int)fy;
        const float s = fx - left, t = fy - above;
        const float* c = z2 + (long)above * width + left;
        if (!(c[0] > 0.f && c[1] > 0.f && c[width] > 0.f && c[width + 1] > 0.f)) continue;
        const float up = c[0] + s * (c[1] - c[0]), down = c[width] + s * (c[width + 1] - c[width]);
        const float found = up + t * (down - up);
        const float slope_x = (1.f - t) * (c[1] - c[0]) + t * (c[width + 1] - c[width]), slope_y = down - up;
        // and back
        const float r2[3] = {L2[0] * qx + L2[1] * qy + L2[2], L2[3] * qx + L2[4] * qy + L2[5], 1.f};
        float b[3];
        for (int k = 0; k < 3; ++k) {
            b[k] = 0.f;
            for (int l = 0; l < 3; ++l) b[k] += turn[3 * l + k] * (found * r2[l] - shift[l]);
        }
        if (!(b[2] > 1e-6f)) continue;
        const float u2 = b[0] / b[2], v2 = b[1] / b[2];
        const float ex = K[0] * u2 + K[1] * v2 + K[2] - px, ey = K[3] * u2 + K[4] * v2 + K[5] - py;
        const float miss = __builtin_sqrtf(ex * ex + ey * ey + 1e-12f);
        if (!(miss < 1.f)) continue;
        const float weight = vexp((vf)-miss)[0];
        geometric += weight * miss;
        {   // the way back, by the chain rule from the last line up
            const float g = by_geometric * weight / miss, gx = g * ex, gy = g * ey;
            const float gu = gx * K[0] + gy * K[3], gv = gx * K[1] + gy * K[4];
            const float gb[3] = {gu / b[2], gv / b[2], -(gu * u2 + gv * v2) / b[2]};
            float there[3], by_found = 0.f;
            for (int k = 0; k < 3; ++k) {
                there[k] = turn[3 * k] * gb[0] + turn[3 * k + 1] * gb[1] + turn[3 * k + 2] * gb[2];
                by_found += there[k] * r2[k];
            }
            const float gqx = found * (there[0] * L2[0] + there[1] * L2[3]) + by_found * slope_x;
            const float gqy = found * (there[0] * L2[1] + there[1] * L2[4]) + by_found * slope_y;
            const float hu = gqx * K2[0] + gqy * K2[3], hv = gqx * K2[1] + gqy * K2[4];
            const float by_z = (hu * way[0] + hv * way[1] - (hu * u + hv * v) * way[2]) / m[2];
            const float to_d = by_z * z[pixel] / distance.data[pixel];
            to_distance.data[pixel] += to_d;
            for (int k = 0; k < 3; ++k) to_normal.data[3 * pixel + k] -= to_d * z[pixel] * r[k];
        }
        if (row < PATCH || row >= height - PATCH || column < PATCH || column >= width - PATCH) continue;
        float n[3], p[3];
        for (int k = 0; k < 3; ++k) {
            n[k] = normal.data[3 * pixel + k];
            p[k] = n[k] / distance.data[pixel];
        }
        // patches: a row of seven pixels in each vector
        vf a[7], o[7], rise_x[7], rise_y[7], place_x[7], place_y[7], depth_of[7];
        bool inside = true;
        vf a_sum = 0.f, o_sum = 0.f;
        for (int k = 0; inside && k < 7; ++k) {
            const vf x = lane + (column - PATCH + 0.5f);
            const float y = row - PATCH + k + 0.5f;
            const vf rx = L[0] * x + (L[1] * y + L[2]), ry = L[3] * x + (L[4] * y + L[5]);
            const vf ahead = p[0] * rx + p[1] * ry + p[2];
            const vf sx = linear[0] * rx + linear[1] * ry + linear[2] + ahead * offset[0];
            const vf sy = linear[3] * rx + linear[4] * ry + linear[5] + ahead * offset[1];
            const vf sz = linear[6] * rx + linear[7] * ry + linear[8] + ahead * offset[2];
            const vf tx = sx / sz, ty = sy / sz;
            const vi good = (sz * ahead > 0.f) & (tx > 1.f) & (tx < width - 1.f) & (ty > 1.f) & (ty < height - 1.f);
            if (__builtin_reduce_or(in_patch & ~good)) { inside = false; break; }
            const vf cx = in_patch ? tx - 0.5f : (vf)1.f, cy = in_patch ? ty - 0.5f : (vf)1.f;
            const vf x0 = __builtin_elementwise_floor(cx), y0 = __builtin_elementwise_floor(cy);
            const vf f = cx - x0, h = cy - y0;
            const vi cell = __builtin_convertvector(y0, vi) * width + __builtin_convertvector(x0, vi);
            vf c00 = 0.f, c01 = 0.f, c10 = 0.f, c11 = 0.f;
            for (int l = 0; l < 7; ++l) {
                const float* e = theirs + cell[l];
                c00[l] = e[0]; c01[l] = e[1]; c10[l] = e[width]; c11[l] = e[width + 1];
            }
            const vf first = c00 + f * (c01 - c00), second = c10 + f * (c11 - c10);
            o[k] = first + h * (second - first);
            rise_x[k] = (c01 - c00) + h * ((c11 - c10) - (c01 - c00));
            rise_y[k] = second - first;
            place_x[k] = tx; place_y[k] = ty; depth_of[k] = sz;
            a[k] = in_patch ? LOAD(mine + (long)(row - PATCH + k) * width + column - PATCH) : (vf)0.f;
            a_sum += a[k];
            o_sum += o[k];
        }
        if (!inside) continue;
        const float a_mean = all_sum(a_sum) * (1.f / 49), o_mean = all_sum(o_sum) * (1.f / 49);
        vf aa = 0.f, oo = 0.f, ao = 0.f;
        for (int k = 0; k < 7; ++k) {
            a[k] = in_patch ? a[k] - a_mean : (vf)0.f;
            o[k] = in_patch ? o[k] - o_mean : (vf)0.f;
            aa += a[k] * a[k]; oo += o[k] * o[k]; ao += a[k] * o[k];
        }
        const float A = all_sum(aa) * (1.f / 49), O = all_sum(oo) * (1.f / 49), C = all_sum(ao) * (1.f / 49);
        if (!(A > CONTRAST && O > CONTRAST)) continue;
        float score = 1.f - C * C / (A * O);
        score = score > 0.f ? score : 0.f;
        if (!(score < MISMATCH)) continue;
        photometric += weight * score;
        // d score / d o = -2 C / (49 A O) (a - C / O o)
        const float by = by_photometric * weight * -2.f * C / (49.f * A * O), share = C / O;
        vf to_p[3] = {0.f, 0.f, 0.f};
        for (int k = 0; k < 7; ++k) {
            const vf g = by * (a[k] - share * o[k]), gx = g * rise_x[k], gy = g * rise_y[k];
            vf by_ahead = gx * offset[0] + gy * offset[1] - (gx * place_x[k] + gy * place_y[k]) * offset[2];
            by_ahead = in_patch ? by_ahead / depth_of[k] : (vf)0.f;
            const vf x = lane + (column - PATCH + 0.5f);
            const float y = row - PATCH + k + 0.5f;
            to_p[0] += by_ahead * (L[0] * x + (L[1] * y + L[2]));
            to_p[1] += by_ahead * (L[3] * x + (L[4] * y + L[5]));
            to_p[2] += by_ahead;
        }
        const float d = distance.data[pixel];
        float to_d = 0.f;
        for (int k = 0; k < 3; ++k) {
            const float g = all_sum(to_p[k]);
            to_normal.data[3 * pixel + k] += g / d;
            to_d -= g * p[k];
        }
        to_distance.data[pixel] += to_d / d;
    }
    totals.data[2 * item] = geometric;
    totals.data[2 * item + 1] = photometric;
"""
)
