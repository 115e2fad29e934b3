"""Records: what an action was keyed by and where its outputs are; how an artifact is named by its bytes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from exmesh_graph.graph import files
from exmesh_graph.graph.cache.keys import ABSENT, digest_of, key_of

FORMAT = 1
_DIGEST = re.compile(r"[0-9a-f]{64}\Z")


@dataclass(frozen=True)
class Stored:
    """An artifact in the store; (`none`, `none`, 0) stands for an optional output that stayed empty."""

    type: str
    digest: str
    bytes: int


NOTHING = Stored(*ABSENT, 0)


@dataclass(frozen=True)
class Action:
    """A record read back and found sound."""

    key: str
    preimage: Mapping[str, Any]
    outputs: Mapping[str, Stored]
    info: Mapping[str, Any]


def sound_action(key: str, text: str) -> Action | None:
    """The action in the text of a record, None when it is not sound."""
    try:
        return action_of(key, files.unseal(text))
    except (ValueError, KeyError, TypeError, AttributeError):
        return None


def action_of(key: str, record: dict[str, Any]) -> Action:
    """The action in an unsealed record. Raises ValueError, KeyError or TypeError when it is not that of `key`."""
    outputs = {port: Stored(**entry) for port, entry in record.pop("outputs").items()}
    preimage = record.pop("preimage")
    if not all(_DIGEST.match(stored.digest) or stored == NOTHING for stored in outputs.values()):
        raise ValueError("a digest is none")  # and could name any folder
    if record.pop("key") != key or key_of(preimage) != key or record.pop("format") != FORMAT:
        raise ValueError("the key does not belong to the pre-image")
    return Action(key, preimage, outputs, record)


def artifact_digest(type_name: str, table: Mapping[str, Any]) -> str:
    """sha256 over type name and sorted (file name, size, sha256 of its bytes)."""
    rows = [[name, size, digest] for name, (size, digest) in sorted(table.items())]
    return digest_of(["exmesh.artifact", type_name, rows])
