"""Renders for scoring: one shape at the cameras of the test views, and the gray object of the floor."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from exmesh_graph.evaluate.settings import Quality
from exmesh_graph.io.images import display
from exmesh_graph.types import Asset, Region, SceneTruth, Views

if TYPE_CHECKING:
    from exmesh_graph.stage2.scene import Lighting

GRAY_ALBEDO = 0.5
GRAY_ROUGHNESS = 0.5

Progress = Callable[[int, int], None]


class Steps:
    """Counts rendered views for the progress bar."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self.progress, self.total, self.done = progress, total, 0

    def __call__(self, *_: int) -> None:
        self.done += 1
        if self.progress:
            self.progress(self.done, self.total)


class Renderer:
    """Renders one shape at the cameras of `views`, tracing its light transport once; light is cast by `casts` [F].

    With a `region` a pixel is covered (alpha 1, else 0) where all its samples lie at the region's depths, or off them
    by no more than half their interval, so that nothing is in it of what stands far behind or before.
    """

    def __init__(
        self,
        asset: Asset,
        views: Views,
        quality: Quality,
        steps: Steps,
        seed: int,
        casts: np.ndarray | None = None,
        region: Region | None = None,
    ) -> None:
        self.asset, self.views, self.quality, self.steps, self.seed = asset, views, quality, steps, seed
        self.casts, self.region = casts, region
        self._body: Any = None

    def render(self, chosen: Sequence[int], lightings: Sequence[Lighting] | None = None) -> list[Any]:
        """`stage2.render.Rendered` of the chosen views under each of `lightings` (None: its own environment alone)."""
        from exmesh_graph.stage2.render import render_transport, render_under
        from exmesh_graph.stage2.scene import Body, Lighting

        quality, rows = self.quality, list(chosen)
        if self._body is None:
            transport = render_transport(self.asset, quality.bounces, quality.directions, casts=self.casts)
            self._body = Body(self.asset, transport, casts=self.casts)
        between = None
        if self.region is not None:
            row_of = {name: row for row, name in enumerate(self.region.names)}
            places = [row_of[self.views.names[i]] for i in rows]
            near, far = self.region.near[places], self.region.far[places]
            # beside the centre the same slope may lie farther off; the centre itself is held to the interval
            slack = (far - near) / 2
            between = (near - slack, far + slack)
        rendered = render_under(
            self._body,
            self.views.intrinsics[rows],
            self.views.camera_to_world[rows],
            self.views.height,
            self.views.width,
            lightings or [Lighting()],
            supersampling=quality.supersampling,
            specular_samples=quality.specular_samples,
            seed=self.seed,
            progress=self.steps,
            between=between,
        )
        return rendered if between is None else [replace(one, alpha=_whole(one.alpha)) for one in rendered]


def gray_object(asset: Asset, truth: SceneTruth | None) -> Asset:
    """The uninformed guess: the true shape (ours where none is known) in uniform gray under uniform light of 1."""
    vertices, faces = asset.vertices, asset.faces
    if truth is not None and truth.mesh_vertices is not None and truth.mesh_faces is not None:
        vertices, faces = truth.mesh_vertices, truth.mesh_faces
    return Asset(
        vertices=vertices,
        faces=faces,
        uvs=np.full((1, 2), 0.5, np.float32),
        uv_faces=np.zeros((len(faces), 3), np.int32),
        texture=np.full((2, 2, 3), 0.5, np.float32),
        base_color=np.full((2, 2, 3), GRAY_ALBEDO, np.float32),
        roughness=np.full((2, 2), GRAY_ROUGHNESS, np.float32),
        seen=np.ones((2, 2), bool),
        environment=np.ones((16, 32, 3), np.float32),
    )


def shown(rendered: Any) -> list[np.ndarray]:
    """Display colours over black of the views of a Rendered."""
    return [display(image, alpha) for image, alpha in zip(rendered.images, rendered.alpha, strict=True)]


def _whole(alpha: np.ndarray) -> np.ndarray:
    return (alpha > 1 - 1e-6).astype(np.float32)


def take(rendered: Any, rows: Sequence[int]) -> Any:
    """The chosen views of a Rendered."""
    picked: Mapping[str, np.ndarray] = {name: value[list(rows)] for name, value in vars(rendered).items()}
    return replace(rendered, **picked)
