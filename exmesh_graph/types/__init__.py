"""The nominal types that travel on wires. Importing this package imports neither numpy nor torch."""

from exmesh_graph.types.artifact import ArrayArtifact, Artifact, load_arrays, save_arrays
from exmesh_graph.types.asset import Asset, EnvMap
from exmesh_graph.types.gaussians import PlanarGaussians, PointCloud
from exmesh_graph.types.mesh import Carrier, Mesh, Stage1State
from exmesh_graph.types.needs import Decision, SceneNeeds, decided, with_decisions
from exmesh_graph.types.results import Files, Gallery, GltfAsset, Metrics, ObjAsset, ScoredViews, UsdAsset
from exmesh_graph.types.transport import Transport
from exmesh_graph.types.views import DepthMaps, Frame, LitViews, Region, SceneTruth, Views

__all__ = [
    "ArrayArtifact",
    "Artifact",
    "Asset",
    "Carrier",
    "Decision",
    "DepthMaps",
    "EnvMap",
    "Files",
    "Frame",
    "Gallery",
    "GltfAsset",
    "LitViews",
    "Mesh",
    "Metrics",
    "ObjAsset",
    "PlanarGaussians",
    "PointCloud",
    "Region",
    "SceneNeeds",
    "SceneTruth",
    "ScoredViews",
    "Stage1State",
    "Transport",
    "UsdAsset",
    "Views",
    "decided",
    "load_arrays",
    "save_arrays",
    "with_decisions",
]
