"""A finished asset under light: its body, traced once, and scenes of it, each under an environment of its own."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.rays import make_ray_tracer
from exmesh_graph.shading import brdf, envmap
from exmesh_graph.shading.envmap import Pyramid
from exmesh_graph.shading.gather import gather_rows
from exmesh_graph.shading.lattice import locate
from exmesh_graph.shading.moving import turned
from exmesh_graph.shading.operators import LightTransport, VectorTransport
from exmesh_graph.shading.specular import scattered
from exmesh_graph.shading.suns import find_suns, sun_transfer
from exmesh_graph.shading.transport import check_fits, lattice_origins
from exmesh_graph.stage2.light.fused_lobes import trace_lobes
from exmesh_graph.stage2.light.fused_suns import FusedSunRays, trace_suns
from exmesh_graph.stage2.light.lobes import Sky
from exmesh_graph.stage2.light.traced import SunRays, narrow_lobes
from exmesh_graph.stage2.surface import (
    CarrierGeometry,
    SurfaceSamples,
    TangentFrames,
    bent_irradiance,
    mapped_surface,
    slopes_of,
    texel_footprint,
)
from exmesh_graph.types import Asset, Transport

#: Rays of a pixel's sample to each small sun (shading.suns).
SUN_SAMPLES = 4

#: Rows of a table and their weights, int64 [N, J] and [N, J].
Footprint = tuple[torch.Tensor, torch.Tensor]


@dataclass(frozen=True, eq=False)
class Lighting:
    """What an asset is lit by: `environment` [h, w, 3] canonical lat-long (None: its own), with the mesh's own light
    or without (`bounces`), and its base colour times `scale` [3] (None: 1), cut off at 1."""

    environment: np.ndarray | None = None
    scale: np.ndarray | None = None
    bounces: bool = True


class Body:
    """What of an asset depends on no light: geometry, rays, maps, the operators of `light`.

    `casts` as for `render.render_views`. Raises GeometryError for a transport of another mesh.
    """

    def __init__(self, asset: Asset, light: Transport, device: str = "cpu", casts: np.ndarray | None = None) -> None:
        check_fits(light, asset.vertices, asset.faces)
        self.asset, self.light, self.device = asset, light, device
        self.geometry = CarrierGeometry(asset, device)
        self.tracer = make_ray_tracer(asset.vertices, asset.faces, device, casts=casts)
        self.size = asset.base_color.shape[0]
        columns = [asset.base_color, asset.roughness[..., None]]
        self.metallic = asset.metallic is not None
        if asset.metallic is not None:
            columns.append(asset.metallic[..., None])
        self.frames = None
        if asset.normal is not None:
            columns.append(slopes_of(asset.normal))
            self.frames = TangentFrames(asset, device)
        maps = np.concatenate(columns, axis=-1, dtype=np.float32)
        self.maps = tensor_of(maps).reshape(-1, maps.shape[-1]).to(device)
        self.operators = LightTransport(light, device)
        self.lattice_face = torch.from_numpy(light.point_face.astype(np.int64)).to(device)
        self.lattice_texels = self.texels(self.lattice_face, tensor_of(light.point_bary).to(device))

    @cached_property
    def vectors(self) -> VectorTransport:
        """The operators of vector irradiance, for normal maps."""
        return VectorTransport(self.operators)

    def texels(self, face: torch.Tensor, bary: torch.Tensor) -> Footprint:
        """Texels at surface positions, `face` int64 [N] and `bary` [N, 3]."""
        uv = (self.geometry.uvs[self.geometry.uv_faces[face]] * bary[..., None]).sum(1)
        return texel_footprint(uv, self.size)

    def points(self, face: torch.Tensor, bary: torch.Tensor) -> Footprint:
        """Lattice points of the transport around surface positions."""
        light = self.light
        index, weight = locate(light, face.cpu().numpy(), bary.cpu().numpy())
        return torch.from_numpy(index.astype(np.int64)).to(face.device), torch.from_numpy(weight).to(face.device)

    def mapped(self, surface: SurfaceSamples, material: torch.Tensor) -> SurfaceSamples:
        """`surface` under the asset's normal map, if it has one."""
        return mapped_surface(surface, self.geometry, self.frames, None if self.frames is None else material[:, -2:])

    def f_d(self, material: torch.Tensor) -> torch.Tensor:
        """Diffuse reflectance [N, 3] of materials [N, C]."""
        return brdf.diffuse(material[:, :3], material[:, 4] if self.metallic else None)

    def sends(self, material: torch.Tensor) -> torch.Tensor:
        """What materials [N, C] send on to other parts of the body, f [N, 3] (shading.specular.scattered)."""
        return scattered(material[:, :3], material[:, 3], material[:, 4] if self.metallic else None)

    def under(self, lightings: Sequence[Lighting], turn: np.ndarray | None = None) -> list[Scene]:
        """The body under each of the lightings; one environment is prepared once. `turn` [3, 3] turns its own, where
        that moves with the camera (shading.moving)."""
        skies: dict[int, Environment] = {}
        scenes = []
        own = self.asset.environment
        if turn is not None:
            own = turned(tensor_of(own), turn).numpy()
        for lighting in lightings:
            radiance = own if lighting.environment is None else lighting.environment
            if id(radiance) not in skies:
                skies[id(radiance)] = Environment(self, radiance)
            scenes.append(Scene(self, skies[id(radiance)], lighting))
        return scenes


