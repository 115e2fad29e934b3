"""Saving edits: in place with comments and order kept, as a variant, as a child file; and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from exmesh_graph.graph.session import current_session
from exmesh_graph.studio.textedit import with_value, without


def edit(client: TestClient, *ops: dict[str, Any]) -> None:
    assert client.post("/api/edit", json={"ops": list(ops)}).status_code == 200


def save(client: TestClient, code: int = 200, **body: Any) -> dict[str, Any]:
    answer = client.post("/api/save", json=body)
    assert answer.status_code == code, answer.text
    return dict(answer.json())


def test_saving_in_place_changes_the_values_and_nothing_else(client: TestClient, folder: Path) -> None:
    file = folder / "graphs" / "small.yaml"
    before = file.read_text()
    edit(client, {"set": "one.value", "to": 7}, {"set": "n", "to": 4}, {"set": "rounds[3].leap.factor", "to": 9})
    told = client.get("/api/text").json()
    assert told["why_not"] is None
    assert told["diff"].count("\n-") == 3
    saved = save(client, **{"as": "file"})
    after = file.read_text()
    assert after == told["new_text"]
    assert after == (
        before.replace("value: 1}", "value: 7}").replace("default: 3", "default: 4")
        .replace("at: {2: {factor: 3}}", "at: {2: {factor: 3}, 3: {factor: 9}}")
    )  # fmt: skip
    assert saved["document"]["dirty"] is False
    assert saved["document"]["problems"] == []


def test_rewiring_renaming_and_removing_in_place(client: TestClient, folder: Path) -> None:
    edit(
        client, {"rename": "one", "to": "first"}, {"add": {"name": "twice", "type": "toy.add", "a": "@sum.number"}},
        {"connect": "files.number", "to": "@twice.number"}, {"bypass": "rounds.leap"}, {"disconnect": "sum.b"},
    )  # fmt: skip
    saved = save(client, **{"as": "file"})
    assert saved["document"]["problems"] == []
    text = (folder / "graphs" / "small.yaml").read_text()
    assert "  first: {type: toy.const, value: 1}     # begins\n" in text
    assert "leap" not in text
    assert current_session().check(folder / "graphs" / "small.yaml").nodes.keys() >= {"first", "twice"}


def test_a_rename_is_followed_by_the_files_own_variants(client: TestClient, folder: Path) -> None:
    file = folder / "graphs" / "small.yaml"
    variants = """variants:
  alone: [{disconnect: sum.b}]   # sum, one
  big:
    doc: one.value is large
    patches: [{set: one.value, to: 7}, {set: {one.label: one}}]
  wired: [{connect: sum.a, to: "@one.number"}, {add: {name: rounds.more, type: toy.step, state: "@step.state"}}]
  third: [{set: "rounds[2].step.amount", to: 3}, {connect: rounds.leap.state, to: '@step.state'}]
  both: {extends: [big, alone]}
matrix:
  variant: [base, big]
  how: {plain: [], odd: [{set: one.value, to: 9}]}
