"""USD: writing an asset, judging any file, reading it back."""

from exmesh_graph.export.settings import ExportSettings
from exmesh_graph.export.usd.gate import validate_usd
from exmesh_graph.export.usd.read import UsdContents, read_usd, up_axis
from exmesh_graph.export.usd.rules import Problem
from exmesh_graph.export.usd.write import write_usd

__all__ = ["ExportSettings", "Problem", "UsdContents", "read_usd", "up_axis", "validate_usd", "write_usd"]
