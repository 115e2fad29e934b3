"""Full-quality forward renders of a finished asset, under its own or any other environment."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from exmesh_graph.gpu.cores import share
from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.raster import rasterize
from exmesh_graph.rays import make_ray_tracer
from exmesh_graph.shading import brdf, envmap
from exmesh_graph.shading.envmap import Pyramid
from exmesh_graph.shading.gather import gather_rows
from exmesh_graph.shading.operators import LightTransport, VectorTransport, at_surface
from exmesh_graph.shading.settings import TransportSettings
from exmesh_graph.shading.suns import find_suns, sun_transfer
from exmesh_graph.shading.transport import (
    check_fits,
    direct_transport,
    lattice_origins,
    with_bounces,
)
from exmesh_graph.stage2.light.traced import narrow_lobes, sun_radiance, traced_specular
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

#: Lattice points and directions of the transport that `render_views` traces when it is given none.
RENDER_POINTS = 30_000
RENDER_DIRECTIONS = 256

#: Rays of a pixel's sample to each small sun (shading.suns).
SUN_SAMPLES = 4


@dataclass(frozen=True)
class Rendered:
    """N rendered views, linear float32.

    images [N, H, W, 3] premultiplied by alpha [N, H, W]; albedo [N, H, W, 3], roughness [N, H, W] and normal
    [N, H, W, 3] (unit, world) averaged over the covered part of each pixel, 0 where nothing is covered
    """

    images: np.ndarray
    alpha: np.ndarray
    albedo: np.ndarray
    roughness: np.ndarray
    normal: np.ndarray


def render_transport(
    asset: Asset,
    bounces: int = 2,
    directions: int = RENDER_DIRECTIONS,
    points: int = RENDER_POINTS,
    casts: np.ndarray | None = None,
) -> Transport:
    """The light transport of `render_views`, to be shared by several calls on one asset; `casts` as there."""
    settings = TransportSettings(directions=directions, points=points)
    light = direct_transport(asset.vertices, asset.faces, settings, casts=casts)
    return with_bounces(light, bounces) if bounces else light


def render_views(
    asset: Asset,
    intrinsics: np.ndarray,
    camera_to_world: np.ndarray,
    height: int,
    width: int,
    *,
    environment: np.ndarray | None = None,
    bounces: int = 2,
    supersampling: int = 2,
    specular_samples: int = 12,
    transport: Transport | None = None,
    seed: int = 0,
    device: str = "cpu",
    progress: Callable[[int, int], None] | None = None,
    casts: np.ndarray | None = None,
) -> Rendered:
    """Render an asset.

    intrinsics [N, 3, 3] and camera_to_world [N, 4, 4] as types.Views; environment [h, w, 3] canonical lat-long, None
    for the asset's own. Diffuse light by `transport`, which brings its own number of interreflections; where it is
    None, one with `bounces` is traced here. Specular by `specular_samples` GGX rays for each of the supersampling^2
    samples of a pixel, with the mesh mirrored in itself. Coverage is antialiased by the same samples.
    A normal map bends the normals of what the camera sees; the mesh's own light starts from smooth ones.
    casts bool [F]: the faces that shade the others and are mirrored in them (None: all); every face is seen.

    Raises GeometryError for a transport of another mesh.
    """
    light = transport or render_transport(asset, bounces, casts=casts)
    check_fits(light, asset.vertices, asset.faces)
    scene = Scene(asset, light, asset.environment if environment is None else environment, device, casts)
    done, told = itertools.count(1), threading.Lock()

    def one(number: int) -> tuple[np.ndarray, ...]:
        generator = torch.Generator().manual_seed((seed << 20) + number)  # a view's own: whoever renders it
        camera = (intrinsics[number], camera_to_world[number])
        result = _render(scene, *camera, height, width, supersampling, specular_samples, generator)
        if progress:
            with told:
                progress(next(done), len(intrinsics))
        return result

    results = share(one, range(len(intrinsics)))
    columns = [np.stack(column) for column in zip(*results, strict=True)]
    return Rendered(*columns)


class Scene:
    """An asset under one environment: its maps, irradiance and leaving radiance at the lattice points."""

    def __init__(
        self, asset: Asset, light: Transport, environment: np.ndarray, device: str, casts: np.ndarray | None = None
    ) -> None:
        self.geometry = CarrierGeometry(asset, device)
        self.tracer = make_ray_tracer(asset.vertices, asset.faces, device, casts=casts)
        self.light = light
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
        operators = LightTransport(light, device)
        radiance = tensor_of(np.asarray(environment, np.float32)).to(device)
        self.suns = find_suns(radiance, len(light.directions))
        rest, self.flux = self.suns.without(radiance), self.suns.flux(radiance)
        binned = torch.sparse.mm(operators.bin_matrix(*radiance.shape[:2]), rest.reshape(-1, 3))
        face = torch.from_numpy(light.point_face.astype(np.int64)).to(device)
        corners = self.geometry.uvs[self.geometry.uv_faces[face]]
        material = self.read((corners * tensor_of(light.point_bary).to(device)[..., None]).sum(1))
        f_d = brdf.diffuse(material[:, :3], material[:, 4] if self.metallic else None)
        # lattice points see the suns by rays of their own; pixels see them for themselves (`shade`)
        self.irradiance, self.direct_sun = operators.irradiance(binned, f_d), torch.zeros_like(f_d)
        self.extra = None
        if len(self.suns):
            origins = tensor_of(lattice_origins(light, asset.vertices, asset.faces, self.tracer.radius)).to(device)
            normal, flat = tensor_of(light.normals).to(device), self.geometry.face_normals[face]
            transfer = sun_transfer(self.suns, origins, normal, flat, self.tracer)
            self.irradiance = operators.with_columns(transfer).irradiance(torch.cat([binned, self.flux]), f_d)
            self.direct_sun = transfer @ self.flux
            self.extra = Pyramid(tensor_of(_even((radiance - rest).cpu().numpy())).to(device))
        self.vector = None
        if self.frames is not None:
            self.vector = VectorTransport(operators).vector(binned, f_d * self.irradiance)
        self.pyramid = Pyramid(tensor_of(_even(rest.cpu().numpy())).to(device))

    def read(self, uv: torch.Tensor) -> torch.Tensor:
        return gather_rows(self.maps, *texel_footprint(uv, self.size))

    def hit_radiance(self, face: torch.Tensor, bary: torch.Tensor) -> torch.Tensor:
        uv = (self.geometry.uvs[self.geometry.uv_faces[face]] * bary[..., None]).sum(1)
        return self.f_d(self.read(uv)) * at_surface(self.light, self.irradiance, face, bary)

    def mapped(self, surface: SurfaceSamples, material: torch.Tensor) -> SurfaceSamples:
        """`surface` under the asset's normal map, if it has one."""
        return mapped_surface(surface, self.geometry, self.frames, None if self.frames is None else material[:, -2:])

    def f_d(self, material: torch.Tensor) -> torch.Tensor:
        return brdf.diffuse(material[:, :3], material[:, 4] if self.metallic else None)

    def shade(self, smooth: SurfaceSamples, material: torch.Tensor, samples: int, shift: torch.Tensor) -> torch.Tensor:
        """Radiance [N, 3]; `shift` [N, 5], uniform in [0, 1), moves each point's specular and sun samples."""
        surface = self.mapped(smooth, material)
        f0 = brdf.base_reflectance(material[:, :3], material[:, 4] if self.metallic else None)
        specular = traced_specular(
            surface,
            self.geometry.face_normals,
            material[:, 3],
            f0,
            self.pyramid,
            self.tracer,
            self.hit_radiance,
            samples,
            shift[:, :2],
            extra=None if self.extra is None else (self.extra, narrow_lobes(self.suns, material[:, 3])),
        )
        f_d = self.f_d(material)
        arrived = at_surface(self.light, self.irradiance - self.direct_sun, surface.face, surface.bary)
        if self.vector is not None:
            vector = at_surface(self.light, self.vector, surface.face, surface.bary)
            arrived = bent_irradiance(arrived, vector, smooth.normal, surface.normal)
        shaded = f_d * arrived + specular
        if len(self.suns):
            shaded += sun_radiance(
                self.suns, self.flux, surface, f_d, material[:, 3], f0, self.tracer, SUN_SAMPLES, shift[:, 2:]
            )
        return shaded


