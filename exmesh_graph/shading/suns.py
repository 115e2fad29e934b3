"""Small bright lights of an environment, kept apart from the directions that the transport bins it to.

A sun of 10^5 times the mean radiance in one texel carries most of the light. Binned to the nearest of K directions it
casts its shadow and its shading from up to a cell's width (7 degrees for K = 256) beside its place. So its texels leave
the binned environment, and its flux, linear in them, arrives from where they are: exact directions, rays of its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from exmesh_graph.rays import RayTracer
from exmesh_graph.rays.tensors import any_hit
from exmesh_graph.shading import envmap
from exmesh_graph.shading.env_sampling import tent
from exmesh_graph.shading.point_sets import sobol_points

#: A texel belongs to a sun from this many times the mean radiance on.
BRIGHTNESS = 20.0
#: Share of the whole flux from which a sun matters, and how many of them are kept apart, the strongest first.
SHARE, MOST = 0.01, 8
#: Largest solid angle of a sun over that of a direction's cell: wider lights the directions resolve by themselves.
CELLS = 4.0
#: Rays of a point towards a sun.
SUN_RAYS = 8
#: Rays at a time.
CHUNK = 1 << 18


@dataclass(frozen=True)
class Suns:
    """S suns of an environment of `shape` (H, W).

    texel    int64 [T], flat texels of all suns;  sun  int64 [T], which one each belongs to
    angle    float [T], solid angle of each texel;  share  float64 [T], its share of its sun's flux when found
    radius   float [S], half the angle that the sun spans [rad], at least a texel's
    """

    shape: tuple[int, int]
    texel: torch.Tensor
    sun: torch.Tensor
    angle: torch.Tensor
    share: torch.Tensor
    radius: torch.Tensor

    def __len__(self) -> int:
        return len(self.radius)

    def flux(self, environment: torch.Tensor) -> torch.Tensor:
        """Radiance times solid angle of each sun, [S, 3]; linear in the texels of `environment` [H, W, 3]."""
        texels = environment.reshape(-1, 3)[self.texel] * self.angle[:, None].to(environment)
        return environment.new_zeros(len(self), 3).index_add(0, self.sun, texels)

    def without(self, environment: torch.Tensor) -> torch.Tensor:
        """`environment` with the suns' texels black."""
        keep = torch.ones(self.shape[0] * self.shape[1], dtype=environment.dtype, device=environment.device)
        keep[self.texel] = 0
        return environment * keep.reshape(*self.shape, 1)

    def directions(self, uniform: torch.Tensor) -> torch.Tensor:
        """Unit directions [S, N, 3] spread over each sun in proportion to its bilinear radiance, from [N, 3] in [0, 1).

        The first number picks the texel, the others the place under its tent.
        """
        height, width = self.shape
        directions = []
        for number in range(len(self)):
            mine = self.sun == number
            texel, cumulated = self.texel[mine], self.share[mine].cumsum(0)
            chosen = texel[torch.searchsorted(cumulated, uniform[:, 0].double().contiguous()).clamp_max(len(texel) - 1)]
            row, column = torch.div(chosen, width, rounding_mode="floor"), chosen % width
            y = row + 0.5 + tent(uniform[:, 1])
            y = torch.where(y < 0, -y, torch.where(y > height, 2 * height - y, y))
            directions.append(envmap.direction_of(((column + 0.5 + tent(uniform[:, 2])) / width) % 1, y / height))
        return (
            torch.stack(directions).float() if directions else torch.zeros(0, len(uniform), 3, device=self.texel.device)
        )


def find_suns(environment: torch.Tensor, directions: int) -> Suns:
    """The suns of `environment` [H, W, 3] that K = `directions` equal-area directions cannot resolve (maybe none).

    Connected texels (eight neighbours, wrapped in longitude) of more than BRIGHTNESS times the mean radiance, together
    no wider than CELLS cells of 4 pi / K, with more than SHARE of the whole flux.
    """
    from scipy.ndimage import label

    radiance = environment.detach().double().mean(-1).cpu().numpy()
    height, width = radiance.shape
    angle = np.repeat(envmap.solid_angles(height, width)[:, None], width, 1)
    whole = float((radiance * angle).sum())
    marks, _ = label(radiance > BRIGHTNESS * whole / (4 * math.pi), structure=np.ones((3, 3)))
    for row in range(height):  # across the seam
        for near in marks[max(row - 1, 0) : row + 2, -1]:
            if marks[row, 0] and near:
                marks[marks == near] = marks[row, 0]
    power = {k: float((radiance * angle)[marks == k].sum()) for k in np.unique(marks[marks > 0])}
    small = [k for k in power if angle[marks == k].sum() <= CELLS * 4 * math.pi / directions]
    kept = sorted((k for k in small if power[k] > SHARE * whole), key=lambda k: -power[k])[:MOST]
    texel = [np.flatnonzero(marks == k) for k in kept]
    flat = np.concatenate(texel) if kept else np.zeros(0, np.int64)
    sun = np.repeat(np.arange(len(kept)), [len(t) for t in texel])
    flux = (radiance * angle).reshape(-1)[flat]
    radius = [max(math.sqrt(angle.reshape(-1)[t].sum() / math.pi), math.pi / height) for t in texel]
    device = environment.device
    return Suns(
        (height, width),
        torch.from_numpy(flat).to(device),
        torch.from_numpy(sun.astype(np.int64)).to(device),
        torch.from_numpy(angle.reshape(-1)[flat]).float().to(device),
        torch.from_numpy(flux / np.array([power[k] for k in kept])[sun] if kept else flux).to(device),
        torch.tensor(radius, dtype=torch.float32, device=device),
    )


