"""Full-quality forward renders of a finished asset, under its own or any other environment."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from exmesh_graph.gpu.cores import share
from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.raster import rasterize
from exmesh_graph.shading.gather import gather_rows
from exmesh_graph.shading.moving import light_turns
from exmesh_graph.shading.settings import TransportSettings
from exmesh_graph.shading.transport import direct_transport, with_bounces
from exmesh_graph.stage2.scene import Body, Lighting, Scene, shade
from exmesh_graph.stage2.surface import texel_footprint
from exmesh_graph.types import Asset, Transport

#: Lattice points and directions of the transport that `render_views` traces when it is given none.
RENDER_POINTS = 30_000
RENDER_DIRECTIONS = 256


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
    bounces: int = 8,
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
    bounces: int = 8,
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
    for the asset's own, which may move with the camera.
    Diffuse light by `transport`, which brings its own number of interreflections; where it is
    None, one with `bounces` is traced here. Specular by `specular_samples` GGX rays for each of the supersampling^2
    samples of a pixel, with the mesh mirrored in itself. Coverage is antialiased by the same samples.
    A normal map bends the normals of what the camera sees; the mesh's own light starts from smooth ones.
    casts bool [F]: the faces that shade the others and are mirrored in them (None: all); every face is seen.

    Raises GeometryError for a transport of another mesh.
    """
    light = transport or render_transport(asset, bounces, casts=casts)
    cameras = (intrinsics, camera_to_world, height, width)
    (rendered,) = render_under(
        Body(asset, light, device, casts), *cameras, [Lighting(environment)], supersampling=supersampling,
        specular_samples=specular_samples, seed=seed, progress=progress,
    )  # fmt: skip
    return rendered


def render_under(
    body: Body,
    intrinsics: np.ndarray,
    camera_to_world: np.ndarray,
    height: int,
    width: int,
    lightings: Sequence[Lighting],
    *,
    supersampling: int = 2,
    specular_samples: int = 12,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    between: tuple[np.ndarray, np.ndarray] | None = None,
) -> list[Rendered]:
    """What `render_views` gives under each of `lightings`, at little more than the cost of one: rays are traced once.

    All results share `albedo` (that of the body, unscaled) and the other buffers.
    between  nearest and farthest z depth [N, H, W] of each pixel: samples that meet no surface there are empty
    """
    scenes = body.under(lightings)
    own = [k for k, lighting in enumerate(lightings) if lighting.environment is None]
    turns = light_turns(body.asset.light_axis, camera_to_world) if own else None
    done, told = itertools.count(1), threading.Lock()

    def one(number: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
        generator = torch.Generator().manual_seed((seed << 20) + number)  # a view's own: whoever renders it
        camera = (intrinsics[number], camera_to_world[number])
        depths = None if between is None else (between[0][number], between[1][number])
        here = list(scenes)
        if turns is not None:
            for k, scene in zip(own, body.under([lightings[k] for k in own], turns[number]), strict=True):
                here[k] = scene
        result = _render(body, here, *camera, height, width, supersampling, specular_samples, generator, depths)
        if progress:
            with told:
                progress(next(done), len(intrinsics))
        return result

    results = share(one, range(len(intrinsics)))
    buffers = [np.stack(column) for column in zip(*(rest for _, rest in results), strict=True)]
    return [Rendered(np.stack(images), *buffers) for images in zip(*(lit for lit, _ in results), strict=True)]


@torch.no_grad()
def _render(
    body: Body,
    scenes: Sequence[Scene],
    intrinsics: np.ndarray,
    camera_to_world: np.ndarray,
    height: int,
    width: int,
    supersampling: int,
    samples: int,
    generator: torch.Generator,
    between: tuple[np.ndarray, np.ndarray] | None,
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """The images of a view in each scene; alpha, albedo, roughness and normal."""
    device = body.maps.device
    scaled = np.diag([supersampling, supersampling, 1.0]) @ intrinsics
    fragments = rasterize(
        body.geometry.vertices,
        body.geometry.faces.to(torch.int32),
        torch.from_numpy(scaled).to(device),
        torch.from_numpy(np.linalg.inv(camera_to_world)).to(device),
        height * supersampling,
        width * supersampling,
    )
    face_id = fragments.face_id.reshape(-1)
    counts = face_id >= 0
    if between is not None:
        near, far = (tensor_of(part).to(device).repeat_interleave(supersampling, 0).repeat_interleave(supersampling, 1)
                     for part in between)  # fmt: skip
        counts &= ((fragments.depth >= near) & (fragments.depth <= far)).reshape(-1)
    chosen = torch.nonzero(counts)[:, 0]
    camera = torch.from_numpy(camera_to_world[:3, 3].astype(np.float32)).to(device)
    surface = body.geometry.samples(face_id[chosen].long(), fragments.bary.reshape(-1, 3)[chosen], camera)
    # drawn for the whole grid: a sample more or less at the outline leaves the noise of all others as it is
    shift = torch.rand(len(face_id), 5, generator=generator)[chosen.cpu()].to(device)
    shaded = shade(body, scenes, surface, samples, shift, supersampling**2)
    material = gather_rows(body.maps, *texel_footprint(surface.uv, body.size))
    normal = body.mapped(surface, material).normal
    fine = torch.cat([torch.ones_like(material[:, :1]), material[:, :4], normal, *shaded], dim=1)
    row = torch.div(chosen, width * supersampling * supersampling, rounding_mode="floor")
    column = torch.div(chosen % (width * supersampling), supersampling, rounding_mode="floor")
    total = torch.zeros(height * width, fine.shape[1], device=device).index_add_(0, row * width + column, fine)
    mean = (total / supersampling**2).reshape(height, width, -1)
    alpha = mean[..., 0]
    covered = mean[..., 1:8] / alpha[..., None].clamp_min(1e-6)
    normal = covered[..., 4:] / covered[..., 4:].norm(dim=-1, keepdim=True).clamp_min(1e-6)
    buffers = [part.cpu().numpy() for part in (alpha, covered[..., :3], covered[..., 3], normal)]
    return [image.cpu().numpy() for image in mean[..., 8:].split(3, dim=-1)], buffers
