"""The JSON schema of graph files, made from the node types at hand, for editors that complete and check YAML.

It knows node types, their ports (as patterns of links), parameters with ranges, units and docs, repeat blocks,
sub-graphs, graph parameters and variants. What only `exmesh check` can know, wires and files, is not in it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from exmesh_graph.graph.declare.node import NodeDef
from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.declare.ports import Port, Signature, signature, types_by_name
from exmesh_graph.graph.language.params import KINDS, SIGNS
from exmesh_graph.graph.variants.patches import OPERATIONS

_NAMES = {"pattern": "^[A-Za-z_][A-Za-z0-9_-]*$"}
_LINK = r"^@[^@\s]+\.[A-Za-z_]\w*$"
_COMPONENT = r"^@[^@\s]+$"
_SAME = ("seed", "doc", "every", "at")


def graph_schema(packs: Packs) -> dict[str, Any]:
    """The schema of graph files as a JSON-like mapping (draft 7, which editors know)."""
    types = {name: definition for name, definition in packs.types.items() if _usable(definition)}
    definitions = {f"node.{name}": _node(definition) for name, definition in types.items()}
    nodes = [_ref(name) for name in definitions]
    definitions |= _words(sorted(types))
    for kind, others in (("whole", []), ("change", [_ref("patch"), {"type": "null"}])):
        entry = f"{kind}_entry"
        definitions[f"{kind}_block"] = _block(entry)
        definitions[entry] = {"oneOf": [_ref(f"{kind}_block"), _ref("part"), _ref("any_type"), *others, *nodes]}
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "exmesh graph file",
        "type": "object",
        "properties": {
            "name": {"type": "string", "description": "Run folders carry it; default: the file's name."},
            "doc": {"type": "string"},
            "extends": {"type": "string", "description": "Another graph file, which this one changes."},
            "seed": _ref("seed"),
            "params": {"type": "object", "propertyNames": _NAMES, "additionalProperties": _ref("parameter")},
            "inputs": {"type": "object", "propertyNames": _NAMES, "additionalProperties": _ref("input")},
            "nodes": {"type": "object", "propertyNames": _NAMES},
            "outputs": {"type": "object", "propertyNames": _NAMES, "additionalProperties": _maybe(_ref("link"))},
            "variants": {"type": "object", "additionalProperties": _maybe(_ref("variant"))},
            "matrix": _ref("matrix"),
            "repeats": _ref("repeats"),
        },
        "additionalProperties": False,
        "if": {"required": ["extends"]},
        "then": {"properties": {"nodes": {"additionalProperties": _ref("change_entry")}}},
        "else": {"required": ["nodes"], "properties": {"nodes": {"additionalProperties": _ref("whole_entry")}}},
        "definitions": definitions,
    }


def schema_text(packs: Packs) -> str:
    """The schema as the text of a file."""
    return json.dumps(graph_schema(packs), indent=1, ensure_ascii=False) + "\n"


def _node(definition: NodeDef) -> dict[str, Any]:
    found = signature(definition)
    properties: dict[str, Any] = {"type": {"const": definition.type, "description": found.doc}}
    properties |= {name: _port(port) for name, port in found.inputs.items()}
    own = [name for name in found.params.model_fields if name not in found.inputs]
    plain = found.params.model_json_schema(ref_template="#/definitions/{model}").get("properties", {})
    properties |= {name: _param(found, name, plain[name]) for name in own}
    if found.component is None:
        properties |= {name: _ref(name) for name in ("seed", "every", "at")}
    properties["doc"] = {"type": "string"}
    required = [port.name for port in found.inputs.values() if not port.optional]
    required += [name for name in own if found.params.model_fields[name].is_required()]
    return {
        "type": "object", "properties": properties,
        "required": ["type", *required], "additionalProperties": False,
    }  # fmt: skip


def _port(port: Port) -> dict[str, Any]:
    link = {"type": "string", "pattern": _COMPONENT if port.plugged or port.mixed else _LINK}
    words = "component" if port.plugged else "component or link to" if port.mixed else "link to"
    return {"description": f"{words} {port}", "anyOf": [link, _ref("reference"), *([{"type": "null"}] * port.optional)]}


def _param(found: Signature, name: str, plain: Mapping[str, Any]) -> dict[str, Any]:
    unit = found.extra(name).get("unit")
    rest = {
        key: value for key, value in plain.items() if key not in ("title", "description", "unit", "tuning", "default")
    }
    doc = found.params.model_fields[name].description or ""
    result = {"description": f"{doc} [{unit}]" if unit else doc, "anyOf": [rest, _ref("reference")]}
    return result | ({"default": plain["default"]} if "default" in plain else {})


def _words(types: list[str]) -> dict[str, Any]:
    """What all graph files have in common."""
    text, flag = {"type": "string"}, {"type": "boolean"}
    changes = {"type": "object", "properties": {"type": {"enum": types}}}
    rounds = {"type": "object", "additionalProperties": False, "patternProperties": {"^[1-9][0-9]*$": _maybe(changes)}}
    kinds = [name for name in types_by_name() if name != "artifact"]
    input_type = {"anyOf": [{"enum": sorted(kinds)}, {"type": "string", "pattern": r"\|"}]}
    limits = {sign: {"type": "number"} for sign in SIGNS}
    no_own = {"not": {"anyOf": [{"required": [word]} for word in ("type", "repeat", "graph")]}}
    patches = {"type": "array", "items": {"oneOf": [_operation(name, keys) for name, (_, keys) in OPERATIONS.items()]}}
    return {
        "reference": {"type": "string", "pattern": r"\$\{[^{}]*\}", "description": "a graph parameter: ${name}"},
        "link": {"anyOf": [{"type": "string", "pattern": _LINK}, _ref("reference")]},
        "seed": {"anyOf": [{"type": "integer", "minimum": 0}, _ref("reference")], "description": "Part of every key."},
        "every": {"description": "Changes in the rounds divisible by a number.", "anyOf": [rounds, {"type": "null"}]},
        "at": {"description": "Changes in single rounds; they win over every.", "anyOf": [rounds, {"type": "null"}]},
        "any_type": {
            "type": "object", "required": ["type"],
            "properties": {"type": {"type": "string", "pattern": r"\$\{[^{}]*\}"}},
        },
        "patch": {"type": "object", "description": "Changes to a node of the file that this one extends.", **no_own},
        "part": {
            "type": "object", "description": "Another graph file, used like a node: its inputs and parameters.",
            "properties": {"graph": text, "nodes": {"type": "object", "additionalProperties": _ref("change_entry")},
                           "seed": _ref("seed"), "doc": text, "every": _ref("every"), "at": _ref("at")},
            "required": ["graph"], "not": {"anyOf": [{"required": ["type"]}, {"required": ["repeat"]}]},
        },
        "parameter": {
            "if": {"type": "object", "anyOf": [{"required": ["type"]}, {"required": ["default"]}]},
            "then": {
                "properties": {"type": {"enum": list(KINDS)}, "default": {}, **limits, "unit": text, "doc": text,
                               "choices": {"type": "array", "minItems": 1}},
                "additionalProperties": False,
            },
        },
        "input": {"anyOf": [input_type, {
            "type": "object", "required": ["type"], "additionalProperties": False,
            "properties": {"type": input_type, "optional": flag, "facets": {"type": "object"}, "doc": text},
        }]},
        "patches": patches,
        "variant": {"anyOf": [_ref("patches"), {
            "type": "object", "additionalProperties": False,
            "properties": {"extends": {"type": ["array", "string"]}, "doc": text, "patches": _ref("patches")},
        }]},
        "matrix": {"type": "object", "properties": {"include": {"type": "array"}, "exclude": {"type": "array"}}},
        "repeats": {"anyOf": [{"type": "integer", "minimum": 1}, {
            "type": "object", "required": ["count"], "additionalProperties": False,
            "properties": {"count": {"type": "integer", "minimum": 1}, "of": {"type": ["array", "string"]}},
        }]},
    }  # fmt: skip


def _block(entry: str) -> dict[str, Any]:
    link = {"type": "string", "pattern": r"^@|\$\{"}
    carried = {"type": "object", "propertyNames": _NAMES, "additionalProperties": _maybe(link)}
    return {
        "type": "object", "description": "A block of nodes, unrolled so many times.",
        "properties": {
            "repeat": {"anyOf": [{"type": "integer", "minimum": 0, "maximum": 1000}, _ref("reference")]},
            "carry": carried, "next": carried, "doc": {"type": "string"},
            "nodes": {"type": "object", "propertyNames": _NAMES, "additionalProperties": _ref(entry)},
        },
        "required": ["repeat"], "additionalProperties": False,
    }  # fmt: skip


def _operation(name: str, keys: tuple[str, ...] | None) -> dict[str, Any]:
    result: dict[str, Any] = {"type": "object", "required": [name]}
    if keys is not None:
        result |= {"properties": {key: {} for key in (name, *keys)}, "additionalProperties": False}
    return result


def _usable(definition: NodeDef) -> bool:
    try:
        return signature(definition) is not None
    except (TypeError, NameError):
        return False


def _maybe(schema: Mapping[str, Any]) -> dict[str, Any]:
    return {"anyOf": [schema, {"type": "null"}]}


def _ref(name: str) -> dict[str, str]:
    return {"$ref": f"#/definitions/{name}"}
