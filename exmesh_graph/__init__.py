"""exmesh-graph: multi-view photographs to relightable UV-PBR mesh assets, as a cached graph of typed nodes."""

from exmesh_graph.version import __version__

__all__ = ["__version__"]
