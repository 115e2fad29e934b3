"""Colour that moves with the normals: the texture, and on every vertex what the light that was found does beside it.

    colour(x, d) = texture(x) + S(n, d) - m        S - m of the vertices, interpolated over the face

S is the sRGB-encoded radiance that a vertex with normal n sends towards the camera, d away, by the asset's own
materials and environment; m is its mean, at the start's normals, over views that may show the vertex. So what one
texture cannot follow (highlights that wander, gloss, shading that a wrong normal bends) is explained by the asset in
place of the shape, and the normals answer for what is left of it. The texture holds the mean, and whatever the asset
has wrong of it.

    S = sRGB(f_d E(n) + split_sum(r(n, d), roughness) c)

E(n) = E(n_0) + (n - n_0) . F, F the vector irradiance (stage2.surface), so shadows and bounces are those of the start.
c is, per vertex and view, what rays measured of the specular lobe at the start over its split sum (stage2.light).
Normals weigh faces by their angles at the start.
"""

from __future__ import annotations

import copy
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F

from exmesh_graph.colour import linear_to_srgb
from exmesh_graph.gpu.cores import share
from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.raster import project, rasterize_projected, shown_vertices
from exmesh_graph.shading import brdf, envmap
from exmesh_graph.shading.envmap import Pyramid
from exmesh_graph.shading.gather import gather_rows
from exmesh_graph.shading.moving import light_turns, turned
from exmesh_graph.shading.operators import at_surface
from exmesh_graph.shading.specular import PrefilteredStack, directional_albedo, reflectance_table
from exmesh_graph.shading.suns import Suns
from exmesh_graph.stage1.appearance.colours import UVTexture
from exmesh_graph.stage1.appearance.directional import directions
from exmesh_graph.stage1.appearance.model import Surface
from exmesh_graph.stage1.vertices import serves
from exmesh_graph.stage2.fused.view import SpecularTables
from exmesh_graph.stage2.light.traced import traced_specular
from exmesh_graph.stage2.scene import Body, Lighting, Scene
from exmesh_graph.stage2.surface import bent_irradiance, turned_to
from exmesh_graph.stage3.fused import LEAST_SINE, Tables, VertexKernels
from exmesh_graph.targets import Targets
from exmesh_graph.types import Asset, Transport

#: Bounds of c: where the split sum is nearly black the ratio means nothing.
_LARGEST = 4.0
#: A sun is taken to stand at least this cosine above a vertex's horizon: below it, no first order holds.
_LOWEST = 0.1


class Shown(NamedTuple):
    """Vertices that a view may show, int64 [N], each once, and their c [N, 3]."""

    vertices: torch.Tensor
    scale: torch.Tensor


class Lit(UVTexture):
    """The asset's texture (sRGB-encoded, a leaf), drawn with the tints of its own light; made for one fit.

    The asset's mesh must be the surface that `prepare` is given. `seed` moves the lobes' rays.
    """

    def __init__(self, asset: Asset, transport: Transport, lobe_samples: int, seed: int, device: str = "cpu") -> None:
        super().__init__(torch.tensor(asset.texture, dtype=torch.float32, device=device))
        self.light = VertexLight(asset, transport, device)
        self.lights: dict[bytes, VertexLight] = {}  # of each view, where the light moves with the camera
        self.samples, self.seed = lobe_samples, seed
        self.shown: dict[bytes, Shown] = {}
        self.mean = torch.zeros_like(self.light.start)

    @torch.no_grad()
    def prepare(self, surface: Surface, targets: Targets) -> None:
        """Measure c of every view, and take the mean of S over the views that show a vertex's faces or one beside.

        Once: later calls change nothing."""
        if self.shown:
            return
        vertices, faces = surface.vertices.detach(), surface.faces.long()
        cameras = torch.linalg.inv(targets.world_to_camera.double()).cpu().numpy()
        turns = light_turns(self.light.body.asset.light_axis, cameras)

        def of(number: int) -> Shown:
            pose = targets.world_to_camera[number]
            light = self.lights[_key(pose)] = self.light.turned(None if turns is None else turns[number])
            place = project(vertices, targets.intrinsics[number], pose)
            face_id = rasterize_projected(place, surface.faces, targets.height, targets.width, bary=False).face_id
            seen = shown_vertices(face_id, faces, len(vertices))
            seen[faces[seen[faces].any(1)].reshape(-1)] = True  # a ring more: what moves may come into view
            chosen = torch.nonzero(seen)[:, 0]
            return Shown(chosen, light.specular_scale(pose, chosen, self.samples, (self.seed << 20) + number))

        total, count = torch.zeros_like(self.mean), torch.zeros_like(self.mean[:, :1])
        for pose, shown in zip(targets.world_to_camera, share(of, range(len(targets))), strict=True):
            self.shown[_key(pose)] = shown
            total[shown.vertices] += self.lights[_key(pose)].display(vertices, pose, shown)
            count[shown.vertices] += 1
        self.mean = total / count.clamp(min=1)

    def tints(self, vertices: torch.Tensor, world_to_camera: torch.Tensor) -> torch.Tensor:
        shown = self.shown[_key(world_to_camera)]
        light = self.lights[_key(world_to_camera)]
        tint = light.display(vertices, world_to_camera, shown) - self.mean[shown.vertices]
        return torch.zeros_like(self.mean).index_copy(0, shown.vertices, tint)


