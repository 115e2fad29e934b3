"""Run reports: what a run measured, what it cost and what it looks like (docs/report.md)."""

from exmesh_graph.report.page import build_report

__all__ = ["build_report"]
