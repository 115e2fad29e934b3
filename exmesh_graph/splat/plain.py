"""An iteration of a fit in torch's operations and Warp's kernels: CUDA, float64, and the reference of `fused.step`."""

from __future__ import annotations

import torch

from exmesh_graph.losses import d_ssim, l1
from exmesh_graph.splat.consistency import flattening, multi_view, single_view_normal
from exmesh_graph.splat.density import Density
from exmesh_graph.splat.gaussians import Gaussians
from exmesh_graph.splat.optimiser import GaussianAdam
from exmesh_graph.splat.pictures import Pictures, active_degree
from exmesh_graph.splat.render import Render, render


class PlainStep:
    """`loss` of a view, then `update` of the Gaussians by its gradient."""

    def __init__(self, pictures: Pictures, adam: GaussianAdam) -> None:
        self.pictures, self.adam = pictures, adam

    def loss(self, i: int, k: int) -> tuple[float, float]:
        """(loss, mean squared error of the picture) of view `i` in iteration `k`."""
        settings = self.pictures.settings
        self.leaves = self.adam.gaussians.map(lambda t: t.detach().requires_grad_())
        self.drawing = self._draw(self.leaves, i, k)
        loss, error = self._colour(self.drawing, i, k)
        loss = loss + settings.flatten_weight * flattening(self.leaves.scales, self.drawing.drawn.seen)
        if self.pictures.shaped(k):
            loss = loss + self._geometry(self.drawing, i, k)
        self.value = loss
        return float(loss.detach()), error

    def update(self, density: Density, rates: dict[str, float]) -> None:
        """Carry the loss back, tell `density`, and step."""
        tensors = self.leaves.tensors()
        gradients = torch.autograd.grad(self.value, list(tensors.values()))
        density.add(self.drawing, self.pictures.targets.width)
        self.adam.step(dict(zip(tensors, gradients, strict=True)), self.drawing.drawn.seen, rates)

    def _draw(self, gaussians: Gaussians, i: int, k: int) -> Render:
        t = self.pictures.targets
        degree = active_degree(self.pictures.settings, k)
        return render(gaussians, t.intrinsics[i], t.world_to_camera[i], t.height, t.width, degree=degree, native=False)

    def _colour(self, drawing: Render, i: int, k: int) -> tuple[torch.Tensor, float]:
        """.8 L1 + .2 (1 - SSIM) of the display picture, and the mask's L1 where it is known."""
        targets, settings = self.pictures.targets, self.pictures.settings
        weight = settings.ssim_weight
        image, target = drawing.colour, targets.images[i]
        gain = self.pictures.gain(i, k, image)
        if gain is not None:
            image = image * gain
        loss = (1 - weight) * l1(image, target)
        if weight > 0:
            box = targets.box(i)
            share = box.area / (targets.height * targets.width)
            loss = loss + 2 * weight * share * d_ssim(box.crop(image), targets.ssim_target(i))
        if bool(targets.masked[i]):
            loss = loss + settings.mask_weight * l1(drawing.alpha, targets.alpha[i])
        return loss, float((image.detach() - target).square().mean())

    def _geometry(self, drawing: Render, i: int, k: int) -> torch.Tensor:
        pictures, settings = self.pictures, self.pictures.settings
        view, generator = pictures.view(i), pictures.generator(k, 0)
        loss = settings.normal_weight * single_view_normal(drawing, view)
        other = pictures.neighbour(i, generator)
        if other is None:
            return loss
        with torch.no_grad():
            other_drawing = self._draw(self.adam.gaussians, other, k)
        pixels, share = pictures.samples(drawing.alpha.detach(), generator)
        geometric, photometric = multi_view(drawing, view, other_drawing, pictures.view(other), pixels)
        # means over the picture in PGSR, as the colour's is: the sampled mean times the covered share
        return loss + share * (settings.geometric_weight * geometric + settings.photometric_weight * photometric)
