"""Judging one node of an expanded graph: its entries, parameters, libraries and source files."""

from __future__ import annotations

import math
import os.path
from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import groupby
from pathlib import Path, PurePath
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin

from exmesh_graph.errors import ExmeshError, MissingLibraryError
from exmesh_graph.graph.declare.components import BoundComponent
from exmesh_graph.graph.declare.node import Component
from exmesh_graph.graph.declare.packs import current
from exmesh_graph.graph.declare.ports import RESERVED, Port, link_form, signature
from exmesh_graph.graph.language.links import Broken, Link
from exmesh_graph.graph.language.spec import Value
from exmesh_graph.graph.language.wires import Wiring
from exmesh_graph.graph.language.yamlfile import every, is_whole
from exmesh_graph.graph.problems import Where, closest, nearest
from exmesh_graph.params import Auto, Params, Takes

UNIONS = (Union, UnionType)
LIMITS = ("seconds", "ram_gb", "disk_gb", "retries")


class NodeCheck:
    """A node or component, its entries sorted into wires (`links`) and parameters (`given`), by their present names.

    `whole` is False for one that is still being written: what it lacks is no fault yet.
    """

    def __init__(self, name: str, wiring: Wiring, whole: bool = True) -> None:
        self.spec, self.wiring, self.whole = wiring.graph.nodes[name], wiring, whole
        self.definition, self.kind = wiring.definitions[name], wiring.signatures[name]
        self.links: dict[str, Link] = {}
        self.given: dict[str, Value] = {}
        self.fields = self._in_present_names()
        self.each = self._each()
        if self.kind.component is not None and self.spec.seeded is not None:
            wiring.problems.add("seed", self.spec.seeded.where, f"{name} is a component, which has no seed")
        for key, value in self.fields.items():
            if key in self.kind.inputs:
                self._connect(self.kind.inputs[key], value)
            elif key in self.kind.params.model_fields:
                self.given[key] = value
            elif not value.inherited:
                self._refuse_unknown(key, value)
        for key, port in self.kind.inputs.items():
            if whole and not port.optional and key not in self.fields:
                self.add_problem(
                    "missing-port", self.spec.where, f"the input {key} is not connected", expected=str(port),
                    nearest=wiring.suitable(port, name), fix=f"{key}: {link_form(port)}",
                )  # fmt: skip

    def _in_present_names(self) -> dict[str, Value]:
        """The entries by the names that ports and parameters have now.

        Two values for one of them are a problem, unless one stands closer to the run: in the file that extends
        another, in the settings of a round, on the command line.
        """
        fields: dict[str, tuple[str, Value]] = {}
        for key, value in self.spec.fields.items():
            present = self.kind.renamed.get(key, key)
            name = self.wiring.note(value.where, f"{self.definition.type}:", key, present)
            if name in fields:
                written, other = fields[name]
                ranks = [(v.layer, v.where.file == self.wiring.graph.file) for v in (other, value)]
                if ranks[0] == ranks[1] and other.where.file == value.where.file:
                    self.add_problem("renamed", value.where, f"{name} is given twice, as {written!r} and as {key!r}",
                                     found=f"the other one: {other.where}", fix=f"keep {name!r}")  # fmt: skip
                if ranks[0] > ranks[1]:
                    continue
            fields[name] = key, value
        return {name: value for name, (_, value) in fields.items()}

    def _connect(self, port: Port, value: Value) -> None:
        """Judge what stands at an input port."""
        name, link = self.spec.name, value.value
        items = [one for one in link if one is not None] if isinstance(link, list) else [link]
        if port.many and items and all(isinstance(one, Link | Broken) for one in items):
            for number, one in enumerate(items, 1):
                self._wire(f"{port.name}[{number}]", replace(port, optional=True), one, value.where)
        elif isinstance(link, Link):
            self._wire(port.name, port, link, value.where)
        elif port.many and isinstance(link, list) and not items:
            return
        elif not isinstance(link, Broken) and not (link is None and port.optional):
            shown = "nothing" if link is None else "a list" if isinstance(link, list) else repr(link)
            self.add_problem(
                "link", value.where, f"{port.name} is an input port, not a parameter", found=shown,
                expected=f"a link {link_form(port)} that carries {port}", nearest=self.wiring.suitable(port, name),
            )  # fmt: skip

    def _wire(self, key: str, port: Port, link: Link | Broken, where: Where) -> None:
        """Judge one wire into an input, or into an element of a list."""
        wire = None
        if isinstance(link, Link):
            wire = self.wiring.connect(link, where, f"{self.spec.name}.{key}", port, self.spec.name)
        if wire is None:
            return
        self.links[key], source = wire
        if source.many and not port.many and key not in self.each:
            self.add_problem("list", where, f"{link} is a list, but {key} takes one", expected=str(port),
                             found=str(source), fix=f"each: {key} makes a node for each element")  # fmt: skip
        elif key in self.each and not source.many:
            self.add_problem("list", where, f"each: {key}, but {link} is no list", found=str(source))

    def _each(self) -> tuple[str, ...]:
        """The inputs that `each` names: lists, of which every element makes a node of its own."""
        given = self.spec.each
        if given is None:
            return ()
        names = given.value if isinstance(given.value, list) else [given.value]
        known = [name for name, port in self.kind.inputs.items() if not (port.many or port.plugged)]
        for name in names:
            if name not in known:
                self.add_problem("list", given.where, f"each names inputs that take one value, not {name!r}",
                                 nearest=closest(name, known))  # fmt: skip
        if any(port.many or port.optional for port in self.kind.outputs.values()):
            what = f"{self.definition.type} makes lists, or what may be absent: each makes no lists of these"
            self.add_problem("list", given.where, what)
        return tuple(str(name) for name in names)

    def add_problem(self, code: str, where: Where, what: str, **more: Any) -> None:
        """Note a fault of this node."""
        self.wiring.problems.add(code, where, f"{self.spec.name}: {what}", **more)

    def params(self, nested: Mapping[str, Component]) -> Params | None:
        """The validated parameters, paths made absolute; `nested` are the components plugged into a component."""
        from pydantic import ValidationError

        raw: dict[str, Any] = dict(nested)
        failed = False
        for key, value in self.given.items():
            if any(isinstance(item, Link | Broken) for item in every(value.value)):
                self.add_problem("link", value.where, f"{key} is a parameter, not an input port")
                failed = True
            raw[key] = value.value
        if failed:
            return None
        try:
            model = self.kind.params.model_validate(raw)
        except ValidationError as error:
            for details in _whole_unions(error.errors(include_url=False), self.kind.params):
                if details["loc"][:1] not in [(port,) for port in self.kind.inputs]:  # told of as a wire
                    self._refuse_value(details)
            return None
        for key, value in model.model_dump().items():
            if any(isinstance(item, float) and not math.isfinite(item) for item in every(value)):
                self._refuse_value({"loc": (key,), "type": "finite", "msg": "infinities and nan are no values"})
                return None
        paths = self.kind.path_fields & set(self.given)
        return model.model_copy(update={key: _absolute(getattr(model, key), self.given[key].base) for key in paths})

    def limits(self) -> dict[str, float]:
        """What the node may take: its own limits over those of the graph."""
        limits: dict[str, float] = {}
        for given in self.spec.limits:
            table = given.value if isinstance(given.value, dict) else {"": given.value}
            for name, most in table.items():
                if name not in LIMITS or not (is_whole(most, 0) if name == "retries" else _is_positive(most)):
                    what = f"limits: {name}: {most!r} is no limit" if name else f"limits: {most!r} are none"
                    shown = "{seconds: 600, ram_gb: 8, disk_gb: 20, retries: 2}, any of them"
                    self.add_problem("limits", given.where, what, nearest=closest(name, LIMITS), expected=shown)
                else:
                    limits[str(name)] = most
        return limits

    def check_libraries(self) -> None:
        """Note the libraries that are not there."""
        for library in self.definition.libraries:
            try:
                current().library_version(library)
            except MissingLibraryError as error:
                what = f"{self.definition.type} needs the library {library}"
                self.add_problem("missing-library", self.spec.where, what, fix=error.fix)

    def check_decided(self, own: Params, plugs: Iterable[BoundComponent]) -> None:
        """What decides parameters of a node and its components that are `auto`, and what parameters work with, must be
        wired to the node."""
        spec, problems = self.spec, self.wiring.problems
        asked = [(spec.name, self.kind, own, spec.where)]
        asked += [(c.name, signature(c.definition), c.value, c.where) for plug in plugs for c in plug.all()]
        marked = [(*of, mark, *it) for of in asked for mark in (Auto, Takes) for it in of[1].noted(mark).items()]
        for owner, _, model, where, mark, name, port in marked:
            value = getattr(model, name)
            if not mark.wants(value) or (port in self.fields and self.fields[port].value is not None):
                continue
            judge, end = self.kind.inputs.get(port), port if owner == spec.name else f"{spec.name}.{port}"
            problems.add(
                mark.code, self.given[name].where if owner == spec.name and name in self.given else where,
                f"{owner}: {name} is {str(value).lower()}, but nothing is wired to {end}, which {mark.why}",
                expected=str(judge or f"{self.definition.type} has no port {port}"),
                nearest=() if judge is None else self.wiring.suitable(judge, spec.name),
                fix=f'{f"{end}: {link_form(judge)}, or " if judge else ""}{mark.cure.format(name)}',
            )  # fmt: skip

    def sources(self, model: Params) -> Mapping[str, Path]:
        """The files that the node reads, by name."""
        if self.definition.sources is None:
            return {}
        paths = self.kind.path_fields & set(self.given)
        where = self.given[min(paths)].where if paths else self.spec.where
        try:
            files = {str(name): Path(path) for name, path in self.definition.sources(model).items()}
        except ExmeshError as error:
            self.add_problem("source", where, error.what, found=error.where, expected=error.expected, fix=error.fix)
            return {}
        except Exception as error:  # an unreadable folder, or data that the listing was not made for
            what = f"its source files cannot be listed: {type(error).__name__}: {error}"
            self.add_problem("source", where, what, fix="mend the data; if it is right, this is a fault of the node")
            return {}
        for name, path in files.items():
            if PurePath(name).is_absolute():
                what = f"{self.definition.type}: the source name {name!r} is an absolute path; keys must not hold any"
                self.wiring.problems.add("declaration", self.spec.where, what)
            elif not path.is_file():
                self.add_problem("source", where, f"no such file: {path}")
        return files

    def _refuse_unknown(self, key: str, value: Value) -> None:
        link = isinstance(value.value, Link | Broken)
        own = (self.kind.inputs, self.kind.params.model_fields)
        first, second = own if link else own[::-1]
        reserved = f"; {key!r} is a word of the framework" if key in RESERVED else ""
        self.add_problem(
            "unknown-port" if link else "unknown-parameter", value.where,
            f"{self.definition.type} has no {'input port' if link else 'parameter'} {key!r}{reserved}",
            nearest=nearest(key, [*first, *second]) or list(first), fix=f"exmesh nodes {self.definition.type}",
        )  # fmt: skip

    def _refuse_value(self, error: Mapping[str, Any]) -> None:
        """`error` is one of pydantic's."""
        path = [str(part) for part in error["loc"]]
        key, missing = path[0] if path else "", error["type"] == "missing"
        if missing and not self.whole:
            return
        or_auto = f", or {Auto.word}" * (key in self.kind.decided_by())
        told = f"{'.'.join(path) or self.definition.type}: {error['msg']}{or_auto}"
        what = f"the parameter {key} must be given" if missing else told
        expected, given = "", self.given.get(key)
        if key in self.kind.params.model_fields:
            unit = self.kind.extra(key).get("unit")
            doc = self.kind.params.model_fields[key].description or ""
            expected = f"{doc} [{unit}]".strip() if unit else doc
        where, shown = (self.spec.where, "") if given is None else (given.where, repr(given.value))
        self.add_problem("parameter", where, what, expected=expected, found=shown)


