"""The suns of a fit's environment: where they stand, and what reaches the lattice and the pixels of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch

from exmesh_graph.gpu.cores import share
from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.rays import RayTracer, offset_origins
from exmesh_graph.shading.operators import LightTransport
from exmesh_graph.shading.point_sets import sobol_points
from exmesh_graph.shading.suns import SUN_RAYS, Suns, find_suns, open_irradiance, overlap, seen_irradiance, sun_transfer
from exmesh_graph.shading.transport import lattice_origins
from exmesh_graph.stage2.gbuffer import ViewBuffer
from exmesh_graph.stage2.light.sparse import find_near, spacing
from exmesh_graph.stage2.surface import CarrierGeometry, SurfaceSamples

#: Suns stay as they were traced while this share of each one's light leaves from where it did.
UNMOVED = 0.9
#: A roughness whose lobes are all alike.
ALL_ALIKE = 1e3


@dataclass(frozen=True)
class FittedSuns:
    """The suns of a fit's environment as it was last measured, and where their light goes.

    lattice    [P, S], irradiance of lattice points per flux (shading.suns.sun_transfer);  views  the same of a view's
               pixels, [N, S] by the view's number;  operators  the transport with the suns as further directions
    """

    suns: Suns
    lattice: torch.Tensor
    views: Mapping[int, torch.Tensor]
    operators: LightTransport

    def has(self, buffer: ViewBuffer) -> bool:
        """Whether the suns were traced for the buffer's pixels."""
        return buffer.number in self.views and len(self.views[buffer.number]) == len(buffer.pixel)

    def under(self, operators: LightTransport) -> FittedSuns:
        """The same with another transport of the same mesh."""
        return replace(self, operators=operators.with_columns(self.lattice))

    def state(self) -> dict[str, Any]:
        return {"suns": dict(vars(self.suns)), "lattice": self.lattice, "views": dict(self.views)}

    @classmethod
    def restored(cls, kept: Mapping[str, Any], operators: LightTransport) -> FittedSuns:
        device = operators.transfer.device
        told: dict[str, Any] = {
            name: value.to(device) if isinstance(value, torch.Tensor) else tuple(value)
            for name, value in kept["suns"].items()
        }
        lattice = kept["lattice"].to(device)
        views = {number: transfer.to(device) for number, transfer in kept["views"].items()}
        return cls(Suns(**told), lattice, views, operators.with_columns(lattice))


@torch.no_grad()
def find_fitted_suns(
    environment: torch.Tensor,
    operators: LightTransport,
    geometry: CarrierGeometry,
    tracer: RayTracer,
    buffers: Iterable[ViewBuffer],
    before: FittedSuns | None = None,
) -> FittedSuns | None:
    """The suns of `environment`, traced from the lattice and all views' pixels; None where there are none.

    Those found `before` stay while hardly any of their light has moved.
    """
    light, device = operators.light, geometry.device
    suns = find_suns(environment, len(light.directions))
    if not len(suns):
        return None
    if before is not None and overlap(before.suns, suns) >= UNMOVED and all(map(before.has, buffers)):
        return before
    vertices, faces = geometry.vertices.cpu().numpy(), geometry.faces.cpu().numpy()
    origins = tensor_of(lattice_origins(light, vertices, faces, tracer.radius)).to(device)
    flat = geometry.face_normals[torch.from_numpy(light.point_face.astype("int64")).to(device)]
    lattice = sun_transfer(suns, origins, tensor_of(light.normals).to(device), flat, tracer)

    @torch.no_grad()  # a thread's own switch
    def traced(buffer: ViewBuffer) -> tuple[int, torch.Tensor]:
        return buffer.number, view_transfer(suns, buffer, buffer.samples(geometry), tracer)

    return FittedSuns(suns, lattice, dict(share(traced, buffers)), operators.with_columns(lattice))


@torch.no_grad()
def view_transfer(
    suns: Suns, buffer: ViewBuffer, surface: SurfaceSamples, tracer: RayTracer, crossings: int | None = None
) -> torch.Tensor:
    """`sun_transfer` [N, S] of a view's pixels.

    In a view of many pixels rays leave from the crossings of rows and columns, and from pixels between crossings that
    lie on several surfaces or do not all see the sun, or all not see it.
    """
    origins = offset_origins(surface.position, surface.flat.double(), tracer.radius)
    normal, flat = surface.normal, surface.flat
    every = spacing(len(normal), crossings)
    if every == 1:
        return sun_transfer(suns, origins, normal, flat, tracer)
    near, part = find_near(buffer, surface, torch.full_like(surface.n_v, ALL_ALIKE), every)
    crossing, near, unused = buffer.crossings(every), near.long(), part == 0
    whole = ~crossing & (part.sum(1) > 0.999)
    result = normal.new_zeros(len(normal), len(suns))
    for sun, towards in enumerate(suns.directions(sobol_points(SUN_RAYS).to(normal.device))):
        free, seen = open_irradiance(towards, normal, flat), result[:, sun]
        rows = torch.nonzero(crossing)[:, 0]
        seen[rows] = seen_irradiance(towards, origins[rows], normal[rows], flat[rows], tracer)
        clear, dark = seen >= (1 - 1e-5) * free, seen == 0  # both where a point is turned away
        clear, dark = (whole & (kind[near] | unused).all(1) for kind in (clear, dark))
        seen[clear] = free[clear]
        rows = torch.nonzero(~(crossing | clear | dark) & (free > 0))[:, 0]
        seen[rows] = seen_irradiance(towards, origins[rows], normal[rows], flat[rows], tracer)
    return result
