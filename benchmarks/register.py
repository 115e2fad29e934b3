"""The register of scenes (benchmarks/scenes.yaml): each is for choosing settings or for scoring them, never for both.

    from benchmarks.register import choosing
    choosing(folder)            # before a sweep of settings: an error where the scene is for scoring, or unknown

`python -m benchmarks.register` prints the register; a name or a folder prints that scene's entry.
"""

from __future__ import annotations

import json
import sys
from functools import cache
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

FILE = Path(__file__).parent / "scenes.yaml"
Role = Literal["choose", "score"]


class WrongRoleError(ValueError):
    """Settings were to be chosen on a scene that is kept for scoring them."""


class Digests(BaseModel):
    """What a made scene is recognised by. sha256 of files, and what other processors' last bits leave alone."""

    model_config = ConfigDict(extra="forbid")
    files: dict[str, str] = Field(default_factory=dict, description="path in the scene's folder: sha256")
    faces: int = Field(0, description="faces of the true mesh")
    area: float = Field(0, description="area of the true mesh, scene units squared")
    first: str = Field("", description="mean colours of 8 x 8 parts of the first test picture, hexadecimal")


class Scene(BaseModel):
    """One scene."""

    model_config = ConfigDict(extra="forbid")
    name: str
    role: Role
    kind: str
    made: str = Field(description="the command, or where it comes from")
    licence: str
    masks: bool = Field(True, description="whether the pictures have masks")
    layout: Literal["blender", "idr", "middlebury", "photos"] = "blender"
    where: str = Field("", description="folder in the repository, where it is part of it")
    aliases: tuple[str, ...] = Field((), description="other names of the same object")
    pixels: tuple[int, int] = Field(description="width and height of the pictures")
    views: tuple[int, int] = Field(description="training views, test views")
    digests: Digests = Digests()

    @field_validator("name")
    @classmethod
    def _plain(cls, name: str) -> str:
        if not name.replace("_", "").isalnum():
            raise ValueError(f"a scene's name is letters, digits and _, not {name!r}")
        return name


@cache
def scenes(file: Path = FILE) -> dict[str, Scene]:
    """All scenes by name. Raises ValueError naming the file where an entry is wrong or a name has two roles."""
    from ruamel.yaml import YAML

    content = YAML(typ="safe").load(file.read_text(encoding="utf-8"))
    found: dict[str, Scene] = {}
    for number, entry in enumerate(content["scenes"]):
        try:
            scene = Scene.model_validate(entry)
        except ValueError as error:
            raise ValueError(f"{file}, entry {number + 1}: {error}") from error
        for name in (scene.name, *scene.aliases):
            if name in found:
                raise ValueError(f"{file}: {name!r} is entered twice ({found[name].role} and {scene.role})")
            found[name] = scene
    return found


def of_role(role: Role) -> list[Scene]:
    """The scenes of the role, each once, in the order of the file."""
    return [scene for name, scene in scenes().items() if name == scene.name and scene.role == role]


def find(scene: str | Path) -> Scene | None:
    """The entry of a name, or of a folder: by made.json in it, by its place in the repository, else by its own name."""
    known, folder = scenes(), Path(scene)
    made = folder / "made.json"
    if made.is_file():
        return known.get(json.loads(made.read_text(encoding="utf-8"))["scene"])
    for entry in known.values():
        if entry.where and folder.resolve() == (FILE.parent.parent / entry.where).resolve():
            return entry
    return known.get(folder.resolve().name if folder.exists() else str(scene))


def choosing(scene: str | Path) -> Scene | None:
    """The entry of a scene that settings may be chosen on. Raises WrongRoleError for one that is kept for scoring.

    A scene that is not in the register passes with None: nothing has been scored on it. Enter it
    before it is scored."""
    entry = find(scene)
    if entry is not None and entry.role == "score":
        others = ", ".join(other.name for other in of_role("choose"))
        raise WrongRoleError(
            f"{entry.name!r} ({scene}) is kept for scoring: settings chosen on it would make its score worthless. "
            f"Choose on one of {others} (docs/scenes.md says how each is made), then score once with "
            "`exmesh bench --scenes score`. Roles stand in benchmarks/scenes.yaml; a scene that has been used for "
            "choosing must be entered as `choose` for good."
        )
    return entry


def role_of(scene: str | Path) -> str:
    """ "choose", "score" or "unknown", for tables that say where their figures come from."""
    entry = find(scene)
    return entry.role if entry is not None else "unknown"


def main(wanted: list[str]) -> int:
    entries = [find(name) for name in wanted] if wanted else [*of_role("choose"), *of_role("score")]
    for name, entry in zip(wanted or [e.name for e in entries if e], entries, strict=True):
        if entry is None:
            print(f"{name}: not in {FILE}", file=sys.stderr)
            return 1
        size, views = "x".join(map(str, entry.pixels)), "+".join(map(str, entry.views))
        print(f"{entry.name:16s} {entry.role:7s} {size:9s} {views:7s} {entry.kind}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
