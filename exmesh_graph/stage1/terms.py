"""The loss of one view in Stage I, term by term (the paper's L_I, eq. 7 to 9):

    L = (1 - l_ssim) L1(I) + l_ssim D-SSIM(I) + w_a L_m(alpha) + w_d L_d + L_s + w_b L_b + w_f L_f

with I the display image over black. Image terms are means over all pixels of the view; no term depends on the scene's
scale. Without masks the photograph itself is the background, and with a region (the projection of a coarse surface)
pixels outside it have no say and the coverage term w_c mean (1 - alpha) inside it keeps the surface from giving way.
L_f, of closed surfaces, is ours: the share of pixels that show a face from behind (`facing.behind`).
"""

from __future__ import annotations

import torch

from exmesh_graph import losses
from exmesh_graph.geometry.pixels import pixel_width
from exmesh_graph.raster import barycentrics
from exmesh_graph.stage1.appearance.model import Surface
from exmesh_graph.stage1.facing import behind
from exmesh_graph.stage1.image_terms import ImageTerms
from exmesh_graph.stage1.regularise import REFERENCE_DECAY, Smoother, Smoothness, deviation, mean_edge, pulled, smoother
from exmesh_graph.stage1.render import Picture, draw
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.targets import Gains, Targets


class Terms:
    """The terms on one topology, and what they keep from view to view: gains, and L_b's running mean of vertices."""

    def __init__(
        self,
        surface: Surface,
        targets: Targets,
        settings: RefineSettings,
        smoothness: Smoothness,
        *,
        fused: bool = False,
        firmness: torch.Tensor | None = None,
    ) -> None:
        """`fused`: image terms of the usual kind come with one gradient for their sum (`image_terms`).

        firmness  float [V]: by how much more the smoothness pulls at each vertex
        """
        usual = settings.silhouette == "l1" and targets.inside is None and not settings.gains
        on_cpu = targets.device.type == "cpu"
        self.fused = ImageTerms(targets, settings) if fused and usual and on_cpu else None
        self.firmness = firmness
        self.targets, self.settings, self.faces = targets, settings, surface.faces
        vertices = surface.vertices.detach()
        self.smoothness = smoothness.prepare(
            vertices, surface.edges, mean_edge(vertices, surface.edges.edges) / _pixel(vertices, targets)
        )
        self.smoother: Smoother | None = None
        # the running mean that L_b measures from starts anew with every call, hence after every change of topology
        self.reference: torch.Tensor | None = None
        if settings.deviation_weight > 0:
            self.smoother, self.reference = smoother(vertices, surface.edges.edges), vertices.clone()
        self.gains = _initial_gains(surface, targets) if settings.gains else None
        self.closed = settings.facing_weight > 0 and bool((surface.edges.opposite >= 0).all())

    def changing(self) -> dict[str, torch.Tensor]:
        """The tensors that change from iteration to iteration, in place."""
        kept = {"reference": self.reference, "gains": None if self.gains is None else self.gains.factors}
        return {name: tensor for name, tensor in kept.items() if tensor is not None}

    def of(self, view: int, picture: Picture, vertices: torch.Tensor) -> tuple[dict[str, torch.Tensor], float]:
        """The weighted terms by name, and the mean squared error of the image; fits the view's gain on the way.

        Equations: 7, 8.
        """
        settings = self.settings
        if self.fused is not None and bool(self.targets.masked[view]):
            *usual, error = self.fused.of(view, picture.colour, picture.alpha)
            terms = dict(zip(("l1", "d_ssim", "silhouette"), usual, strict=True))
        else:
            terms, error = self._image_terms(view, picture)
        if self.targets.depth is not None and settings.depth_weight > 0:
            terms["depth"] = settings.depth_weight * self._depth(view, picture)
        if self.smoothness is not None and self.smoothness.loss is not None:
            even = vertices if self.firmness is None else pulled(vertices, self.firmness)
            terms["smoothness"] = self.smoothness.loss(even)
        if self.smoother is not None and self.reference is not None:
            terms["deviation"] = settings.deviation_weight * deviation(vertices, self.reference, self.smoother)
        if self.closed:
            place = picture.projected, picture.fragments, self.targets.intrinsics[view]
            turned = behind(vertices, self.faces, *place, picture.shown)
            if turned is not None:
                terms["facing"] = settings.facing_weight * turned
        return terms, error

    def _image_terms(self, view: int, picture: Picture) -> tuple[dict[str, torch.Tensor], float]:
        """The weighted terms of colour and coverage, one by one, and the mean squared error of the image."""
        settings = self.settings
        image = self._comparable(view, picture)
        target, mask = self.targets.images[view], self.targets.alpha[view]
        terms = {"l1": (1 - settings.ssim_weight) * losses.l1(image, target)}
        if settings.ssim_weight > 0:
            box = self.targets.box(view)
            share = box.area / mask.numel()
            terms["d_ssim"] = (
                settings.ssim_weight * share * losses.d_ssim(box.crop(image), self.targets.ssim_target(view))
            )
        if bool(self.targets.masked[view]) and settings.silhouette_weight > 0:
            of = losses.l1 if settings.silhouette == "l1" else losses.silhouette_bce
            terms["silhouette"] = settings.silhouette_weight * of(picture.alpha, mask)
        if self.targets.inside is not None and settings.coverage_weight > 0:
            uncovered = torch.where(self.targets.inside[view], 1 - picture.alpha, 0.0).clamp(min=0)
            terms["coverage"] = settings.coverage_weight * uncovered.mean()
        return terms, float((image.detach() - target).square().mean())

    def follow(self, vertices: torch.Tensor) -> None:
        """Let L_b's running mean follow the moved vertices."""
        if self.reference is not None:
            self.reference.lerp_(vertices.detach(), 1 - REFERENCE_DECAY)

    def relative_gains(self) -> dict[str, list[float]] | None:
        """The factors by view name, divided by their mean, where they are fitted."""
        if self.gains is None:
            return None
        return {name: [round(factor, 4) for factor in gain] for name, gain in self.gains.named().items()}

    def _comparable(self, view: int, picture: Picture) -> torch.Tensor:
        """The picture under the view's exposure and, without a mask, over the photograph's own background."""
        image, target = picture.colour, self.targets.images[view]
        if self.gains is not None:
            self.gains.follow(view, image.detach())
            image = image * self.gains.relative(view)
        if not bool(self.targets.masked[view]):
            # nothing is known of the background: let the photograph itself stand there
            image = image + (1 - picture.alpha[..., None]) * target
        if self.targets.inside is not None:
            image = torch.where(self.targets.inside[view][..., None], image, target)
        return image

    def _depth(self, view: int, picture: Picture) -> torch.Tensor:
        """Paper eq. 9 over the pixels that are covered, inside the mask and have a reference depth."""
        reference = self.targets.depth
        assert reference is not None
        face_id = picture.fragments.face_id.view(-1)
        known = (face_id >= 0) & (reference[view].view(-1) > 0) & (self.targets.alpha[view].view(-1) > 0.5)
        pixels = torch.nonzero(known)[:, 0]
        bary = barycentrics(picture.projected, self.faces, face_id[pixels], pixels, self.targets.width)
        z = (bary * picture.projected[self.faces[face_id[pixels].long()].long(), 2]).sum(-1)
        seen = torch.ones_like(z, dtype=torch.bool)
        return losses.pearson_depth(z, reference[view].view(-1)[pixels], seen)


def _pixel(vertices: torch.Tensor, targets: Targets) -> float:
    """Width of a pixel of the photographs at the middle of the vertices, world units."""
    middle = vertices.mean(dim=0).double().cpu().numpy()
    return pixel_width(targets.intrinsics.cpu().numpy(), targets.world_to_camera.cpu().numpy(), middle)


@torch.no_grad()
def _initial_gains(surface: Surface, targets: Targets) -> Gains:
    """Factors of all views for the surface as it is."""
    gains = Gains(targets)
    for i in range(len(targets)):
        picture = draw(surface, targets.intrinsics[i], targets.world_to_camera[i], targets.height, targets.width)
        gains.follow(i, picture.colour, rate=1.0)
    return gains
