"""Where a shading normal and the flat face under it disagree: ray origins on the smooth surface, bent normals.

A coarse face under interpolated normals shows two faults. Light that is above the smooth horizon and below the face's
own is cut off, in steps from face to face (the shadow terminator); and a shading normal may look away from the viewer,
who then sees black. Hanika (Ray Tracing Gems II, ch. 4) starts the ray on the surface that the normals describe.
"""

from __future__ import annotations

import torch


def smooth_origins(
    points: torch.Tensor, bary: torch.Tensor, corners: torch.Tensor, corner_normals: torch.Tensor
) -> torch.Tensor:
    """Points [N, 3] of flat faces, moved out onto the surface that the corner normals describe.

        p' = p + sum_i b_i max(0, (v_i - p) . n_i) n_i

    the mean of p's projections onto the corners' tangent planes, of those that lie above it. Convex regions rise by
    the height of the smooth surface over the face; flat and concave ones stay; corners stay; scale-free.
    bary [N, 3]; corners [N, 3, 3]; corner_normals [N, 3, 3] unit, outward.
    """
    towards = corners - points[:, None]
    height = (towards * corner_normals).sum(-1).clamp_min(0)
    return points + ((bary * height)[..., None] * corner_normals).sum(1)


def bend_normals(
    shading: torch.Tensor, geometric: torch.Tensor, view: torch.Tensor, threshold: float = 0.1
) -> torch.Tensor:
    """Unit shading normals [N, 3] that face the viewer: bent towards the face's own where they nearly do not.

        n = normalise(n_g + t (n_s - n_g)),   t = clamp(n_s . v / threshold, 0, 1)

    n_s where it faces the viewer by more than `threshold`, n_g where it looks away, and continuous between. n . v > 0
    wherever n_g . v > 0. shading, geometric, view [N, 3] unit; geometric on the viewer's side.
    """
    share = ((shading * view).sum(-1, keepdim=True) / threshold).clamp(0, 1)
    bent = geometric + share * (shading - geometric)
    return bent / (bent * bent).sum(-1, keepdim=True).clamp_min(1e-12).sqrt()
