"""Settings of the light of a frozen mesh: transport that is traced once, and Monte Carlo light."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from exmesh_graph.params import Auto, Params, param


class TransportSettings(Params):
    """How densely light transport is traced (shading.transport)."""

    directions: int = param(128, ge=16, le=8192, doc="Equal-area directions traced from every surface point.")
    points: int = param(
        12_000, ge=1, le=2_000_000, doc="Least number of surface points, spread over the mesh by the size of its faces."
    )


class BounceSettings(Params):
    """How much interreflection is modelled (shading.transport)."""

    bounces: Annotated[int, Field(ge=0, le=16), Auto("needs")] = param(
        1, doc="Diffuse interreflections to add; the paper has 1. 0 hands the direct light on."
    )
    deeper: bool = param(
        False,
        doc="Bounces beyond these count too: in a fit as they were a step before, which costs no more; the paper has "
        "none.",
    )
    secondary_material: bool = param(
        True, doc="Light from the mesh carries the maps of where it comes from; else the receiver's own (an ablation)."
    )


class MonteCarloSettings(Params):
    """Sample counts and choices of the Monte Carlo light (shading.monte_carlo); the defaults are the paper's."""

    technique: Annotated[Literal["environment", "brdf", "mis", "cosine"], Auto("needs")] = param(
        "environment", doc="Where direct samples go; mis = half to the environment, half to the lobes."
    )
    samples: int = param(8, ge=2, le=4096, unit="rays", doc="N_d, direct samples per pixel.")
    bounces: Literal[0, 1] = param(1, doc="0: direct light only; 1: one diffuse bounce.")
    secondary_rays: int = param(16, ge=1, le=4096, unit="rays", doc="N_b, rays per pixel that look for the mesh.")
    secondary_samples: int = param(4, ge=1, le=4096, unit="rays", doc="N_s, light samples at each secondary hit.")
    half_resolution: bool = param(True, doc="Secondary rays for one pixel of each 2 x 2 block, then upsampled.")
    secondary_material: bool = param(
        True, doc="Secondary hits read the maps; else the primary point's material stands in (an ablation)."
    )
    secondary_lobes: bool = param(
        False, doc="Hits also send what their lobes reflect, as precomputed light has it; the paper's do not."
    )
    kept: int = param(
        0, ge=0, le=64, unit="estimates", doc="Estimates per view whose rays are kept between corrections; 0: none."
    )
    independent_gradient: bool = param(
        True,
        doc="Draw the gradient's samples by a seed of their own, or from the next kept ones: a fit with less bias.",
    )
