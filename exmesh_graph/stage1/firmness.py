"""How firm a surface should be: a round run twice, once firmer, and what the photographs say of the two.

A smooth object that shines is bent by its gloss round by round, and a firmer mesh holds it; one with parts or hollows
that are still to be found needs to give way (docs/stage1_trials.md). What sets the two apart is what firmness costs:
where ten times the smoothness leaves the photographs met as well, softness had nothing to find.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol, TypeVar

State = TypeVar("State", covariant=True)

MARGIN = 0.03
"""Training PSNR [dB] that a firmer surface may cost: 0.01 where it helped, 0.09 and more where it did not."""
_END = 0.2
"""Of the round's curve, at its end: what is compared."""


class Round(Protocol[State]):
    """A round of Stage I that can be run, or brought to the end of an earlier run."""

    def run(self, progress: Any, checkpoint: Any, resumed: Any) -> tuple[State, dict[str, Any]]: ...
    def at(self, kept: Mapping[str, Any]) -> tuple[State, dict[str, Any]]: ...
    def kept(self) -> dict[str, Any]: ...


def firmer_if_as_good(
    make: Callable[[float], Round[State]],
    times: float,
    count: int,
    progress: Callable[..., None] | None,
    checkpoint: Callable[[int, dict[str, Any]], None] | None,
    resumed: tuple[int, Mapping[str, Any]] | None,
) -> tuple[State, dict[str, Any]]:
    """A round of `count` iterations by `make(1)` and by `make(times)`: state and history of the firmer one where its
    training PSNR is at most MARGIN lower, else of the other. What an earlier round found does not count.

    The history says what was decided: "firmness" and "cost" [dB]. Checkpoints count 2 `count` steps; those of the
    second run hold the end of the first.
    """

    def told(before: int) -> Callable[..., None] | None:
        if progress is None:
            return None
        return lambda done, total, **figures: progress(before + done, 2 * count, **figures)

    soft, firm = make(1.0), make(times)
    second = None
    if resumed is not None and "softer" in resumed[1]:
        ended = resumed[1]["softer"]
        second = (resumed[0] - count, {name: value for name, value in resumed[1].items() if name != "softer"})
        found = soft.at(ended)
    else:
        found = soft.run(told(0), checkpoint, resumed)
        ended = soft.kept()

    def keep(step: int, state: dict[str, Any]) -> None:
        assert checkpoint is not None
        checkpoint(count + step, {**state, "softer": ended})

    other = firm.run(told(count), keep if checkpoint else None, second)
    cost = _end(found[1]) - _end(other[1])
    chosen, value = (other, times) if cost <= MARGIN else (found, 1.0)
    return chosen[0], {**chosen[1], "firmness": value, "cost": round(cost, 3)}


def _end(history: Mapping[str, Any]) -> float:
    """PSNR [dB] over the end of a round's curve."""
    curve = history["psnr"]
    last = curve[-max(1, round(_END * len(curve))) :]
    return sum(last) / len(last)
