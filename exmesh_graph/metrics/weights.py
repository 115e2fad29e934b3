"""Files of network weights that metrics read; importable without the networks' libraries."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from exmesh_graph.errors import MissingLibraryError


def lpips_source(path: Path | None) -> Mapping[str, Path]:
    """LPIPS's file of weights as a node's source, {} for None. MissingLibraryError when it does not exist."""
    if path is None:
        return {}
    if not path.is_file():
        raise MissingLibraryError("the LPIPS weights do not exist", where=str(path),
                                  fix="make the file as docs/metrics.md says, or leave `lpips` out")  # fmt: skip
    return {path.name: path}
