"""Parameters declared once: type, default, range, unit and meaning, for nodes and for the solvers that they call."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

LIMITS = frozenset(
    ("ge", "gt", "le", "lt", "multiple_of", "min_length", "max_length", "pattern", "allow_inf_nan", "strict")
)


class Params(BaseModel):
    """Base of every node's parameters: frozen, unknown names refused, defaults validated."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _no_truth_for_a_number(cls, value: Any, info: ValidationInfo) -> Any:
        """pydantic would take true for 1."""
        if isinstance(value, bool) and cls.model_fields[str(info.field_name)].annotation in (int, float):
            raise PydanticCustomError("number", "Input should be a number, not true or false")
        return value

    def replaced(self, **changes: Any) -> Self:
        """A validated copy with some parameters changed. Raises pydantic's ValidationError as the constructor does."""
        return type(self)(**{**dict(self), **changes})


def param(
    default: Any = ...,
    *,
    doc: str,
    unit: str = "",
    tuning: bool = False,
    was: str | tuple[str, ...] = (),
    **limits: Any,
) -> Any:
    """A parameter with its meaning, unit and range (one of `LIMITS`); choices are a type: `Literal["add", "scale"]`.

    `tuning=True` marks a knob that cannot change the result (threads, chunk sizes): it stays out of the key.
    `was` are names that the parameter had before: graph files may use them for one release.
    Raises TypeError for a limit that is not known, which pydantic would drop in silence.
    """
    if unknown := sorted(set(limits) - LIMITS):
        raise TypeError(
            f"param() knows no {', '.join(unknown)}; limits are {', '.join(sorted(LIMITS))}; choices: Literal[...]"
        )
    extra: Any = {"unit": unit, "tuning": tuning}
    if was:
        extra["was"] = [was] if isinstance(was, str) else list(was)
    return Field(default, description=doc, json_schema_extra=extra, **limits)


@dataclass(frozen=True)
class Auto:
    """Lets a parameter also be the word `auto`: the artifact at the optional port `port` then decides it.

        bounces: Annotated[int, Field(ge=0, le=16), Auto("needs")] = param(1, doc="...")

    Limits stand before it, inside `Annotated`. `auto` with nothing wired to the port is an error of the graph. In a
    component it is a port of the node that the component plugs into.
    """

    port: str
    word: ClassVar[str] = "auto"
    code: ClassVar[str] = "auto"
    why: ClassVar[str] = "decides it"
    cure: ClassVar[str] = "give {} a value"

    @classmethod
    def wants(cls, value: Any) -> bool:
        """Whether this value needs the port."""
        return bool(value == cls.word)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        def validate(value: Any, inner: Callable[[Any], Any]) -> Any:
            return value if value == self.word else inner(value)

        return core_schema.no_info_wrap_validator_function(
            validate, handler(source), serialization=core_schema.plain_serializer_function_ser_schema(lambda v: v)
        )

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        return {"anyOf": [handler(schema["schema"]), {"const": self.word}]}


@dataclass(frozen=True)
class Takes:
    """Says that a parameter works with what is wired to the optional port `port`; its false value does without.

        key_light: Annotated[bool, Auto("needs"), Takes("transport")] = param(False, doc="...")

    Another value, `auto` among them, with nothing wired to the port is an error of the graph.
    """

    port: str
    code: ClassVar[str] = "link"
    why: ClassVar[str] = "it takes"
    cure: ClassVar[str] = "say {}: false"

    @classmethod
    def wants(cls, value: Any) -> bool:
        """Whether this value needs the port."""
        return bool(value)
