"""The key light, a sun or a lamp that outshines all other light, found in Stage I's texture by shade and shadows.

Neighbouring points p, q of a surface are mostly of one paint. Then what they send, B (the texture in linear light),
says what arrives there: of an even sky A, of a light towards the direction d, s times as strong as what the sky brings
to level ground, t_p = max(n_p . d, 0) where p sees it, and of what other parts of the surface send on of both, on the
mean, where they hide the share H_p of the sky. So that d and s are sought under which

    E(d, s) = mean of min(|r_pq|, 1),    r_pq = log(B_p / B_q) - log(I_p / I_q),
    I_p     = A_p + s t_p + h H_p (mean A + s mean t)

is least; where B_p is clipped, which says only how bright it is at least, r_pq > 0 alone counts. An L1, so that edges
of paint cost about the same under any light. Then the light's reach, with t_p the mean over a disc about d.

A fit that starts from an even sky does not find a small strong light: its shadows are in the base colour long before it
has grown (docs/light_transport.md). Wide ones it finds by itself.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from exmesh_graph.colour import srgb_to_linear
from exmesh_graph.geometry.adjacency import face_normals
from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.rays import RayTracer, make_ray_tracer
from exmesh_graph.shading.point_sets import disc, fibonacci_sphere
from exmesh_graph.shading.transport import lattice_origins
from exmesh_graph.stage2.init import LUMINANCE
from exmesh_graph.stage2.start_light import KeyLight
from exmesh_graph.stage2.surface import texel_footprint
from exmesh_graph.types import Carrier, Transport

#: Share of E that a key light must explain, and its largest reach [degrees]: on what mirrors, no shade tells, and up to
#: 0.016 is chance; a light that is wider grows by itself (docs/stage2_trials.md).
LEAST, WIDEST = 0.03, 6
#: From so many times what E were if the same arrived everywhere a light explains nothing.
SHADELESS = 2.0
#: Display value from which a texel counts as clipped, and the luminance below which its logarithm is noise.
CLIPPED, DARK = 0.97, 2e-3
#: Points about each to compare it with, and pairs that are looked at: in the search, and to place what it found.
ABOUT, FEW, MANY = 8, 4000, 40_000
#: How much brighter than on average the even sky is straight above (`start_light.white_light`).
ABOVE = 0.95
#: h, what surfaces send on of what arrives on the mean; and what reaches every point, as a share of that.
SENT, LEFT = 0.3, 0.02
#: Directions of the search, of the whole sphere, and the sine of the lowest: light comes from above, and what gloss
#: does to a texture looks like light from below.
DIRECTIONS, LOWEST = 1024, -0.17
#: How many of the best are followed, how far apart these are, and how near to each is looked [degrees], the first time
#: and the second.
FOLLOWED, APART, NEAR = 5, math.radians(15), (5.0, 1.5)
#: Strengths s and reaches [degrees] of the search, and of the direction found.
COARSE, FINE = np.array([0.35, 1.0, 3.0, 8.0]), 2.0 ** np.linspace(-2, 5, 29)
WIDTHS, REACHES = (0, 12, 30), (0, 6, 12, 20, 30, 45)
#: Directions about one that are looked at, and directions that a disc is made of.
AROUND, DISC = 16, 24


def find_key_light(carrier: Carrier, light: Transport) -> KeyLight:
    """The light that explains Stage I's texture best, however little that is and however wide (`counts`); one of
    strength 0 where all of it is clipped.

    light  the transport of the carrier's mesh, for its points and what they see of the sky
    """
    points = _Points(carrier, light)
    few, many = points.pairs(FEW), points.pairs(MANY)
    if not len(few.p):  # all clipped
        return KeyLight(np.array([0.0, 1.0, 0.0]), 0.0)
    found = _search(points, few)
    for pairs, degrees in zip((few, many), NEAR, strict=True):
        found = [min(_nearer(points, pairs, direction, reach, degrees) for _, reach, direction in found)]
    direction = np.array(found[0][2])
    best = [points.best(many, points.disc(many, direction, reach), FINE) for reach in REACHES]
    k = int(np.argmin([cost for cost, _ in best]))
    cost, strength = best[k]
    even = points.cost(many, np.zeros(len(many.points)), 0.0)
    # a texture without shade, of a hollow say: a sun that shines into all corners explains it best, nothing far better
    shaded = cost < SHADELESS * _error(many, many.step)
    return KeyLight(direction, strength, REACHES[k], 1 - cost / max(even, 1e-12) if shaded else 0.0)


#: E, reach and direction of a light.
_Tried = tuple[float, int, tuple[float, ...]]


def _search(points: _Points, pairs: _Pairs) -> list[_Tried]:
    """The best lights of the whole sky, far from one another."""
    tried = fibonacci_sphere(DIRECTIONS)
    tried = tried[tried[:, 1] > LOWEST]
    each = np.stack([points.arriving(pairs.points, d) for d in tried])
    lights: list[_Tried] = []
    for reach in WIDTHS:
        within = _within(tried, tried, reach)
        costs = [points.best(pairs, t, COARSE)[0] for t in within @ each]
        lights += [(cost, reach, tuple(d)) for cost, d in zip(costs, tried, strict=True)]
    found: list[_Tried] = []
    for light in sorted(lights):
        if all(np.dot(light[2], other[2]) < math.cos(APART) for other in found):
            found.append(light)
        if len(found) == FOLLOWED:
            break
    return found


def _nearer(points: _Points, pairs: _Pairs, direction: tuple[float, ...], reach: int, degrees: float) -> _Tried:
    """The best light of this reach within `degrees` of a direction."""
    middle = np.array(direction)
    near = np.concatenate([middle[None], disc(middle, AROUND, degrees)])
    rays = disc(middle, 2 * DISC, degrees + reach) if reach else near
    each = np.stack([points.arriving(pairs.points, d) for d in rays])
    costs = [points.best(pairs, t, COARSE)[0] for t in _within(near, rays, reach) @ each]
    k = int(np.argmin(costs))
    return costs[k], reach, tuple(near[k])


def _within(about: np.ndarray, directions: np.ndarray, reach: int) -> np.ndarray:
    """Weights [N, M] of `directions` [M, 3] that make a disc of the reach about each of [N, 3]; the nearest alone makes
    one of reach 0."""
    cosine = about @ directions.T
    nearest = cosine.max(axis=1, keepdims=True) - 1e-12
    near = cosine >= (np.minimum(nearest, math.cos(math.radians(reach))) if reach else nearest)
    return near / near.sum(axis=1, keepdims=True)


def counts(found: KeyLight) -> bool:
    """Whether a fit should start with it."""
    return found.gain >= LEAST and found.reach <= WIDEST


def described(found: KeyLight) -> str:
    """One sentence about it, and whether it is taken."""
    high = math.degrees(math.asin(min(1.0, max(-1.0, float(found.direction[1])))))
    wide = f"{2 * found.reach} degrees wide" if found.reach else "as small as a sun"
    need = "taken" if counts(found) else f"taken from {100 * LEAST:.0f} % on, if no wider than {2 * WIDEST} degrees"
    return (
        f"A light {high:.0f} degrees high, {wide}, with {found.strength:.1f} times what all other brings, explains "
        f"{100 * found.gain:.1f} % of what neighbouring points differ by; {need}."
    )


class _Pairs(NamedTuple):
    """Neighbours p, q int [N] among `points` int [M], log(B_p / B_q), and whether B_p or B_q is clipped."""

    points: np.ndarray
    p: np.ndarray
    q: np.ndarray
    step: np.ndarray
    p_clipped: np.ndarray
    q_clipped: np.ndarray


class _Points:
    """The transport's points: what they send, and how much of the sky they see."""

    def __init__(self, carrier: Carrier, light: Transport) -> None:
        face = light.point_face.astype(np.int64)
        corners = carrier.uvs[carrier.uv_faces[face]]
        index, weight = texel_footprint(
            tensor_of((corners * light.point_bary[..., None]).sum(1, dtype=np.float32)), carrier.texture.shape[0]
        )
        texels = tensor_of(np.asarray(carrier.texture, np.float32)).reshape(-1, 3)
        shown = (texels[index.long()] * weight[..., None]).sum(1).clamp(0, 1)
        sent = srgb_to_linear(shown).double().numpy() @ LUMINANCE
        self.leaving = np.log(np.maximum(sent, DARK))
        self.clipped = shown.amax(dim=1).numpy() > CLIPPED
        self.near = cKDTree(light.points).query(light.points, k=min(ABOUT + 1, len(light.points)))[1]
        # the mean of a few: bumps of a mesh are no shade
        normals = light.normals[self.near].astype(np.float64).mean(axis=1)
        self.normals = normals / np.linalg.norm(normals, axis=1, keepdims=True).clip(1e-12)
        self.flat = face_normals(carrier.vertices, carrier.faces)[face]
        self.tracer: RayTracer = make_ray_tracer(carrier.vertices, carrier.faces)
        self.origins = lattice_origins(light, carrier.vertices, carrier.faces, self.tracer.radius).astype(np.float32)
        seen = np.unpackbits(light.visible, axis=1, count=len(light.directions), bitorder="little")
        cosine = np.maximum(self.normals @ light.directions.T, 0) * (4 / len(light.directions))
        bright = 1 + ABOVE * light.directions[:, 1]
        self.sky = (cosine * seen) @ bright
        self.sent_on = SENT * (cosine * (1 - seen)).sum(axis=1) + LEFT

    def pairs(self, most: int) -> _Pairs:
        """Neighbours that face alike, not both clipped: about `most` of them, evenly taken."""
        p = np.repeat(np.arange(len(self.near)), self.near.shape[1] - 1)
        q = self.near[:, 1:].reshape(-1)
        alike = (self.normals[p] * self.normals[q]).sum(axis=1) > 0
        chosen = np.flatnonzero((p < q) & alike & ~(self.clipped[p] & self.clipped[q]))
        chosen = chosen[:: max(1, len(chosen) // most)]
        p, q = p[chosen], q[chosen]
        used, (p, q) = _renumbered(p, q)
        leaving, clipped = self.leaving[used], self.clipped[used]
        return _Pairs(used, p, q, leaving[p] - leaving[q], clipped[p], clipped[q])

    def best(self, pairs: _Pairs, t: np.ndarray, strengths: np.ndarray) -> tuple[float, float]:
        """The least E of these strengths, and its strength; `t` [M] as of `arriving`."""
        costs = [self.cost(pairs, t, s) for s in strengths]
        return min(costs), float(strengths[int(np.argmin(costs))])

    def disc(self, pairs: _Pairs, direction: np.ndarray, reach: int) -> np.ndarray:
        """t [M] of an even disc about a direction, of reach 0 the direction alone."""
        towards = disc(direction, DISC, reach) if reach else direction[None]
        return np.mean([self.arriving(pairs.points, d) for d in towards], axis=0)

    def arriving(self, points: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """t [M] of a direction at some of the points."""
        cosine = self.normals[points] @ direction
        lit = np.flatnonzero((cosine > 0) & (self.flat[points] @ direction > 0))
        towards = np.ascontiguousarray(np.broadcast_to(direction.astype(np.float32), (len(lit), 3)))
        t = np.zeros(len(points))
        t[lit] = cosine[lit] * ~self.tracer.any_hit(self.origins[points[lit]], towards)
        return t

    def cost(self, pairs: _Pairs, t: np.ndarray, s: float) -> float:
        """E of the direction with `t` [M]."""
        direct = self.sky[pairs.points] + s * t
        arriving = np.log(direct + self.sent_on[pairs.points] * direct.mean())
        return _error(pairs, pairs.step - (arriving[pairs.p] - arriving[pairs.q]))


def _error(pairs: _Pairs, off: np.ndarray) -> float:
    """The mean over pairs that are off by so much."""
    error = np.where(pairs.p_clipped, off.clip(min=0), np.where(pairs.q_clipped, (-off).clip(min=0), np.abs(off)))
    return float(np.minimum(error, 1).mean())


def _renumbered(p: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The numbers that occur, in order, and [2, N] places of p and q among them."""
    used, places = np.unique(np.concatenate([p, q]), return_inverse=True)
    return used, places.reshape(2, -1)