def overlap(one: Suns, other: Suns) -> float:
    """How much of the suns' light leaves from the same places, by the sun that shares least of it: 1 for the same suns,
    0 where there are not as many."""
    if one.shape != other.shape or len(one) != len(other):
        return 0.0
    shares = torch.zeros(2, len(one), one.shape[0] * one.shape[1], dtype=torch.float64, device=one.texel.device)
    for place, suns in zip(shares, (one, other), strict=True):
        place[suns.sun, suns.texel] = suns.share
    common = torch.minimum(shares[0][:, None], shares[1]).sum(-1)  # [S, S]
    best = common.max(dim=1)
    return float(best.values.min()) if len(best.indices.unique()) == len(one) else 0.0


@torch.no_grad()
def unoccluded(
    origins: torch.Tensor, flat: torch.Tensor, directions: torch.Tensor, tracer: RayTracer, chunk: int = CHUNK
) -> torch.Tensor:
    """Which rays from `origins` [N, 3] towards `directions` [S, N, 3] leave the surface of geometric normals `flat`
    [N, 3] and meet nothing: bool [S, N]."""
    free = (directions * flat).sum(-1) > 0
    for part in torch.nonzero(free).split(chunk):
        sun, point = part.unbind(1)
        free[sun, point] = ~any_hit(tracer, origins[point], directions[sun, point])
    return free


@torch.no_grad()
def sun_transfer(
    suns: Suns,
    origins: torch.Tensor,
    normal: torch.Tensor,
    flat: torch.Tensor,
    tracer: RayTracer,
    samples: int = SUN_RAYS,
) -> torch.Tensor:
    """Irradiance [N, S] of points per flux of each sun: the mean of max(n . w, 0) over what is seen of it."""
    result = normal.new_zeros(len(normal), len(suns))
    for sun, towards in enumerate(suns.directions(sobol_points(samples).to(normal.device))):
        result[:, sun] = seen_irradiance(towards, origins, normal, flat, tracer)
    return result


@torch.no_grad()
def seen_irradiance(
    towards: torch.Tensor, origins: torch.Tensor, normal: torch.Tensor, flat: torch.Tensor, tracer: RayTracer
) -> torch.Tensor:
    """max(n . w, 0) [N], averaged over the directions `towards` [K, 3] in which rays of points meet nothing.

    A point whose first half of rays all meet something, or all nothing, is in no penumbra: the other half is not traced
    there. So a soft shadow is a little harder, by 0.04 of the sun where a fifth of it is hidden.
    """
    result, samples = normal.new_zeros(len(normal)), len(towards)
    traced, free = (torch.zeros(len(normal), dtype=torch.int8, device=normal.device) for _ in range(2))
    for number, direction in enumerate(towards):
        cosine = _along(normal, direction)
        lit = (cosine > 0) & (_along(flat, direction) > 0)
        if 2 * number >= samples:
            clear = lit & (traced > 0) & (free == traced)
            result += torch.where(clear, cosine, 0)
            lit &= (traced == 0) | ((free > 0) & (free < traced))
        for part in torch.nonzero(lit)[:, 0].split(CHUNK):
            seen = ~any_hit(tracer, origins[part], direction.expand(len(part), 3))
            result[part] += cosine[part] * seen
            if 2 * number < samples:
                traced[part] += 1
                free[part] += seen
    return result / samples


@torch.no_grad()
def open_irradiance(towards: torch.Tensor, normal: torch.Tensor, flat: torch.Tensor) -> torch.Tensor:
    """`seen_irradiance` [N] where nothing stands in the way."""
    result = normal.new_zeros(len(normal))
    for direction in towards:
        cosine = _along(normal, direction)
        result += torch.where((cosine > 0) & (_along(flat, direction) > 0), cosine, 0)
    return result / len(towards)


def _along(vectors: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
    """v . w of vectors [N, 3] and one direction [3]: by columns, the same bytes for any number of threads."""
    x, y, z = direction.tolist()
    return vectors[:, 0] * x + vectors[:, 1] * y + vectors[:, 2] * z