class VertexLight:
    """What an asset's environment does at its vertices, differentiable in where these are."""

    @torch.no_grad()
    def __init__(self, asset: Asset, transport: Transport, device: str = "cpu") -> None:
        self.body = body = Body(asset, transport, device)
        self.faces = body.geometry.faces
        count = len(body.geometry.vertices)
        self.face, self.bary = _carrying(self.faces, count)
        self.material = gather_rows(body.maps, *body.texels(self.face, self.bary))[:, : 5 if body.metallic else 4]
        self.angles = corner_angles(body.geometry.vertices, self.faces)
        self.start = weighted_normals(body.geometry.vertices, self.faces, self.angles)
        height, width = asset.environment.shape[:2]
        self.stack = PrefilteredStack(height, width, device)
        self.table = reflectance_table(device=device)
        self._light(None)

    def turned(self, turn: np.ndarray | None) -> VertexLight:
        """The same under the asset's environment turned by `turn` [3, 3] (shading.moving); None: as it is."""
        if turn is None:
            return self
        other = copy.copy(self)
        other._light(turn)
        return other

    @torch.no_grad()
    def _light(self, turn: np.ndarray | None) -> None:
        """What depends on the environment."""
        body = self.body
        (scene,) = body.under([Lighting()], turn)
        points = body.points(self.face, self.bary)
        self.sent = body.sends(gather_rows(body.maps, *body.lattice_texels)) * scene.irradiance
        vector = body.vectors.vector(scene.environment.binned, self.sent) + _of_suns(body, scene)
        self.irradiance = gather_rows(scene.irradiance, *points)
        self.vector = gather_rows(vector, *points)
        radiance = turned(tensor_of(body.asset.environment), turn).to(self.vector.device)
        self.rows, self.pyramid = self.stack.build(radiance), Pyramid(radiance)
        self.kernels = VertexKernels(self._tables()) if serves(body.geometry.vertices) else None

    def display(self, vertices: torch.Tensor, world_to_camera: torch.Tensor, shown: Shown) -> torch.Tensor:
        """S [N, 3] of those of `vertices` [V, 3] that a camera may show; by kernels where they serve.

        Equations: 12, 20.
        """
        if self.kernels is None or not serves(vertices.detach()):
            return self.plain_display(vertices, world_to_camera, shown)
        return self.kernels.display(vertices, _eye(world_to_camera.to(vertices)), shown.vertices, shown.scale)

    def plain_display(self, vertices: torch.Tensor, world_to_camera: torch.Tensor, shown: Shown) -> torch.Tensor:
        """`display` in torch: the reference, and the form of other devices and dtypes."""
        chosen = shown.vertices
        material = self.material[chosen]
        normal = weighted_normals(vertices, self.faces, self.angles).index_select(0, chosen)
        irradiance = bent_irradiance(self.irradiance[chosen], self.vector[chosen], self.start[chosen], normal)
        view = directions(vertices.index_select(0, chosen), world_to_camera)
        diffuse = brdf.diffuse(material[:, :3], material[:, 4] if self.body.metallic else None)
        return linear_to_srgb(diffuse * irradiance + self.split_sum(material, normal, view) * shown.scale)

    def split_sum(self, material: torch.Tensor, normal: torch.Tensor, view: torch.Tensor) -> torch.Tensor:
        """Unoccluded specular radiance [N, 3] towards `view` [N, 3] of materials [N, C] under `normal` [N, 3]."""
        _, n_v, reflected = turned_to(normal, view)
        index, weight = self.stack.locate(*envmap.uv_of(reflected), material[:, 3])
        albedo = directional_albedo(self.table, n_v, material[:, 3], self.f0(material))
        return albedo * gather_rows(self.rows, index, weight)

    def f0(self, material: torch.Tensor) -> torch.Tensor:
        """Reflectance [N, 3] at normal incidence."""
        f0 = brdf.base_reflectance(material[:, :3], material[:, 4] if self.body.metallic else None)
        return f0.expand(len(material), 3).contiguous()

    @torch.no_grad()
    def specular_scale(
        self, world_to_camera: torch.Tensor, chosen: torch.Tensor, samples: int, seed: int
    ) -> torch.Tensor:
        """c [N, 3] of the vertices `chosen` int64 [N]: the specular light that `samples` rays bring over the split
        sum."""
        body, material, pose = self.body, self.material[chosen], world_to_camera.to(self.start)
        surface = body.geometry.samples(self.face[chosen], self.bary[chosen], _eye(pose))
        shift = torch.rand(len(self.start), 2, generator=torch.Generator().manual_seed(seed)).to(pose)[chosen]
        traced = traced_specular(
            surface, body.geometry.face_normals, material[:, 3], self.f0(material), self.pyramid, body.tracer,
            lambda face, bary: at_surface(body.light, self.sent, face, bary), samples, shift,
        )  # fmt: skip
        split = self.split_sum(material, self.start[chosen], directions(body.geometry.vertices[chosen], pose))
        return (traced / split.clamp_min(1e-6)).clamp(0, _LARGEST)

    def _tables(self) -> Tables:
        count, material = len(self.material), self.material
        diffuse = brdf.diffuse(material[:, :3], material[:, 4] if self.body.metallic else None)
        lower, other = self.stack.between(material[:, 3])
        return Tables(
            faces=self.faces.int(), angles=self.angles, normals=self.start, diffuse=diffuse,
            irradiance=self.irradiance, vector=self.vector.reshape(count, 9), f0=self.f0(material),
            roughness=material[:, 3], lower=lower, share=other, rows=self.rows,
            specular=SpecularTables.of(self.stack, self.table),
        )  # fmt: skip


