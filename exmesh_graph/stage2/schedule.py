"""What moves in which steps of a fit, and by how much."""

from __future__ import annotations

from exmesh_graph.stage2.settings import DecompositionSettings

#: The roughness that glossy steps begin from at most; for how long the light waits when roughness begins again, as a
#: share of the steps: a texel that starts rough would blur it before it has come down itself.
GLOSSY, GLOSSY_WAIT = 0.2, 0.1


def learning_rates(settings: DecompositionSettings) -> list[float]:
    """First learning rates of maps, environment and common factor.

    Every texel moves by the sign of a noisy gradient, so that high rates wander the farther the longer they last: as
    the square root of the number of steps. The factor has one valley to follow, however many steps there are.
    """
    share = min(1.0, settings.rates_for / settings.iterations) if settings.rates_for else 1.0
    return [settings.material_rate * share**0.5, settings.environment_rate * share**0.5, settings.factor_rate * share]


def lit_first(settings: DecompositionSettings) -> int:
    """How many of the first steps move the light alone.

    Maps and light that start together share what sets one wall apart from another, and where each wall has one normal
    no photograph corrects them: under a low sun a plaster of one colour ends as one colour a wall.
    """
    return 0 if settings.keep_light else round(settings.light_first * settings.iterations)


def glossy_first(settings: DecompositionSettings) -> int:
    """How many of the first steps begin from a low roughness.

    Roughness and light are found together, and a rough surface asks for a blurred light, under which nothing gains by
    being smoother. Metal has its colour by what it mirrors alone: a light that it found while smooth is sharp.
    """
    if settings.keep_light or not settings.metallic:
        return 0
    return round(settings.glossy_first * settings.iterations)


def light_waits(settings: DecompositionSettings, step: int) -> bool:
    """Whether the light waits in this step for roughness that has begun again."""
    since = glossy_first(settings)
    return 0 < since <= step < since + round(GLOSSY_WAIT * settings.iterations)
