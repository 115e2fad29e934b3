"""Ray queries over Warp's bounding volume hierarchy: the tracer on CUDA. On the CPU it runs serially, for parity tests.

Tensors stay on the device: `closest_hit_tensors` and `any_hit_tensors`. The array methods of the RayTracer protocol
copy to the device and back.
"""

from __future__ import annotations

import numpy as np
import torch

from exmesh_graph.geometry.unit import unit_mesh
from exmesh_graph.gpu.warp_runtime import launch, warp
from exmesh_graph.rays.tensors import TensorHits
from exmesh_graph.rays.tracer import Hits

#: What the queries are told instead of infinity.
_FAR = 1e30
#: Margin of the triangles' boxes, as a part of the scene's radius: covers the rounding of the box test for rays
#: that start up to about 30 radii away.
MARGIN = 1e-5


class WarpTracer:
    """RayTracer on `warp.Bvh`, its mesh centred and at unit radius like embree's."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, device: str = "cuda") -> None:
        points, self._centre, self._radius = unit_mesh(vertices, faces)
        wp = warp()
        self.device = torch.device(device)
        self._points = torch.from_numpy(points).to(self.device)
        self.device = self._points.device  # with its number: "cuda" alone equals no tensor's device
        self._faces = torch.from_numpy(np.ascontiguousarray(faces, np.int32)).to(self.device)
        # the hierarchy reads its boxes for as long as it lives
        self._low, self._high = torch.empty(2, len(faces), 3, device=self.device)
        launch(_kernels().boxes, len(faces), self._points, self._faces, MARGIN, self._low, self._high)
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)  # the hierarchy is built on Warp's own stream
        self._tree = wp.Bvh(wp.from_torch(self._low, dtype=wp.vec3), wp.from_torch(self._high, dtype=wp.vec3))
        if self.device.type == "cuda":
            wp.synchronize_device(wp.device_from_torch(self.device))
        self._scene = (self._tree.id, self._points, self._faces)
        self._middle = torch.from_numpy(self._centre).to(self.device)

    @property
    def radius(self) -> float:
        return self._radius

    def closest_hit(self, origins: np.ndarray, directions: np.ndarray, t_max: float | np.ndarray = np.inf) -> Hits:
        hits = self.closest_hit_tensors(*self._tensors(origins, directions, t_max))
        return Hits(hits.face.cpu().numpy(), hits.t.cpu().numpy(), hits.bary.cpu().numpy())

    def any_hit(self, origins: np.ndarray, directions: np.ndarray, t_max: float | np.ndarray = np.inf) -> np.ndarray:
        return self.any_hit_tensors(*self._tensors(origins, directions, t_max)).cpu().numpy()

    @torch.no_grad()
    def closest_hit_tensors(
        self, origins: torch.Tensor, directions: torch.Tensor, t_max: float | torch.Tensor = np.inf
    ) -> TensorHits:
        """As `closest_hit`, for tensors [N, 3] on the tracer's device."""
        o, d, far, scale = self._prepare(origins, directions, t_max)
        face = torch.empty(len(o), dtype=torch.int32, device=self.device)
        t, bary = torch.empty_like(far), torch.empty_like(o)
        if len(o):
            launch(_kernels().closest, len(o), *self._scene, o, d, far, face, t, bary)
        return TensorHits(face, t * scale, bary)

    @torch.no_grad()
    def any_hit_tensors(
        self, origins: torch.Tensor, directions: torch.Tensor, t_max: float | torch.Tensor = np.inf
    ) -> torch.Tensor:
        """As `any_hit`, for tensors [N, 3] on the tracer's device."""
        o, d, far, _ = self._prepare(origins, directions, t_max)
        blocked = torch.empty(len(o), dtype=torch.uint8, device=self.device)
        if len(o):
            launch(_kernels().occluded, len(o), *self._scene, o, d, far, blocked)
        return blocked.bool()

    def _tensors(
        self, origins: np.ndarray, directions: np.ndarray, t_max: float | np.ndarray
    ) -> tuple[torch.Tensor, torch.Tensor, float | torch.Tensor]:
        limit = torch.as_tensor(t_max, device=self.device) if isinstance(t_max, np.ndarray) else t_max
        return (torch.tensor(origins, device=self.device), torch.tensor(directions, device=self.device), limit)

    def _prepare(
        self, origins: torch.Tensor, directions: torch.Tensor, t_max: float | torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        # in float64, since a mesh far from the origin would lose its digits to the centre's
        o = ((origins.double() - self._middle) / self._radius).float().contiguous()
        length = torch.linalg.vector_norm(directions, dim=1, keepdim=True)
        d = (directions / length).float().contiguous()
        scale = (self._radius / length[:, 0]).float()
        limit = torch.as_tensor(t_max, dtype=torch.float32, device=self.device)
        return o, d, (limit / scale).clamp(max=_FAR).contiguous(), scale


def _kernels():  # type: ignore[no-untyped-def]
    warp()
    from exmesh_graph.rays import warp_kernels

    return warp_kernels