def _eye(world_to_camera: torch.Tensor) -> torch.Tensor:
    return -world_to_camera[:3, :3].T @ world_to_camera[:3, 3]


def _carrying(faces: torch.Tensor, count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """A face of each of `count` vertices, int64 [V], the first of those that have it, and its place there, [V, 3]."""
    corner = torch.arange(faces.numel(), device=faces.device)
    # a vertex without a face takes the last corner, and is never shown
    first = torch.full((count,), faces.numel() - 1, device=faces.device)
    first = first.scatter_reduce(0, faces.reshape(-1), corner, "amin")
    face = torch.div(first, 3, rounding_mode="floor")
    return face, F.one_hot(first % 3, 3).float()


def corner_angles(vertices: torch.Tensor, faces: torch.Tensor) -> torch.Tensor:
    """Angles [F, 3] of the faces at their corners, rad."""
    edges = _edges(vertices, faces)
    back = -edges.roll(1, 1)
    return torch.atan2(torch.linalg.cross(edges, back, dim=-1).norm(dim=-1), (edges * back).sum(-1))


def weighted_normals(vertices: torch.Tensor, faces: torch.Tensor, angles: torch.Tensor) -> torch.Tensor:
    """Unit normals [V, 3]: the sums of the faces' own, weighted by `angles` [F, 3]; with those of `corner_angles` what
    `geometry.adjacency.angle_weighted_normals` gives, but for needles (`LEAST_SINE`), which count nothing. Zero where
    no face has area."""
    edges = _edges(vertices, faces)
    out, back = edges[:, 0], -edges[:, 2]
    cross = torch.linalg.cross(out, back, dim=-1)
    needle = cross.detach().norm(dim=-1) <= LEAST_SINE * out.detach().norm(dim=-1) * back.detach().norm(dim=-1)
    normal = F.normalize(torch.where(needle[:, None], 0, cross), dim=-1, eps=1e-20)
    weighted = (angles[..., None] * normal[:, None]).reshape(-1, 3)
    total = torch.zeros_like(vertices).index_add(0, faces.reshape(-1), weighted)
    return F.normalize(total, dim=-1, eps=1e-12)


def _edges(vertices: torch.Tensor, faces: torch.Tensor) -> torch.Tensor:
    """[F, 3, 3], from each corner to the next."""
    corners = vertices.index_select(0, faces.reshape(-1)).view(-1, 3, 3)
    return corners.roll(-1, 1) - corners


def _of_suns(body: Body, scene: Scene) -> torch.Tensor | float:
    """The vector irradiance [P, 9] that the environment's small suns bring directly; 0 without any."""
    sky = scene.environment
    if sky.transfer is None:
        return 0.0
    towards = _middles(sky.suns).to(sky.transfer)
    normals = tensor_of(body.light.normals).to(sky.transfer)
    seen = sky.transfer / (normals @ towards.T).clamp_min(_LOWEST)  # [P, S]
    return (seen @ (towards[:, :, None] * sky.flux[:, None, :]).reshape(len(towards), 9)).reshape(-1, 9)


def _middles(suns: Suns) -> torch.Tensor:
    """Unit directions [S, 3] of the suns."""
    grid = (torch.arange(16, dtype=torch.float64) + 0.5) / 16
    middle = torch.full_like(grid, 0.5)
    return F.normalize(suns.directions(torch.stack([grid, middle, middle], dim=1)).mean(1), dim=-1)


def _key(world_to_camera: torch.Tensor) -> bytes:
    return world_to_camera.cpu().numpy().tobytes()
