"""Specular lobes traced once, lit as often as asked: rays depend on shape and roughness, not on the light.

Two forms: `PlainLobes` in torch, for every device, which the tests hold to formulas, and `fused_lobes.FusedLobes`, what
float32 on a CPU takes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import torch

from exmesh_graph.rays import MISS, RayTracer, offset_origins, tensors
from exmesh_graph.shading import brdf
from exmesh_graph.shading.brdf_sampling import sample_specular
from exmesh_graph.shading.envmap import Pyramid
from exmesh_graph.shading.point_sets import hammersley
from exmesh_graph.stage2.surface import SurfaceSamples


@dataclass(frozen=True)
class Sky:
    """What free rays meet: an environment, and of as many texels one more that only some points' samples meet."""

    pyramid: Pyramid
    extra: Pyramid | None = None

    @cached_property
    def table(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Texels of all levels in rows of four floats [T, 4], then those of the levels with `extra` in them; and
        int32 [L, 3], the levels' height, width and first row."""
        sums = [self.pyramid.levels]
        if self.extra is not None:
            sums.append([a + b for a, b in zip(self.pyramid.levels, self.extra.levels, strict=True)])
        rows = torch.cat([level.reshape(-1, 3) for levels in sums for level in levels])
        shapes, first = [], 0
        for level in self.pyramid.levels:
            shapes.append((*level.shape[:2], first))
            first += level.shape[0] * level.shape[1]
        return torch.nn.functional.pad(rows, (0, 1)), torch.tensor(shapes, dtype=torch.int32)


class Lobes(Protocol):
    """Rays of the lobes of N points; `face` int64 [M] and `bary` [M, 3] of the front faces that rays met."""

    @property
    def face(self) -> torch.Tensor:
        """[M]"""

    @property
    def bary(self) -> torch.Tensor:
        """[M, 3]"""

    def radiance(
        self, f0: torch.Tensor, sky: Sky, sent: torch.Tensor, extra: torch.Tensor | None = None, shared: float = 1.0
    ) -> torch.Tensor:
        """Specular radiance [N, 3]: the mean over the samples of F G/G1 times what their ray meets.

        Free rays read `sky` averaged over the solid angle they stand for (Krivanek and Colbert 2008), with its `extra`
        for some points (bool [N]); rays that met a front face read the radiance `sent` [M, 3] by it; back faces are
        black. f0 [N, 3]. `shared`: how many times as many rays count for a point as it traced itself.
        """


@dataclass(frozen=True)
class PlainLobes:
    """R useful rays: of which point (`row`), where to, what they weigh (G / G1), v.h, the solid angle they stand for.

    `free` bool [R]; `met` int64 [M], the rays that met front faces
    """

    face: torch.Tensor
    bary: torch.Tensor
    count: int
    samples: int
    row: torch.Tensor
    direction: torch.Tensor
    weight: torch.Tensor
    v_h: torch.Tensor
    solid_angle: torch.Tensor
    free: torch.Tensor
    met: torch.Tensor

    @classmethod
    @torch.no_grad()
    def traced(
        cls,
        surface: SurfaceSamples,
        face_normals: torch.Tensor,
        roughness: torch.Tensor,
        tracer: RayTracer,
        samples: int,
        shift: torch.Tensor,
    ) -> PlainLobes:
        """As `fused_lobes.trace_lobes`."""
        grid = hammersley(samples, roughness.device)
        moved = (grid + shift[:, None].to(roughness)) % 1
        light, weight, pdf, v_h = sample_specular(surface.normal, surface.view, brdf.alpha_of(roughness), moved)
        useful = (weight > 0) & ((light * surface.flat[:, None]).sum(-1) > 0)
        row, column = torch.nonzero(useful, as_tuple=True)
        direction = light[row, column]
        origins = offset_origins(surface.position, surface.flat.double(), tracer.radius)
        hits = tensors.closest_hit(tracer, origins[row], direction)
        face, free = hits.face.long(), hits.face == MISS
        met = torch.nonzero(~free & ((face_normals[face.clamp_min(0)] * direction).sum(-1) < 0))[:, 0]
        return cls(
            face[met], hits.bary[met], len(surface), samples, row, direction, weight[row, column], v_h[row, column],
            1 / (samples * pdf[row, column]), free, met,
        )  # fmt: skip

    @torch.no_grad()
    def radiance(
        self, f0: torch.Tensor, sky: Sky, sent: torch.Tensor, extra: torch.Tensor | None = None, shared: float = 1.0
    ) -> torch.Tensor:
        """As `Lobes.radiance`."""
        angle = self.solid_angle / shared
        arriving = torch.zeros_like(self.direction)
        arriving[self.free] = sky.pyramid.lookup(self.direction[self.free], angle[self.free])
        if sky.extra is not None and extra is not None:
            more = self.free & extra[self.row]
            arriving[more] += sky.extra.lookup(self.direction[more], angle[more])
        arriving[self.met] = sent
        value = arriving * brdf.schlick(self.v_h, f0[self.row]) * self.weight[:, None]
        return value.new_zeros(self.count, 3).index_add_(0, self.row, value) / self.samples