def _whole_unions(errors: Iterable[Mapping[str, Any]], params: type[Params]) -> Iterable[Mapping[str, Any]]:
    """pydantic's errors, those of one parameter that may be of several types as one: it has one for each type."""
    for loc, group in groupby(errors, lambda error: tuple(error["loc"][:1])):
        told, field = list(group), params.model_fields.get("".join(map(str, loc)))
        kinds = {*get_args(field.annotation)} - {NoneType} if field and get_origin(field.annotation) in UNIONS else ()
        if len(kinds) > 1:
            others = [error["msg"].removeprefix("Input should be ") for error in told[1:]]
            told = [{**told[0], "loc": loc, "msg": ", or ".join([told[0]["msg"], *others])}]
        yield from told


def _is_positive(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < math.inf


def _absolute(value: Any, base: Path) -> Any:
    if isinstance(value, PurePath):
        path = Path(value).expanduser()
        return path if path.is_absolute() else Path(normal_path(base / path))
    if isinstance(value, list | tuple):
        return type(value)(_absolute(item, base) for item in value)
    if isinstance(value, dict):
        return {key: _absolute(item, base) for key, item in value.items()}
    return value


def normal_path(path: Path) -> str:
    """An absolute path without `..`, but with symbolic links left as the user wrote them where that is possible."""
    return os.path.normpath(path) if not any(p.is_symlink() for p in path.parents) else str(path)
