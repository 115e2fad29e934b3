"""The third stage's vertex side in Warp's kernels and their adjoints: float32 on a CPU; `lit` has the plain form."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import torch
from torch.autograd.function import once_differentiable

from exmesh_graph.gpu.cores import split
from exmesh_graph.gpu.warp_runtime import launch, launch_adjoint, warp
from exmesh_graph.stage2.fused.view import SpecularTables

LEAST_SINE = 1e-5
"""Sine of the angle between two edges of a face up to which it has no normal: float32 would make one of rounding."""


@cache
def _kernels() -> Any:
    warp()
    from exmesh_graph.stage3 import kernels_lit

    return kernels_lit


@dataclass(frozen=True)
class Tables:
    """What the kernels read of an asset's vertices and light, float32 on a CPU unless said.

    faces       int32 [F, 3];  angles [F, 3], of the corners at the start
    normals     [V, 3], unit, at the start
    diffuse, irradiance [V, 3], f_d and E;  vector [V, 9] its change with the normal, x, y, z of rgb
    f0          [V, 3];  roughness [V]
    lower, share int64 [V], [V], the prefiltered levels of its roughness (PrefilteredStack.between)
    rows        [R, 3], those levels (PrefilteredStack.build)
    specular    where they lie, and A and B of the split sum
    """

    faces: torch.Tensor
    angles: torch.Tensor
    normals: torch.Tensor
    diffuse: torch.Tensor
    irradiance: torch.Tensor
    vector: torch.Tensor
    f0: torch.Tensor
    roughness: torch.Tensor
    lower: torch.Tensor
    share: torch.Tensor
    rows: torch.Tensor
    specular: SpecularTables

    def arguments(self) -> tuple[torch.Tensor, ...]:
        """As `light_vertices` takes them, from `start` to `table`."""
        x, y, z = (part.contiguous() for part in self.vector.view(-1, 3, 3).unbind(1))
        return (
            self.normals, self.diffuse, self.irradiance, x, y, z, self.lower.int(), self.share, self.rows,
            self.specular.levels, self.f0, self.roughness, self.specular.reflectance,
        )  # fmt: skip


class VertexKernels:
    """`lit.VertexLight.display` of `tables`, by kernels."""

    def __init__(self, tables: Tables) -> None:
        self.faces, self.angles = tables.faces.contiguous(), tables.angles.contiguous()
        self.arguments = tuple(t.contiguous() for t in tables.arguments())

    def display(
        self, vertices: torch.Tensor, camera: torch.Tensor, chosen: torch.Tensor, scale: torch.Tensor
    ) -> torch.Tensor:
        """S [N, 3] of the vertices `chosen` int32 [N] seen from `camera` [3], c = `scale` [N, 3]; differentiable in
        `vertices` [V, 3]."""
        return _Display.apply(vertices, camera, chosen, scale, self)


class _Display(torch.autograd.Function):
    @staticmethod
    def forward(ctx, vertices, camera, chosen, scale, of):  # type: ignore[no-untyped-def]
        vertices = vertices.detach().contiguous()
        eye = warp().vec3(*camera.tolist())
        sums = torch.zeros_like(vertices)
        launch(_kernels().add_normals, len(of.faces), 0, LEAST_SINE, vertices, of.faces, of.angles, sums)
        out = torch.empty(len(chosen), 3)
        ctx.given = (chosen.int(), eye, vertices, sums, *of.arguments, scale, out)
        ctx.of = of
        if len(chosen):
            split(_kernels().light_vertices, len(chosen), *ctx.given, grain=512)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, gradient):  # type: ignore[no-untyped-def]
        vertices, sums = ctx.given[2:4]
        to_vertices, to_sums = torch.zeros_like(vertices), torch.zeros_like(sums)
        if not len(ctx.given[0]):
            return to_vertices, None, None, None, None
        others = [None] * (len(ctx.given) - 5)
        launch_adjoint(
            _kernels().light_vertices, len(ctx.given[0]), (0, *ctx.given),
            (0, None, ctx.given[1] * 0.0, to_vertices, to_sums, *others, gradient.contiguous()),
        )  # fmt: skip
        launch_adjoint(
            _kernels().add_normals, len(ctx.of.faces), (0, LEAST_SINE, vertices, ctx.of.faces, ctx.of.angles, sums),
            (0, 0.0, to_vertices, None, None, to_sums),
        )  # fmt: skip
        return to_vertices, None, None, None, None