repeats: {count: 2, of: [one, sum]}
"""
    file.write_text(file.read_text().partition("variants:")[0] + variants)
    client.post("/api/reload", json={})
    edit(client, {"rename": "one", "to": "first"}, {"rename": "rounds.step", "to": "walk"})
    saved = save(client, **{"as": "file"})
    assert saved["document"]["problems"] == []
    expected = variants
    for old, new in (
        ("one.value, to", "first.value, to"), ("{one.label", "{first.label"), ("@one.n", "@first.n"),
        ("@step.state", "@walk.state"), ("[2].step", "[2].walk"), ("of: [one", "of: [first"),
    ):  # fmt: skip
        expected = expected.replace(old, new)
    got = file.read_text()
    assert "variants:" + got.partition("variants:")[2].replace("'", '"') == expected.replace("'", '"')
    for name in ("wired", "third", "both", "big,how=odd"):
        assert "first" in current_session().check(file, variant=name).nodes


def test_a_variant_holds_the_patches(client: TestClient, folder: Path) -> None:
    edit(client, {"set": "one.value", "to": 7}, {"bypass": "rounds.leap"})
    saved = save(client, **{"as": "variant", "name": "plain"})
    assert saved["document"]["variant"] == "plain"
    assert saved["document"]["dirty"] is False
    text = (folder / "graphs" / "small.yaml").read_text()
    assert text.endswith(
        "variants:\n  alone: [{disconnect: sum.b}]\n  plain:\n    - {set: one.value, to: 7}\n"
        "    - {bypass: rounds.leap}\n"
    )
    assert "rounds[1].leap" not in current_session().check(folder / "graphs" / "small.yaml", variant="plain").nodes


def test_a_child_extends_the_file(client: TestClient, folder: Path) -> None:
    edit(client, {"set": "one.value", "to": 7}, {"remove": "files", "force": True})
    saved = save(client, **{"as": "child", "file": "mine.yaml"})
    assert saved["document"]["file"] == "mine.yaml"
    assert (folder / "graphs" / "mine.yaml").read_text() == (
        "extends: small.yaml\nname: mine\nnodes:\n  one: {value: 7}\n  files: null\noutputs:\n  asset: null\n"
    )
    assert "files" not in current_session().check(folder / "graphs" / "mine.yaml").nodes
    save(client, 409, **{"as": "child", "file": "mine.yaml"})


@pytest.mark.thorough
@pytest.mark.parametrize("file", ["../out.yaml", "/tmp/out.yaml", "sub/out.yaml", "out.py", "a\0.yaml", ""])
def test_nothing_is_written_outside_of_the_folder(client: TestClient, folder: Path, file: str) -> None:
    edit(client, {"set": "one.value", "to": 7})
    save(client, 404, **{"as": "child", "file": file})
    assert [path.name for path in folder.rglob("*.yaml")] == ["small.yaml"]


def test_a_faulty_graph_is_saved_on_demand_only(client: TestClient) -> None:
    edit(client, {"set": "one.value", "to": 5000})
    error = save(client, 422, **{"as": "file"})["error"]
    assert error["problems"][0]["node"] == "one"
    save(client, **{"as": "file", "faulty": True})


def test_a_file_that_somebody_else_wrote_is_not_overwritten(client: TestClient, folder: Path) -> None:
    edit(client, {"set": "one.value", "to": 7})
    file = folder / "graphs" / "small.yaml"
    file.write_text(file.read_text().replace("amount: 2", "amount: 4"))
    assert client.get("/api/document").json()["disk"] == "changed"
    save(client, 409, **{"as": "file"})
    told = client.post("/api/reload", json={}).json()
    assert told["lost"] == []
    assert told["ops"] == [{"set": "one.value", "to": 7}]
    save(client, **{"as": "file"})
    assert "amount: 4" in file.read_text()


def test_changing_single_values_of_a_text() -> None:
    text = "a:  # one\n  b: {c: 1, d: [1, 2]}  # two\n  e: 3\nf:\n"
    assert with_value(text, ("a", "b", "c"), {"x": "@y.z"}) == text.replace("c: 1", 'c: {x: "@y.z"}')
    assert with_value(text, ("a", "b", "n"), 0.5) == text.replace("[1, 2]}", "[1, 2], n: 0.5}")
    assert with_value(text, ("a", "n"), "x y") == text.replace("  e: 3\n", "  e: 3\n  n: x y\n")
    assert with_value(text, ("f", "g"), 1) == text.replace("f:\n", "f: {g: 1}\n")
    assert without(text, ("a", "b", "d")) == text.replace(", d: [1, 2]", "")
    assert without(text, ("a", "b", "c")) == text.replace("c: 1, ", "")
    assert without(text, ("a", "b")) == text.replace("  b: {c: 1, d: [1, 2]}  # two\n", "")


def test_ends_say_what_fits_and_why_not(client: TestClient) -> None:
    told = client.get("/api/ends", params={"node": "sum", "port": "a"}).json()
    ends = {(end["node"], end["port"], end["side"]): end for end in told["ends"]}
    assert ends["rounds", "state", ""]["in_use"]
    assert ends["one", "number", ""]["ok"]
    assert "is inside rounds" in ends["rounds.step", "state", ""]["why"]
    assert "waits for sum itself" in ends["sum", "number", ""]["why"]
    assert "is Files" in ends["files", "files", ""]["why"]
    assert "toy.const" in told["types"]
    inner = client.get("/api/ends", params={"node": "rounds", "port": "state", "side": "next"}).json()
    assert [e["link"] for e in inner["ends"] if e["node"] == "rounds.step"] == ["@step.state"]
    out = client.get("/api/ends", params={"node": "one", "port": "number", "output": 1}).json()
    found = {(end["node"], end["port"], end["side"]): end for end in out["ends"]}
    assert found["rounds", "state", ""]["target"] == "rounds.carry.state"
    assert found["rounds.step", "state", ""]["ok"]


def test_a_type_that_fits_all_wires_can_take_the_place(client: TestClient) -> None:
    told = {row["type"]: row for row in client.get("/api/swaps", params={"node": "rounds.step"}).json()["types"]}
    assert told["toy.leap"]["ok"]
    assert not told["toy.folder"]["ok"]
    edit(client, {"replace": "rounds.step", "type": "toy.leap"})
    assert client.get("/api/document").json()["problems"] == []
