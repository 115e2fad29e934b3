"""The JSON schema of graph files: shipped graphs are valid, typical mistakes are not, editors find what they need."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.api.schema import graph_schema
from exmesh_graph.graph.language.params import KEYS, KINDS
from exmesh_graph.graph.language.spec import BLOCK_KEYS, TOP_KEYS
from exmesh_graph.graph.language.yamlfile import Limits, load_yaml, parse_yaml
from exmesh_graph.graph.variants.patches import OPERATIONS

jsonschema = pytest.importorskip("jsonschema", reason="pip install '.[test]'")
ROOT = Path(__file__).parent.parent.parent
FILE = ROOT / "graphs" / "schema.json"
SHIPPED = sorted((ROOT / "graphs").rglob("*.yaml"))


def plain(value: Any) -> Any:
    """As an editor sees it: all keys are texts."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    return [plain(item) for item in value] if isinstance(value, list) else value


@pytest.fixture(scope="module")
def schema(packs: Any) -> Any:
    found = graph_schema(packs)
    jsonschema.Draft7Validator.check_schema(found)
    return jsonschema.Draft7Validator(found)


def test_the_file_in_the_repository_is_current() -> None:
    words = ["from exmesh_graph.cli import main", "import sys", "sys.argv = ['exmesh', 'schema']", "main()"]
    done = subprocess.run([sys.executable, "-c", "; ".join(words)], capture_output=True, text=True, check=False)
    assert done.stdout == FILE.read_text(encoding="utf-8"), f"exmesh schema -o {FILE.relative_to(ROOT)}"


@pytest.mark.thorough
@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_shipped_graphs_name_the_schema_and_are_valid(schema: Any, path: Path) -> None:
    first = path.read_text(encoding="utf-8").splitlines()[0]
    prefix = "# yaml-language-server: $schema="
    assert first.startswith(prefix)
    assert (path.parent / first.removeprefix(prefix)).resolve() == FILE
    assert list(schema.iter_errors(plain(load_yaml(path)))) == []


GOOD = """
name: good
params: {by: 3, size: {type: int, default: 4, ge: 1, unit: px, doc: Size.}, box: {a: 1},
         fit: {default: wide, choices: {wide: {}, tight: {size: 3}}}, mode: {default: a, choices: [a, b]}}
seed: 3
inputs: {start: Number, more: {type: "Number | Whole", optional: true, facets: {split: train}}}
nodes:
  one: {type: toy.const, value: "${by}", label: "@@x", seed: 3, doc: x}
  line: {type: curve.line, slope: 3}
  sum: {type: curve.sum, first: "@line", second: null}
  end: {type: toy.evaluate, number: "@one.number", curve: "@sum"}
  any: {type: "${kind}", free: 3}
  part: {graph: part.yaml, start: "@one.number", by: 4, nodes: {first: {amount: 3}, second: null}}
  rounds:
    repeat: "${by}"
    carry: {state: "@one.number"}
    nodes:
      step: {type: toy.step, state: "@carry.state", every: {4: {type: toy.leap}}, at: {1: {amount: 3}, 2: null}}
      own: {type: curve.line}
    next: {state: "@step.state"}
outputs: {end: "@rounds[2].step.state", gone: null}
variants:
  a: [{set: one.value, to: 3}, {bypass: rounds.step}, {add: {name: x, type: toy.const}}]
  b: {extends: [a], doc: x, patches: []}
matrix: {variant: [base, a], by: [1, 2], exclude: [{by: 1}]}
repeats: {count: 3, of: [one]}
"""


def test_everything_that_can_be_said_is_valid(schema: Any) -> None:
    assert list(schema.iter_errors(plain(parse_yaml(GOOD, None)))) == []


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("seed: 3\ninputs", "sed: 3\ninputs"),
        ("seed: 3\ninputs", "seed: -3\ninputs"),
        ("default: 4, ge", "defautl: 4, ge"),
        ("type: int", "type: itn"),
        ("start: Number,", "start: Numbr,"),
        ("optional: true", "optional: 3"),
        ("choices: [a, b]", "choices: a"),
        ("tight: {size: 3}", "tight: 3"),
        ("toy.const, value", "toy.cnst, value"),
        ('value: "${by}"', "value: 2000"),
        ('value: "${by}"', "valeu: 3"),
        ('value: "${by}"', "value: true"),
        ('number: "@one.number"', 'number: "@one"'),
        ('number: "@one.number"', 'number: "one.number"'),
        ('number: "@one.number", curve', "curve"),
        ('curve: "@sum"', 'curve: "sum"'),
        ("slope: 3", "slope: 11"),
        ("slope: 3", "slope: 3, seed: 4"),
        ("repeat: ", "reapet: "),
        ('repeat: "${by}"', "repeat: 1001"),
        ("every: {4:", "every: {x:"),
        ("type: toy.leap", "type: toy.laep"),
        ("next: {state", "nxt: {state"),
        ('"@rounds[2].step.state"', "rounds"),
        ("bypass: rounds.step", "bypas: rounds.step"),
        ("to: 3}", "ot: 3}"),
        ("patches: []", "patches: 3"),
        ("count: 3", "count: 0"),
        ("nodes:\n  one", "no:\n  one"),
    ],
)
def test_typical_mistakes_are_found(schema: Any, old: str, new: str) -> None:
    assert old in GOOD
    assert list(schema.iter_errors(plain(parse_yaml(GOOD.replace(old, new, 1), None)))) != []


def test_changes_need_no_type_where_a_file_is_extended(schema: Any) -> None:
    change = "nodes: {one: {value: 3}, two: null, rounds: {nodes: {step: {amount: 3}}, repeat: 3}}"
    assert list(schema.iter_errors(plain(parse_yaml(change, None)))) != []
    assert list(schema.iter_errors(plain(parse_yaml("extends: x.yaml\n" + change, None)))) == []


def test_editors_see_units_ranges_and_meaning(schema: Any) -> None:
    line = schema.schema["definitions"]["node.curve.line"]
    assert line["properties"]["slope"]["description"] == "Rise per x. [per x]"
    assert line["properties"]["slope"]["default"] == 1.0
    assert {"maximum": 10, "minimum": -10, "type": "number"} in line["properties"]["slope"]["anyOf"]
    assert line["properties"]["type"] == {"const": "curve.line", "description": "slope * x."}
    split = schema.schema["definitions"]["node.toy.train_only"]
    assert "Number[split='train']" in split["properties"]["number"]["description"]


def test_the_common_part_names_what_the_language_knows(schema: Any) -> None:
    """`schema.json` is written by hand: types of graph parameters, their limits, and the operations of patches."""
    common = schema.schema["definitions"]
    parameter = common["parameter"]["then"]["properties"]
    assert tuple(parameter["type"]["enum"]) == tuple(KINDS)
    assert set(parameter) == set(KEYS)
    operations = {item["required"][0]: item.get("properties") for item in common["patches"]["items"]["oneOf"]}
    assert operations.keys() == OPERATIONS.keys()
    for name, (_, keys) in OPERATIONS.items():
        assert (operations[name] is None) == (keys is None)
        assert keys is None or set(operations[name]) == {name, *keys}
    assert set(schema.schema["properties"]) == set(TOP_KEYS)
    assert set(common["whole_block"]["properties"]) == set(common["change_block"]["properties"]) == set(BLOCK_KEYS)
    assert common["rounds_count"]["anyOf"][0]["maximum"] == Limits().rounds
