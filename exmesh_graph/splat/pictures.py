"""What an iteration of a fit compares with: its view, a neighbour, pixels drawn by lot."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch

from exmesh_graph.raster.camera import pixel_rays
from exmesh_graph.splat.consistency import View
from exmesh_graph.targets import Gains, Targets

if TYPE_CHECKING:
    from exmesh_graph.splat.settings import PgsrSettings

_NEIGHBOURS, _WIDEST = 8, 45.0
_GAINS_FROM = 0.2


class Pictures:
    """The targets of a fit with its settings and seed. What is random is a function of seed and iteration: no state to
    carry through a checkpoint."""

    def __init__(self, targets: Targets, settings: PgsrSettings, seed: int) -> None:
        self.targets, self.settings, self.seed = targets, settings, seed
        self.gains = Gains(targets)
        self.near = nearest_views(targets.world_to_camera)
        self._rays: dict[bytes, torch.Tensor] = {}

    def generator(self, k: int, purpose: int) -> torch.Generator:
        """Random numbers of iteration `k`."""
        return torch.Generator().manual_seed(int(np.random.SeedSequence([self.seed, k, purpose]).generate_state(1)[0]))

    def view(self, i: int) -> View:
        """Views of one camera share their rays."""
        t = self.targets
        camera = t.intrinsics[i].cpu().numpy().tobytes()
        if camera not in self._rays:
            self._rays[camera] = pixel_rays(t.intrinsics[i], t.height, t.width, t.images[i])
        return View(t.images[i], self._rays[camera], t.intrinsics[i], t.world_to_camera[i])

    def gain(self, i: int, k: int, image: torch.Tensor) -> torch.Tensor | None:
        """The factor [3] that view `i` asks of `image` [H, W, 3], which it follows; None where none is fitted."""
        if not self.settings.gains:
            return None
        if k >= _GAINS_FROM * self.settings.iterations:  # before, the picture is too dark to tell
            self.gains.follow(i, image.detach())
        return self.gains.relative(i)

    def shaped(self, k: int) -> bool:
        """Whether normals and neighbours act in iteration `k`."""
        return k >= self.settings.geometry_from * self.settings.iterations

    def neighbour(self, i: int, generator: torch.Generator) -> int | None:
        """One of the views near view `i`; None where there is none, or its terms weigh nothing."""
        near, settings = self.near[i], self.settings
        if len(near) == 0 or settings.geometric_weight == settings.photometric_weight == 0:
            return None
        return int(near[int(torch.randint(len(near), (1,), generator=generator))])

    def samples(self, alpha: torch.Tensor, generator: torch.Generator) -> tuple[torch.Tensor, float]:
        """(flat indices of covered pixels, at most `samples`; the covered share of the picture)."""
        covered = torch.nonzero(alpha.reshape(-1) > 0.5)[:, 0]
        share = len(covered) / alpha.numel()
        if len(covered) > self.settings.samples:
            chosen = torch.randperm(len(covered), generator=generator)[: self.settings.samples].to(covered.device)
            covered = covered[chosen]
        return covered, share


def active_degree(settings: PgsrSettings, iteration: int) -> int:
    """Harmonics in use: a degree more with each fifth of the iterations."""
    return min(settings.degree, 5 * iteration // max(settings.iterations, 1))


def nearest_views(world_to_camera: torch.Tensor) -> list[np.ndarray]:
    """For each view the up to eight nearest in direction, less than 45 degrees away and not at the same place."""
    poses = torch.linalg.inv(world_to_camera.cpu().double()).numpy()
    forward, centre = poses[:, :3, 2], poses[:, :3, 3]
    angle = np.degrees(np.arccos(np.clip(forward @ forward.T, -1, 1)))
    apart = np.linalg.norm(centre[:, None] - centre[None], axis=-1)
    reach = np.linalg.norm(centre - centre.mean(0), axis=1).max()
    usable = (angle < _WIDEST) & (apart > 1e-3 * reach)
    np.fill_diagonal(usable, False)
    order = np.argsort(np.where(usable, angle, np.inf), axis=1, kind="stable")
    return [row[usable[i, row]][:_NEIGHBOURS] for i, row in enumerate(order)]
