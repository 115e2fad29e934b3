"""What a scene was measured to need, for nodes whose parameters say `auto`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeVar

from exmesh_graph.errors import DataError
from exmesh_graph.types.artifact import Artifact

if TYPE_CHECKING:
    from exmesh_graph.params import Params

AUTO = "auto"

P = TypeVar("P", bound="Params")


@dataclass(frozen=True)
class Decision:
    """One choice and what it rests on.

    value      what `auto` becomes: a number, flag or word
    gain       expected gain in error in dB of switching it on (negative: it harms), None where none was measured
    error      standard error of `gain`, dB
    cost       work of a fit step with it over without it, counted, not timed: equal on every machine
    evidence   named figures behind it
    reason     one sentence
    """

    value: bool | int | float | str
    gain: float | None
    error: float | None
    cost: float
    reason: str
    evidence: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class SceneNeeds(Artifact):
    """The decisions of `scene.probe` by parameter (bounces, metallic, ...), and measures of the mesh.

    Times are not among them: equal scenes give equal bytes.
    """

    type_name: ClassVar[str] = "SceneNeeds"
    decisions: Mapping[str, Decision]
    geometry: Mapping[str, float] = field(default_factory=dict)

    def chosen(self, name: str) -> Any:
        """What `auto` stands for in the parameter `name`. Raises DataError where the probe did not look at it."""
        if name not in self.decisions:
            raise DataError(
                f"the probe decided nothing about {name}",
                expected=f"one of {', '.join(sorted(self.decisions))}",
                fix=f"give {name} a value",
            )
        return self.decisions[name].value

    def save(self, folder: Path) -> None:
        values = {"decisions": {k: asdict(v) for k, v in self.decisions.items()}, "geometry": dict(self.geometry)}
        text = json.dumps(values, sort_keys=True, indent=1, allow_nan=False)
        (folder / "needs.json").write_text(text + "\n", encoding="utf-8")

    @classmethod
    def load(cls, folder: Path) -> Self:
        values = json.loads((folder / "needs.json").read_text(encoding="utf-8"))
        return cls({k: Decision(**v) for k, v in values["decisions"].items()}, values["geometry"])


def decided(value: Any, needs: SceneNeeds | None, name: str) -> Any:
    """`value`, or what `needs` chose for the parameter `name` where it is `auto`.

    Raises DataError for `auto` without `needs`.
    """
    if not isinstance(value, str) or value != AUTO:
        return value
    if needs is None:
        raise DataError(
            f"{name} is auto, but nothing that decides it is wired to `needs`",
            expected="the `needs` output of scene.probe",
            fix=f'needs: "@probe.needs", or give {name} a value',
        )
    return needs.chosen(name)


def with_decisions(params: P, needs: SceneNeeds | None) -> P:
    """`params` with what `needs` chose for those that are `auto` (params.Auto); validated. Raises as `decided`."""
    from exmesh_graph.params import Auto

    fields = type(params).model_fields.items()  # not in the key: which may be `auto`
    names = [name for name, info in fields if any(isinstance(note, Auto) for note in info.metadata)]
    return params.replaced(**{name: decided(getattr(params, name), needs, name) for name in names})
