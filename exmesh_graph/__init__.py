"""exmesh-graph: multi-view photographs to relightable UV-PBR mesh assets, as a cached graph of typed nodes."""

__version__ = "0.1.0"
