"""A run as W3C PROV (https://www.w3.org/TR/prov-dm/): what was made, by what, out of what; text by the library `prov`.

Entities are artifacts and source files by their digests, activities are actions by their keys, so that documents of
several runs that share results fit together. The run itself is an activity with its times, its graph's file its plan,
and this package, with version and commit, the agent. An action that ran in this run was started by it. Names of
folders, which name people and machines, are left out.
"""

from __future__ import annotations

import importlib
import json
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exmesh_graph.api.provenance import public
from exmesh_graph.errors import ExmeshError
from exmesh_graph.files import sha256_file
from exmesh_graph.graph.run.job import DONE
from exmesh_graph.graph.run.rundir import HIT

if TYPE_CHECKING:
    from exmesh_graph.api.results import Run

FORMATS = {".json": "json", ".jsonld": "jsonld", ".provn": "provn"}
_SPACE = "urn:exmesh-graph:"


def prov_text(run: Run, format_: str = "json") -> str:
    """The document as PROV-JSON, PROV-JSONLD or PROV-N (values of FORMATS). Raises ExmeshError without the library.

    Parameters, seeds and source files are told where the store still holds the records of the actions.
    """
    try:
        model = importlib.import_module("prov.model")
    except ImportError as error:
        what = "the library prov is not installed"
        raise ExmeshError(what, fix="pip install 'exmesh-graph[prov]'") from error
    document = model.ProvDocument()
    document.add_namespace("exmesh", _SPACE)
    whole = _whole(document, run)
    rows = {row["name"]: row for row in run.record["nodes"] if row.get("key") and row["state"] in (DONE, HIT)}
    for row in rows.values():
        _action(document, run, row, rows, whole)
    return str(document.unified().serialize(format=format_, **({"indent": 1} if format_ == "json" else {})))


def _whole(document: Any, run: Run) -> Any:
    """The activity that is the run, with its plan and its agent."""
    record, told = run.record, public(run.record.get("provenance") or {"command": ""})
    facts = {**(told.get("exmesh_graph") or {}), "python": (told.get("libraries") or {}).get("python", "")}
    agent = document.agent("exmesh:software", _attributes(facts, "prov:SoftwareAgent", "exmesh-graph"))
    copy = run.folder / "graph.yaml"
    plan = document.entity(
        f"exmesh:graph/{sha256_file(copy) if copy.is_file() else run.id}",
        _attributes(told.get("project") or {}, "prov:Plan", Path(str(record.get("file") or run.id)).name),
    )
    facts = {"state": record["state"], "command": told["command"], **(told.get("machine") or {})}
    begun, ended = (_time(record.get(name)) for name in ("started", "finished"))
    whole = document.activity(f"exmesh:run/{run.id}", begun, ended, _attributes(facts, "exmesh:run", run.id))
    document.wasAssociatedWith(whole, agent, plan)
    if told.get("by"):
        person = document.agent("exmesh:author", _attributes({}, "prov:Person", told["by"]))
        document.actedOnBehalfOf(agent, person, whole)
    return whole


def _action(document: Any, run: Run, row: Mapping[str, Any], rows: Mapping[str, Any], whole: Any) -> None:
    """An action with what it took and made."""
    kept = run.store.look_up(row["key"], use=False)
    told: Mapping[str, Any] = {} if kept is None else kept.preimage
    facts = {name: told[name] for name in ("version", "code", "seed") if name in told}
    facts |= {f"param.{name}": _read(value) for name, value in (told.get("params") or {}).items()}
    facts |= {"seconds": row["seconds"]}
    action = document.activity(
        f"exmesh:action/{row['key']}", None, None, _attributes(facts, f"exmesh:{row['type']}", row["name"])
    )
    if row["state"] == DONE:
        document.wasStartedBy(action, starter=whole)
    else:
        document.wasInformedBy(whole, action)
    for name, digest in (told.get("sources") or {}).items():
        document.used(action, document.entity(f"exmesh:file/{digest}", _attributes({}, "exmesh:file", name)))
    for port, (kind, digest) in sorted((told.get("inputs") or _inputs(run, row, rows)).items()):
        if kind not in ("none", "list"):
            taken = document.entity(f"exmesh:artifact/{digest}", _attributes({}, f"exmesh:{kind}"))
            document.used(action, taken, other_attributes={"prov:role": port})
    for port, stored in row["outputs"].items():
        if stored["type"] not in ("none", "list"):
            facts = {"bytes": stored["bytes"]}
            made = document.entity(
                f"exmesh:artifact/{stored['digest']}", _attributes(facts, f"exmesh:{stored['type']}")
            )
            document.wasGeneratedBy(made, action, other_attributes={"prov:role": port})


def _inputs(run: Run, row: Mapping[str, Any], rows: Mapping[str, Any]) -> dict[str, tuple[str, str]]:
    """{port: (type, digest)} by the wires of the run's record, where the store holds no record of the action."""
    wired = (run.record.get("resolved") or {}).get("nodes", {}).get(row["name"], {})
    found = {}
    for port, link in (row.get("inputs") or wired.get("inputs") or {}).items():
        node, _, output = str(link).removeprefix("@").rpartition(".")
        stored = rows.get(node, {}).get("outputs", {}).get(output)
        if stored:
            found[port] = stored["type"], stored["digest"]
    return found


def _read(value: Any) -> Any:
    """A value of a key's pre-image, where floats are written by their bits."""
    if isinstance(value, dict):
        return float.fromhex(value["~float"]) if value.keys() == {"~float"} else {k: _read(v) for k, v in value.items()}
    return [_read(one) for one in value] if isinstance(value, list) else value


def _attributes(facts: Mapping[str, Any], kind: str, label: str = "") -> list[tuple[str, Any]]:
    told = [("prov:type", kind), *([("prov:label", label)] if label else [])]
    plain = (
        (name, value if isinstance(value, bool | int | float | str) else json.dumps(value))
        for name, value in facts.items()
    )
    return told + [(f"exmesh:{name}", value) for name, value in plain if value not in ("", "null")]


def _time(seconds: Any) -> datetime | None:
    return None if seconds is None else datetime.fromtimestamp(float(seconds), UTC)
