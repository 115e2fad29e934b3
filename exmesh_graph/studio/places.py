"""The files that a page may name: graphs and lights below the graph's folder, and nothing that leads out of it."""

from __future__ import annotations

import itertools
import os
from pathlib import Path
from typing import Any

from exmesh_graph.errors import ExmeshError
from exmesh_graph.files import writing
from exmesh_graph.studio.listing import graph_file_facts


class Outside(ExmeshError):
    """A path that leads out of the graph's folder, or to no graph file there."""

    code = "unknown"


class Conflict(ExmeshError):
    """A request that does not fit the state of the server or of the disk."""

    code = "conflict"


class Places:
    """`folder` is the graph's; a run may also be gone on with from graphs in `others`."""

    def __init__(self, folder: Path, *others: Path) -> None:
        self.folder, self.others = folder, others

    def graph_file(self, name: str, *, new: bool = False) -> Path:
        """A graph file in the folder, or with `new` the place for one. Raises Outside."""
        given = str(name)
        path = self.folder / given
        if not given or "\0" in given or len(given) > 500 or path.suffix not in (".yaml", ".yml"):
            raise Outside(f"{given!r} names no graph file", expected="a .yaml file in the graph's folder")
        real = Path(os.path.realpath(path))
        if not real.is_relative_to(os.path.realpath(self.folder)):
            raise Outside(f"{given!r} lies outside of the graph's folder", expected=f"a file in {self.folder}")
        if new:
            if not real.parent.is_dir():
                raise Outside(f"there is no folder for {given!r}", expected=f"a file in {self.folder}")
        elif not real.is_file():
            raise Outside(f"there is no graph file {given!r}", expected="GET /api/graphs lists them")
        return path

    def graphs(self) -> list[dict[str, Any]]:
        """The graph files of the folder and of folders in it."""
        found = []
        for path in sorted(itertools.islice(self.folder.glob("**/*.yaml"), 2000)):
            parts = path.relative_to(self.folder).parts
            if len(parts) <= 3 and not any(part.startswith(".") for part in parts) and self.holds(path):
                told = graph_file_facts(path)
                if told is not None:
                    found.append({"file": str(Path(*parts)), **told})
        return found[:500]

    def lights(self) -> list[str]:
        """Pictures of light in the graph's folder."""
        found = itertools.islice((p for p in self.folder.glob("**/*") if p.suffix in (".exr", ".hdr")), 200)
        return sorted(str(path.relative_to(self.folder)) for path in found if self._inside(path))

    def light(self, name: str) -> Any:
        """The light in a file of the graph's folder, canonical lat-long. Raises Outside, DataError."""
        from exmesh_graph.io.envmaps import read_environment

        path = self.folder / name
        if "\0" in name or path.suffix not in (".exr", ".hdr") or not path.is_file() or not self._inside(path):
            raise Outside(f"there is no light {name[:80]!r}", expected="GET /api/lights lists them")
        return read_environment(path)

    def _inside(self, path: Path) -> bool:
        return Path(os.path.realpath(path)).is_relative_to(os.path.realpath(self.folder))

    def holds(self, file: Path) -> bool:
        """Whether a graph file is in the graph's folder, or one that the page wrote into the store."""
        real = Path(os.path.realpath(file))
        homes = (self.folder, *self.others)
        return real.is_file() and any(real.is_relative_to(os.path.realpath(home)) for home in homes)


def write_text(path: Path, text: str) -> None:
    """Replace a file in one step; its mode is kept, and where it is a link, what that leads to is replaced."""
    real = Path(os.path.realpath(path))
    draft = real.with_name(f".{real.name}.{os.getpid()}.draft")
    with writing("the graph file", real, "another name"):
        draft.write_text(text, encoding="utf-8")
        if real.exists():
            os.chmod(draft, real.stat().st_mode & 0o7777)
        os.replace(draft, real)
