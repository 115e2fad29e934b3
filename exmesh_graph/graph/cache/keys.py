"""Keys of actions and records of them. A key: sha256 over the canonical JSON of everything that can change a result.

    {epoch, type, version, code, params, seed, libraries, sources: {name: digest}, inputs: {port: [type, digest]},
     components: {port: {type, version, code, params, libraries, components}}, where any are plugged in}

Tuning parameters and paths stay out; the contents of the files behind the paths are in, and where several could
be meant, under which name among the sources the file of a path parameter is. Port names are bound to
digests, so that swapped inputs give another key. The input digests are those of recorded outputs, so that equal
outputs of an upstream change stop the cascade. Golden-key tests pin the format; raise EPOCH when it changes.
"""

from __future__ import annotations

import enum
import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

from exmesh_graph.errors import GraphError
from exmesh_graph.files import sha256_file
from exmesh_graph.graph import sealed
from exmesh_graph.graph.cache.fingerprint import fingerprint
from exmesh_graph.graph.declare.components import BoundComponent
from exmesh_graph.graph.declare.node import NodeDef
from exmesh_graph.graph.declare.packs import current
from exmesh_graph.graph.declare.ports import artifact_types, base_name, signature
from exmesh_graph.graph.language.check import Bound

EPOCH = 1
ABSENT = ("none", "none")


def canonical(value: Any) -> str:
    """Canonical JSON: sorted keys, no blanks, floats as hexadecimal; other types are refused."""
    return json.dumps(_plain(value), sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)


def digest_of(value: Any) -> str:
    """sha256 of the canonical JSON."""
    return hashlib.sha256(canonical(value).encode("ascii")).hexdigest()