@torch.no_grad()
def _render(
    scene: Scene,
    intrinsics: np.ndarray,
    camera_to_world: np.ndarray,
    height: int,
    width: int,
    supersampling: int,
    samples: int,
    generator: torch.Generator,
) -> tuple[np.ndarray, ...]:
    device = scene.maps.device
    scaled = np.diag([supersampling, supersampling, 1.0]) @ intrinsics
    fragments = rasterize(
        scene.geometry.vertices,
        scene.geometry.faces.to(torch.int32),
        torch.from_numpy(scaled).to(device),
        torch.from_numpy(np.linalg.inv(camera_to_world)).to(device),
        height * supersampling,
        width * supersampling,
    )
    face_id = fragments.face_id.reshape(-1)
    chosen = torch.nonzero(face_id >= 0)[:, 0]
    camera = torch.from_numpy(camera_to_world[:3, 3].astype(np.float32)).to(device)
    surface = scene.geometry.samples(face_id[chosen].long(), fragments.bary.reshape(-1, 3)[chosen], camera)
    material = scene.read(surface.uv)
    # drawn for the whole grid: a sample more or less at the outline leaves the noise of all others as it is
    shift = torch.rand(len(face_id), 5, generator=generator)[chosen.cpu()]
    radiance = scene.shade(surface, material, samples, shift)
    fine = torch.zeros(len(face_id), 11, device=device)
    normal = scene.mapped(surface, material).normal
    fine[chosen] = torch.cat([radiance, torch.ones_like(radiance[:, :1]), material[:, :4], normal], dim=1)
    mean = fine.reshape(height, supersampling, width, supersampling, 11).mean(dim=(1, 3))
    alpha = mean[..., 3]
    covered = mean[..., 4:] / alpha[..., None].clamp_min(1e-6)
    normal = covered[..., 4:7] / covered[..., 4:7].norm(dim=-1, keepdim=True).clamp_min(1e-6)
    parts = (mean[..., :3], alpha, covered[..., :3], covered[..., 3], normal)
    return tuple(part.cpu().numpy() for part in parts)


def _even(environment: np.ndarray) -> np.ndarray:
    """The map at a size that can be halved down to a few rows."""
    height, width = environment.shape[:2]
    rows = max(16, 1 << round(np.log2(height)))
    if height % 16 == 0 and width % 16 == 0:
        return np.ascontiguousarray(environment, np.float32)
    return envmap.resample(environment, rows, 2 * rows)
