"""Ray queries with torch tensors: on the tracer's own device where it has one, else over arrays and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from exmesh_graph.rays.tracer import RayTracer


@dataclass(frozen=True)
class TensorHits:
    """`Hits` as tensors: face int32 [N] (-1 for none), t float32 [N] (inf for none), bary float32 [N, 3]."""

    face: torch.Tensor
    t: torch.Tensor
    bary: torch.Tensor


def closest_hit(
    tracer: RayTracer, origins: torch.Tensor, directions: torch.Tensor, t_max: float | torch.Tensor = np.inf
) -> TensorHits:
    """`tracer.closest_hit` for tensors [N, 3]; the result lies where they do. No gradients."""
    on_device = getattr(tracer, "closest_hit_tensors", None)
    if on_device is not None and tracer.device == origins.device:  # type: ignore[attr-defined]
        return on_device(origins.detach(), directions.detach(), t_max)
    hits = tracer.closest_hit(_array(origins), _array(directions), _limit(t_max))
    return TensorHits(*(torch.from_numpy(column).to(origins.device) for column in (hits.face, hits.t, hits.bary)))


def any_hit(
    tracer: RayTracer, origins: torch.Tensor, directions: torch.Tensor, t_max: float | torch.Tensor = np.inf
) -> torch.Tensor:
    """`tracer.any_hit` for tensors [N, 3]: bool [N] on their device. No gradients."""
    on_device = getattr(tracer, "any_hit_tensors", None)
    if on_device is not None and tracer.device == origins.device:  # type: ignore[attr-defined]
        return on_device(origins.detach(), directions.detach(), t_max)
    return torch.from_numpy(tracer.any_hit(_array(origins), _array(directions), _limit(t_max))).to(origins.device)


def _array(tensor: torch.Tensor) -> np.ndarray:
    return tensor.detach().cpu().numpy()


def _limit(t_max: float | torch.Tensor) -> float | np.ndarray:
    return _array(t_max) if isinstance(t_max, torch.Tensor) else t_max
