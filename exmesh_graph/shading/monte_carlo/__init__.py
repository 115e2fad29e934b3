"""Monte Carlo light of a frozen mesh: the paper's estimators of direct and one-bounce light (eq. 12 to 20)."""

from exmesh_graph.shading.monte_carlo.bounce import SecondaryHits
from exmesh_graph.shading.monte_carlo.estimator import (
    Drawn,
    MonteCarloLight,
    SampleCache,
)
from exmesh_graph.shading.monte_carlo.points import Coarse, Material, MeshSurface, Points, Query, Surface, coarse_points
from exmesh_graph.shading.monte_carlo.samples import LightPool, LightSamples, Sampler, draw_light, make_pool
from exmesh_graph.shading.monte_carlo.shade import shade, shade_reference

__all__ = [
    "Coarse",
    "Drawn",
    "LightPool",
    "LightSamples",
    "Material",
    "MeshSurface",
    "MonteCarloLight",
    "Points",
    "Query",
    "SampleCache",
    "Sampler",
    "SecondaryHits",
    "Surface",
    "coarse_points",
    "draw_light",
    "make_pool",
    "shade",
    "shade_reference",
]
