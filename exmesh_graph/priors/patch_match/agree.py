"""What other views confirm: points that come back to their pixel, at their depth and with their normal."""

from __future__ import annotations

import numpy as np
import torch

from exmesh_graph.gpu.cores import split

_MISS = 1.7
_COSINE = float(np.cos(np.radians(60.0)))
_GRAIN = 4096


def agreed_planes(
    planes: torch.Tensor,
    normals: torch.Tensor,
    matrices: torch.Tensor,
    chosen: torch.Tensor,
    *,
    needed: int,
    tolerance: float,
    miss: float = _MISS,
    cosine: float = _COSINE,
) -> tuple[torch.Tensor, torch.Tensor]:
    """(inverse depth [N, H, W], 0 where dropped; number of views that agree, int32 [N, H, W]).

    planes    float32 [N, 3, H, W]: w, du and dv, w 0 where there is none
    normals   float32 [N, H, W, 3], unit, in the world
    matrices  float32 [N, S, 24], chosen int32 [N, S]: the views asked, as of `sources.transfers`
    needed    views that must agree, of those there are: the point that a view shows at the pixel a point falls on comes
              back less than `miss` pixels away, at its inverse depth to `tolerance` of it, and its normal is less than
              60 degrees off. The result is the mean of the pixel's own and of those that agree.
    """
    from exmesh_graph.priors.patch_match.kernels_agree import agree_pixels

    count, _, height, width = planes.shape
    kept = planes.new_zeros((count, height, width))
    votes = torch.zeros((count, height, width), dtype=torch.int32)
    split(
        agree_pixels, kept.numel(), height, width, chosen.shape[1], needed, miss, tolerance, cosine,
        matrices.reshape(-1), chosen.reshape(-1), planes.reshape(-1), normals.reshape(-1, 3), kept.reshape(-1),
        votes.reshape(-1), grain=_GRAIN,
    )  # fmt: skip
    return kept, votes


def normals_of(planes: torch.Tensor, intrinsics: torch.Tensor) -> torch.Tensor:
    """Unit normals [N, H, W, 3] towards the camera, in its axes, of planes [N, 3, H, W]; intrinsics [N, 3, 3].

    w = n . K^-1 (x, y, 1) / d, so n is along K^T (du, dv, w - du x - dv y), away from the camera. 0 where w is 0.
    """
    w, du, dv = planes.unbind(dim=1)
    height, width = w.shape[1:]
    x = torch.arange(width, dtype=w.dtype) + 0.5
    y = torch.arange(height, dtype=w.dtype)[:, None] + 0.5
    rows = torch.stack([du, dv, w - du * x - dv * y], dim=-1)
    along = torch.einsum("nhwj,njk->nhwk", rows, intrinsics.to(w))
    length = along.norm(dim=-1, keepdim=True)
    return torch.where((w > 0)[..., None], -along / length.clamp(min=1e-20), 0.0)
