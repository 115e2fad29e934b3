"""exmesh-graph: multi-view photographs to relightable UV-PBR mesh assets, as a cached graph of typed nodes.

    import exmesh_graph as ex

    run = ex.run("graphs/quickstart.yaml", scene="my_scene", faces=20_000)
    run["settle"].state, run.metrics, run.asset, run.folder

What this page names is imported when it is first used, so that `import exmesh_graph` costs nothing.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from exmesh_graph import api
from exmesh_graph.version import __version__

if TYPE_CHECKING:
    from exmesh_graph.api import *  # noqa: F403

__all__ = ["__version__"]
__all__ += api.__all__


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(api, name)
    _show_in_notebooks()
    return value


def __dir__() -> list[str]:
    return __all__


def _show_in_notebooks() -> None:
    """Graphs, runs and wire types show themselves where IPython runs."""
    if "IPython" in sys.modules:
        from exmesh_graph.notebook import register

        register()


_show_in_notebooks()