def key_of(preimage: Mapping[str, Any]) -> str:
    """The key that belongs to a pre-image, fresh or read back from a record."""
    text = json.dumps(preimage, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return hashlib.sha256(b"exmesh.action\n" + text.encode("ascii")).hexdigest()


def preimage_of(
    bound: Bound, code: str, sources: Mapping[str, str], inputs: Mapping[str, Sequence[str]]
) -> dict[str, Any]:
    """The pre-image of a node's key. `inputs` maps connected ports to (type name, artifact digest)."""
    leave_out = bound.signature.path_fields | bound.signature.tuning_fields()
    params = bound.params.model_dump(mode="python")
    kept = {name: value for name, value in params.items() if name not in leave_out}
    beside = {name: _without_paths(params[name], bound) for name in sorted(bound.signature.path_fields)}
    if bound.sources and list(beside.values()) == [_files(bound.sources)]:
        beside = {}  # the only path is all the files: nothing to mix up
    kept.update({name: value for name, value in beside.items() if value is not None})
    return {
        "epoch": EPOCH,
        "type": bound.definition.type,
        "version": bound.definition.version,
        "code": code,
        "params": _plain(kept),
        "seed": bound.seed,
        "libraries": _versions(bound.definition),
        "sources": dict(sorted(sources.items())),
        "inputs": {port: list(pair) for port, pair in sorted(inputs.items())},
        **({"components": _components(bound.components)} if bound.components else {}),
        **({"kinds": kinds} if (kinds := kinds_of(bound, inputs)) else {}),
    }


def kinds_of(bound: Bound, inputs: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """The code of wire types that a port takes as its base: what their methods do is in no module of the node."""
    known, found = artifact_types(), {}
    for port, (name, _) in inputs.items():
        asked = bound.signature.inputs.get(base_name(port))
        declared = getattr(asked.type, "__args__", (asked.type,)) if asked else ()
        if asked and name in known and known[name] not in declared:
            found[name] = fingerprint(NodeDef(name, known[name], "")).digest
    return dict(sorted(found.items()))


def _components(plugs: Mapping[str, BoundComponent]) -> dict[str, Any]:
    """Everything about components that can change a result, by port."""
    table = {}
    for port, plug in sorted(plugs.items()):
        definition, tuning = plug.definition, signature(plug.definition).tuning_fields()
        table[port] = {
            "type": definition.type,
            "version": definition.version,
            "code": fingerprint(definition).digest,
            "params": _plain({name: value for name, value in plug.params("python").items() if name not in tuning}),
            "libraries": _versions(definition),
            "components": _components(plug.nested),
        }
    return table


def _versions(definition: NodeDef) -> dict[str, str]:
    return {name: current().library_version(name) for name in sorted(definition.libraries)}


def _without_paths(value: Any, bound: Bound) -> Any:
    """What a path parameter holds, with names among the source files in place of paths, which differ by machine."""
    if isinstance(value, PurePath):
        own = value, Path(value).resolve()
        found = [n for n, path in bound.sources.items() if path in own or not set(own).isdisjoint(path.parents)]
        unlisted = not found and own[1].is_file()  # two of one name, say, of which `sources` lists the last
        return {"contents": sha256_file(own[1])} if unlisted else _files(found)
    if isinstance(value, list | tuple):
        return [_without_paths(item, bound) for item in value] or None
    if isinstance(value, Mapping):
        return {key: _without_paths(item, bound) for key, item in value.items()} or None
    return value


def _files(names: Iterable[str]) -> dict[str, str]:
    """Names of source files, short."""
    found = sorted(names)
    return {"file": found[0]} if len(found) == 1 else {"files": digest_of(found)}


def _plain(value: Any) -> Any:
    if isinstance(value, enum.Enum):
        return _plain(value.value)
    if value is None or isinstance(value, bool | str | int):
        return value
    if isinstance(value, float):
        return {"~float": value.hex()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {("~" + key if key.startswith("~") else key): _plain(item) for key, item in value.items()}
    raise GraphError(
        f"a {type(value).__name__} cannot be part of a key",
        expected="null, bool, int, float, str, lists and mappings of them",
    )


FORMAT = 1
_DIGEST = re.compile(r"[0-9a-f]{64}\Z")


@dataclass(frozen=True)
class Stored:
    """An artifact in the store; (`none`, `none`, 0) stands for an optional output that stayed empty.

    (`list`, `none`, n) stands for a list of n artifacts, which stand beside it as `port[1]`, ... `port[n]`.
    """

    type: str
    digest: str
    bytes: int


NOTHING = Stored(*ABSENT, 0)
LIST = "list"


def listed(count: int) -> Stored:
    """What stands for a list."""
    return Stored(LIST, ABSENT[1], count)


def elements(outputs: Mapping[str, Stored], port: str) -> list[str]:
    """The names of what is in an output: those of its elements where it is a list, else its own."""
    stored = outputs[port]
    return [f"{port}[{n}]" for n in range(1, stored.bytes + 1)] if stored.type == LIST else [port]


@dataclass(frozen=True)
class Action:
    """A record read back and found sound."""

    key: str
    preimage: Mapping[str, Any]
    outputs: Mapping[str, Stored]
    info: Mapping[str, Any]

    @property
    def digests(self) -> tuple[str, ...]:
        """The objects of its outputs, each once."""
        return tuple(dict.fromkeys(stored.digest for stored in self.outputs.values() if stored.digest != ABSENT[1]))


def sound_action(key: str, text: str) -> Action | None:
    """The action in the text of a record, None when it is not sound."""
    try:
        return action_of(key, sealed.unseal(text))
    except (ValueError, KeyError, TypeError, AttributeError):
        return None


def action_of(key: str, record: dict[str, Any]) -> Action:
    """The action in an unsealed record. Raises ValueError, KeyError or TypeError when it is not that of `key`."""
    outputs = {port: Stored(**entry) for port, entry in record.pop("outputs").items()}
    preimage = record.pop("preimage")
    if not all(_DIGEST.match(stored.digest) or stored.digest == ABSENT[1] for stored in outputs.values()):
        raise ValueError("a digest is none")  # and could name any folder
    if record.pop("key") != key or key_of(preimage) != key or record.pop("format") != FORMAT:
        raise ValueError("the key does not belong to the pre-image")
    return Action(key, preimage, outputs, record)


def artifact_digest(type_name: str, table: Mapping[str, Any]) -> str:
    """sha256 over type name and sorted (file name, size, sha256 of its bytes)."""
    rows = [[name, size, digest] for name, (size, digest) in sorted(table.items())]
    return digest_of(["exmesh.artifact", type_name, rows])
