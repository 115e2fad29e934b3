"""An iteration of a fit by native passes: `plain.PlainStep` in float32 on a CPU."""

from __future__ import annotations

import torch

from exmesh_graph.optim import EPSILON
from exmesh_graph.splat.consistency import View
from exmesh_graph.splat.density import Density
from exmesh_graph.splat.fused.draw import Camera, Drawing, Memory, numbers
from exmesh_graph.splat.fused.terms import Terms, Weights, strongest
from exmesh_graph.splat.optimiser import GaussianAdam
from exmesh_graph.splat.pictures import Pictures, active_degree
from exmesh_graph.splat.render import NEAR, PAIRS, TILE

_NO_RAYS = torch.empty(0)
_NO_COLOUR = -1


class FusedStep:
    """`loss` of a view, then `update` of the Gaussians by its gradient, which never lies in memory."""

    def __init__(self, pictures: Pictures, adam: GaussianAdam) -> None:
        self.pictures, self.adam = pictures, adam
        targets, settings = pictures.targets, pictures.settings
        self.terms = Terms(targets.height, targets.width)
        self.weights = Weights(settings.ssim_weight, settings.mask_weight)
        self.edges: dict[int, float] = {}
        self.memory = Memory(), Memory()  # of the view, and of its neighbour
        t = torch.arange(settings.iterations + 1, dtype=torch.float64)
        self.bias = torch.stack([1 - 0.9**t, 1 - 0.999**t], dim=1).float().contiguous()

    def loss(self, i: int, k: int) -> tuple[float, float]:
        """(loss, mean squared error of the picture) of view `i` in iteration `k`."""
        pictures, settings = self.pictures, self.pictures.settings
        drawing = self.drawing = self._draw(i, active_degree(settings, k), self.memory[0])
        gain = pictures.gain(i, k, drawing.planes.colour)
        value, error = self.terms.colour(drawing.planes, pictures.targets, i, self.weights, gain)
        seen, thickness = drawing.thickness()
        self.thin = settings.flatten_weight / max(seen, 1)
        value += settings.flatten_weight * thickness
        if pictures.shaped(k):
            return value + self._geometry(drawing, i, k), error
        self.terms.no_geometry()
        return value, error

    def update(self, density: Density, rates: dict[str, float]) -> None:
        """Carry the loss back, tell `density`, and step."""
        adam = self.adam
        of = torch.tensor([rates[name] for name in ("means", "scales", "rotations", "opacities", "sh", "sh_rest")])
        self.drawing.step(
            self.terms.to, self.thin, *adam.m.tensors().values(), *adam.v.tensors().values(), adam.steps, self.bias, of,
            EPSILON, self.pictures.targets.width / 2, density.sums, density.views, density.weight,
        )  # fmt: skip

    def _draw(self, i: int, degree: int, memory: Memory) -> Drawing:
        t = self.pictures.targets
        camera = numbers(t.intrinsics[i], t.world_to_camera[i]).float()
        return Drawing(self.adam.gaussians, Camera(camera, t.height, t.width, NEAR, degree, TILE["cpu"]), PAIRS, memory)

    def _geometry(self, drawing: Drawing, i: int, k: int) -> float:
        pictures, settings = self.pictures, self.pictures.settings
        view, generator = self._view(i), pictures.generator(k, 0)
        if i not in self.edges:
            self.edges[i] = strongest(view.image)
        value = settings.normal_weight * self.terms.normals(drawing.planes, view, settings.normal_weight, self.edges[i])
        other = pictures.neighbour(i, generator)
        if other is None:
            return value
        pixels, share = pictures.samples(drawing.planes.alpha, generator)
        weights = share * settings.geometric_weight, share * settings.photometric_weight
        fixed = self._draw(other, _NO_COLOUR, self.memory[1]).planes
        geometric, photometric = self.terms.neighbour(drawing.planes, view, fixed, self._view(other), pixels, weights)
        return value + weights[0] * geometric + weights[1] * photometric

    def _view(self, i: int) -> View:
        t = self.pictures.targets
        return View(t.images[i], _NO_RAYS, t.intrinsics[i], t.world_to_camera[i])