class Environment:
    """An environment [h, w, 3] as it meets a body: small suns apart, the rest by directions and as a pyramid."""

    def __init__(self, body: Body, environment: np.ndarray) -> None:
        radiance = tensor_of(np.asarray(environment, np.float32)).to(body.device)
        self.suns = find_suns(radiance, len(body.light.directions))
        rest, self.flux = self.suns.without(radiance), self.suns.flux(radiance)
        self.binned = torch.sparse.mm(body.operators.bin_matrix(*radiance.shape[:2]), rest.reshape(-1, 3))
        extra = self.transfer = None
        if len(self.suns):
            asset, light, device = body.asset, body.light, body.device
            # lattice points see the suns by rays of their own; pixels see them for themselves (`shade`)
            start = lattice_origins(light, asset.vertices, asset.faces, body.tracer.radius)
            normal, flat = tensor_of(light.normals).to(device), body.geometry.face_normals[body.lattice_face]
            self.transfer = sun_transfer(self.suns, tensor_of(start).to(device), normal, flat, body.tracer)
            extra = Pyramid(tensor_of(_even((radiance - rest).cpu().numpy())).to(device))
        self.sky = Sky(Pyramid(tensor_of(_even(rest.cpu().numpy())).to(device=body.device)), extra)


class Scene:
    """A body under an environment: irradiance and leaving radiance at the lattice points."""

    def __init__(self, body: Body, sky: Environment, lighting: Lighting) -> None:
        self.body, self.environment = body, sky
        self.maps = body.maps
        if lighting.scale is not None:
            scaled = body.asset.base_color * lighting.scale.astype(np.float32)
            base = torch.from_numpy(np.clip(scaled, 0.0, 1.0)).reshape(-1, 3).to(body.device)
            self.maps = torch.cat([base, body.maps[:, 3:]], dim=1)
        f_d = body.sends(gather_rows(self.maps, *body.lattice_texels))
        operators = body.operators
        if not lighting.bounces:
            operators = copy.copy(operators)
            operators.bounces, operators.gather = 0, None
        self.irradiance, direct_sun = operators.irradiance(sky.binned, f_d), torch.zeros_like(f_d)
        if sky.transfer is not None:
            both = torch.cat([sky.binned, sky.flux])
            self.irradiance = operators.with_columns(sky.transfer).irradiance(both, f_d)
            direct_sun = sky.transfer @ sky.flux
        self.arriving = self.irradiance - direct_sun
        self.vector = None
        if body.frames is not None:
            self.vector = body.vectors.vector(sky.binned, f_d * self.irradiance if lighting.bounces else None)

    def sent(self, texels: Footprint, points: Footprint) -> torch.Tensor:
        """Radiance [N, 3] that surface positions send to others, of their footprints on maps and lattice."""
        return self.body.sends(gather_rows(self.maps, *texels)) * gather_rows(self.irradiance, *points)


@torch.no_grad()
def shade(
    body: Body,
    scenes: Sequence[Scene],
    smooth: SurfaceSamples,
    samples: int,
    shift: torch.Tensor,
    shared: float = 1.0,
    chunk: int = 1 << 13,
) -> list[torch.Tensor]:
    """Radiance [N, 3] of the surface samples `smooth` in each of the body's scenes; rays are traced once for all.

    Specular light by `samples` rays of each point; as many points as `shared` are averaged later, and their rays share
    the lobe (lobes.Lobes.radiance).
    `shift` [N, 5], uniform in [0, 1), moves each point's specular and sun samples.
    """
    shaded = [torch.empty(len(smooth), 3, device=body.device) for _ in scenes]
    for start in range(0, len(smooth), chunk):
        part = slice(start, start + chunk)
        values = _shade_part(body, scenes, smooth[part], samples, shift[part], shared)
        for radiance, value in zip(shaded, values, strict=True):
            radiance[part] = value
    return shaded


def _shade_part(
    body: Body, scenes: Sequence[Scene], smooth: SurfaceSamples, samples: int, shift: torch.Tensor, shared: float
) -> list[torch.Tensor]:
    own, around = texel_footprint(smooth.uv, body.size), body.points(smooth.face, smooth.bary)
    plain = gather_rows(body.maps, *own)
    surface, roughness = body.mapped(smooth, plain), plain[:, 3]
    lobes = trace_lobes(surface, body.geometry.face_normals, roughness, body.tracer, samples, shift[:, :2])
    texels, points = body.texels(lobes.face, lobes.bary), body.points(lobes.face, lobes.bary)
    suns: dict[int, SunRays | FusedSunRays] = {}
    shaded = []
    for scene in scenes:
        material = plain if scene.maps is body.maps else gather_rows(scene.maps, *own)
        f_d = body.f_d(material)
        f0 = brdf.base_reflectance(material[:, :3], material[:, 4] if body.metallic else None)
        sky = scene.environment
        narrow = narrow_lobes(sky.suns, roughness) if len(sky.suns) else None
        specular = lobes.radiance(f0, sky.sky, scene.sent(texels, points), narrow, shared)
        arrived = gather_rows(scene.arriving, *around)
        if scene.vector is not None:
            vector = gather_rows(scene.vector, *around)
            arrived = bent_irradiance(arrived, vector, smooth.normal, surface.normal)
        radiance = f_d * arrived + specular
        if len(sky.suns):
            if id(sky) not in suns:
                suns[id(sky)] = trace_suns(sky.suns, surface, body.tracer, SUN_SAMPLES, shift[:, 2:])
            radiance += suns[id(sky)].radiance(sky.flux, f_d, roughness, f0)
        shaded.append(radiance)
    return shaded


def _even(environment: np.ndarray) -> np.ndarray:
    """The map at a size that can be halved down to a few rows."""
    height, width = environment.shape[:2]
    rows = max(16, 1 << round(np.log2(height)))
    if height % 16 == 0 and width % 16 == 0:
        return np.ascontiguousarray(environment, np.float32)
    return envmap.resample(environment, rows, 2 * rows)
