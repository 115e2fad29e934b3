"""The JSON schema of graph files, made from the node types at hand, for editors that complete and check YAML.

What all graph files have in common stands in `schema.json`: repeat blocks, sub-graphs, graph parameters and variants.
Here come the node types, their ports (as patterns of links) and their parameters with ranges, units and docs. What
only `exmesh check` can know, wires and files, is in neither.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from exmesh_graph.graph.declare.node import NodeDef
from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.declare.ports import Port, Signature, signature, signature_of, types_by_name


def graph_schema(packs: Packs) -> dict[str, Any]:
    """The schema of graph files as a JSON-like mapping (draft 7, which editors know)."""
    schema: dict[str, Any] = json.loads(Path(__file__).with_name("schema.json").read_text(encoding="utf-8"))
    types = {name: definition for name, definition in packs.types.items() if signature_of(packs, name)}
    common = schema["definitions"]
    common["change"]["anyOf"][0]["properties"]["type"]["enum"] = sorted(types)
    common["wire_type"]["anyOf"][0]["enum"] = sorted(name for name in types_by_name() if name != "artifact")
    for entry in ("whole_entry", "change_entry"):
        common[entry]["oneOf"] += [_ref(f"node.{name}") for name in types]
    schema["definitions"] = {f"node.{name}": _node(definition) for name, definition in types.items()} | common
    return schema


def schema_text(packs: Packs) -> str:
    """The schema as the text of a file."""
    return json.dumps(graph_schema(packs), indent=1, ensure_ascii=False) + "\n"


def _node(definition: NodeDef) -> dict[str, Any]:
    kind = signature(definition)
    properties: dict[str, Any] = {"type": {"const": definition.type, "description": kind.doc}}
    properties |= {name: _port(port) for name, port in kind.inputs.items()}
    own = [name for name in kind.params.model_fields if name not in kind.inputs]
    plain = kind.params.model_json_schema(ref_template="#/definitions/{model}").get("properties", {})
    properties |= {name: _param(kind, name, plain[name]) for name in own}
    if kind.component is None:
        properties |= {name: _ref(name) for name in ("seed", "every", "at", "limits", "bypass")}
        if single := [port.name for port in kind.inputs.values() if not (port.many or port.plugged)]:
            one: dict[str, Any] = {"enum": single}
            words = "Inputs that are lists: a node for each element."
            properties["each"] = {"description": words, "anyOf": [one, {"type": "array", "items": one}]}
    properties["doc"] = {"type": "string"}
    needed = [port.name for port in kind.inputs.values() if not port.optional]
    needed += [name for name in own if kind.params.model_fields[name].is_required()]
    return {"type": "object", "properties": properties, "required": ["type", *needed], "additionalProperties": False}


def _port(port: Port) -> dict[str, Any]:
    link: dict[str, Any] = {
        "type": "string",
        "pattern": r"^@[^@\s]+$" if port.plugged or port.mixed else r"^@[^@\s]+\.[A-Za-z_]\w*$",
    }
    if port.many:
        several = {"type": "array", "items": {"anyOf": [link, _ref("reference")]}}
        link = {"anyOf": [link, several]}
    words = "component" if port.plugged else "component or link to" if port.mixed else "link to"
    return {"description": f"{words} {port}", "anyOf": [link, _ref("reference"), *([{"type": "null"}] * port.optional)]}


def _param(kind: Signature, name: str, plain: Mapping[str, Any]) -> dict[str, Any]:
    unit, doc = kind.extra(name).get("unit"), kind.params.model_fields[name].description or ""
    told = ("title", "description", "unit", "tuning", "default")
    rest = {key: value for key, value in plain.items() if key not in told}
    result = {"description": f"{doc} [{unit}]" if unit else doc, "anyOf": [rest, _ref("reference")]}
    return result | ({"default": plain["default"]} if "default" in plain else {})


def _ref(name: str) -> dict[str, str]:
    return {"$ref": f"#/definitions/{name}"}
