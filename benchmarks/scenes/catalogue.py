"""All recipes by name."""

from __future__ import annotations

from benchmarks.scenes.kinds import Recipe
from benchmarks.scenes.objects import (
    attic,
    crowd,
    fair,
    garden,
    harbour,
    metalware,
    mixed,
    panel,
    plain,
    served,
    shelf,
    tables,
    thin,
    toys,
    walls,
)

RECIPES: dict[str, Recipe] = (
    thin.SCENES
    | mixed.SCENES
    | plain.SCENES
    | walls.SCENES
    | tables.SCENES
    | panel.SCENES
    | toys.SCENES
    | crowd.SCENES
    | served.SCENES
    | harbour.SCENES
    | garden.SCENES
    | shelf.SCENES
    | fair.SCENES
    | attic.SCENES
    | metalware.SCENES
)
