"""The table of a sweep: means, spreads, differences, seconds, shared nodes, failures; its files and its page."""

from __future__ import annotations

import csv
import io
import json
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.report.sweep.files import sweep_csv, write_sweep
from exmesh_graph.report.sweep.table import sweep_table, text_of, verdict
from exmesh_graph.types import Metrics

VALUES = {"base": (30.0, 31.0, 32.0), "good": (35.0, 36.0, 37.0), "odd": (31.0, 31.5, 32.0)}


def headline(value: float, closed: bool = True) -> Metrics:
    entries = [{"label": "PSNR", "value": value, "unit": "dB", "better": "higher", "series": "psnr", "floor": 20.0},
               {"label": "Closed", "value": closed}, {"label": "Kind", "value": "tetra"}]  # fmt: skip
    return Metrics({"headline": entries})


@pytest.fixture
def sweep() -> tuple[dict[str, Any], list[dict[str, Any]], dict[str, Metrics]]:
    """A shared `views`, one `fit` and one `score` per variant and seed; the second seed of `bad` fails."""
    rows = [{"name": "views", "type": "data", "state": "hit", "seconds": 5.0, "outputs": {}, "warnings": []}]
    members, loads, inputs = [], {}, {}
    for variant in ("base", "good", "odd", "bad"):
        for repeat in (1, 2, 3):
            label = f"{variant}#{repeat}"
            failed = variant == "bad" and repeat == 2
            value = VALUES.get(variant, (1.0, 2.0, 3.0))[repeat - 1]
            loads[label] = headline(value, closed=repeat != 3)
            outputs = {} if failed else {"metrics": {"type": "Metrics", "digest": label, "bytes": 1}}
            pictures = {} if failed else {"gallery": {"type": "Gallery", "digest": "never read", "bytes": 1}}
            rows.append({"name": f"{label}:fit", "type": "fit", "state": "failed" if failed else "done",
                         "seconds": 10.0 * repeat, "outputs": {}, "warnings": []})  # fmt: skip
            rows.append({"name": f"{label}:score", "type": "score", "state": "blocked" if failed else "done",
                         "seconds": 1.0, "outputs": {**outputs, **pictures}, "warnings": []})  # fmt: skip
            inputs[f"{label}:fit"] = {"inputs": {"views": "@views.train"}}
            inputs[f"{label}:score"] = {"inputs": {"asset": f"@{label}:fit.asset"}}
            settings = {} if variant == "base" else {"variant": variant, "faces": 200}
            nodes = {name: name if name == "views" else f"{label}:{name}" for name in ("views", "fit", "score")}
            members.append({"variant": variant, "file": "study", "repeat": repeat, "seed": repeat - 1, "doc": "",
                            "settings": settings, "nodes": nodes})  # fmt: skip
    record = {"id": "1", "graph": "study-sweep", "command": "exmesh sweep study.yaml", "state": "failed",
              "seconds": 9.0, "nodes": rows, "resolved": {"nodes": inputs}}  # fmt: skip
    return record, members, loads


def table_of(sweep: Any) -> dict[str, Any]:
    record, members, loads = sweep
    return sweep_table(record, members, loads.__getitem__, {"bad#2:fit": "no rays left\n  fix: add rays"})


def test_mean_spread_difference_and_whether_it_exceeds_the_spread(sweep: Any) -> None:
    rows = {row["variant"]: row for row in table_of(sweep)["variants"]}
    base, good, odd = (rows[name]["figures"]["PSNR"] for name in ("base", "good", "odd"))
    assert (base["mean"], base["spread"]) == (31.0, 1.0)
    assert "difference" not in base
    assert (good["difference"], good["exceeds"]) == (5.0, True)
    assert odd["spread"] == pytest.approx(0.5)
    assert (odd["difference"], odd["difference_spread"], odd["exceeds"]) == (0.5, 0.5, False)  # 1, 0.5, 0
    assert good["difference_spread"] == 0  # the seeds move both alike: nothing is left of a spread of 1
    assert good["values"] == [35.0, 36.0, 37.0]
    assert good["after_seconds"] == 5.0 + 20.0
    assert rows["good"]["figures"]["Kind"]["mean"] == "tetra"
    assert "difference" not in rows["good"]["figures"]["Closed"]


def test_a_second_node_with_a_label_does_not_part_its_column(sweep: Any) -> None:
    """In `good` the fit reports a PSNR as well, so the labels name the node: in the base too, or none compares."""
    record, _, loads = sweep
    for row in record["nodes"]:
        if row["name"].startswith("good#") and row["name"].endswith(":fit"):
            row["outputs"] = {"metrics": {"type": "Metrics", "digest": row["name"], "bytes": 1}}
            loads[row["name"]] = headline(7.0)
    table = table_of(sweep)
    rows = {row["variant"]: row for row in table["variants"]}
    assert "PSNR" not in {figure["label"] for figure in table["figures"]}
    assert rows["good"]["figures"]["PSNR (score)"]["difference"] is not None
    assert rows["good"]["figures"]["PSNR (fit)"].get("difference") is None
    assert "PSNR (score)" in rows["base"]["figures"]


def test_seconds_count_hits_and_the_shared_part_apart(sweep: Any) -> None:
    rows = {row["variant"]: row for row in table_of(sweep)["variants"]}
    assert rows["good"]["seconds"] == {"mean": 5 + 20 + 1, "spread": 10.0, "own": 21.0}
    assert rows["base"]["seconds"]["own"] == 0
    assert (rows["good"]["shared"], rows["good"]["nodes"], rows["base"]["shared"]) == (1, 3, 3)
    assert table_of(sweep)["nodes"] == {"of_all_variants": 36, "after_sharing": 25, "from_store": 1, "run": 22}


def test_nodes_that_came_to_the_same_key_are_shared(sweep: Any) -> None:
    record, members, loads = sweep
    for row in record["nodes"]:
        row["key"] = row["name"].replace("good", "base")
    good = table_of((record, members, loads))["variants"][1]
    assert (good["shared"], good["seconds"]["own"]) == (3, 0.0)


def test_a_failed_variant_keeps_its_line_its_reason_and_what_it_has(sweep: Any) -> None:
    bad = table_of(sweep)["variants"][-1]
    assert (bad["state"], bad["reason"]) == ("failed", "fit: no rays left; fix: add rays")
    assert bad["figures"]["PSNR"]["values"] == [1.0, 3.0]
    assert [repeat["state"] for repeat in bad["repeats"]] == ["done", "failed", "done"]


def test_without_repeats_nothing_is_said_about_spread(sweep: Any) -> None:
    record, members, loads = sweep
    first = [member for member in members if member["repeat"] == 1]
    good = sweep_table(record, first, loads.__getitem__)["variants"][1]["figures"]["PSNR"]
    assert good["spread"] is None
    assert good["exceeds"] is None
    assert good["difference"] == 5.0
    assert verdict({"better": "higher"}, good) == "better"


def test_nodes_that_did_not_run_count_as_unfinished(sweep: Any) -> None:
    record, members, loads = sweep
    record["nodes"][1]["state"] = "interrupted"
    assert table_of((record, members, loads))["variants"][0]["reason"] == "fit: interrupted"


def test_the_files_hold_the_same(sweep: Any, tmp_path: Path) -> None:
    table = table_of(sweep)
    page = write_sweep(tmp_path, table)
    assert json.loads((tmp_path / "sweep.json").read_text()) == json.loads(json.dumps(table))
    lines = list(csv.DictReader(io.StringIO((tmp_path / "sweep.csv").read_text())))
    assert [line["variant"] for line in lines] == ["base", "good", "odd", "bad"]
    assert (lines[1]["PSNR mean"], lines[1]["PSNR difference"], lines[1]["faces"]) == ("36.0", "5.0", "200")
    assert lines[0]["PSNR difference"] == ""
    assert sweep_csv(table).count("\n") == 5
    text = page.read_text()
    assert "no rays left" in text
    assert "within the spread" in text
    assert "36.0 ± 1.0" in text


class Links(HTMLParser):
    """Tags left open, and addresses outside the page."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.outside: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.outside += [v for k, v in attrs if k in ("src", "href") and v and not v.startswith(("#", "data:"))]
        if tag not in ("meta", "input", "br", "line", "rect", "circle", "path", "text"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if self.open and self.open[-1] == tag:
            self.open.pop()


def test_the_page_stands_alone(sweep: Any, tmp_path: Path) -> None:
    record, members, loads = sweep
    members[3]["variant"] = members[4]["variant"] = members[5]["variant"] = "<b>"
    parser = Links()
    text = write_sweep(tmp_path, table_of((record, members, loads))).read_text()
    parser.feed(text)
    assert parser.outside == []
    assert parser.open == []
    assert "<b>" not in text


def test_texts() -> None:
    assert text_of({}) == "–"
    assert text_of({"mean": 0.5, "spread": None, "values": [True, False]}) == "1 of 2"
    assert text_of({"mean": 1.0, "spread": None, "values": [True]}) == "yes"
    assert text_of({"mean": 25028.0, "spread": None, "values": [25028]}) == text_of({"mean": 25028, "values": [25028]})
    assert verdict({"better": "lower"}, {"difference": 1.0, "exceeds": True}) == "worse"
    assert verdict({"better": ""}, {"difference": 1.0, "exceeds": None}) == "other"
    assert verdict({"better": "lower"}, {"difference": 1.0, "exceeds": False}) == "same"


def test_the_markdown_table_marks_what_exceeds_the_spread_and_says_why_a_row_failed(sweep: Any, tmp_path: Path) -> None:
    table = table_of(sweep)
    write_sweep(tmp_path, table)
    head, rule, *rows = (tmp_path / "sweep.md").read_text().splitlines()
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in (head, rule, *rows[:4])]
    assert {len(row) for row in cells} == {len(cells[0])}
    column = next(k for k, name in enumerate(cells[0]) if name.startswith("PSNR"))
    assert [row[0] for row in cells[2:]] == ["`base`", "`good`", "`odd`", "`bad`"]
    assert cells[3][column].startswith("36")
    assert cells[3][column].endswith("▲")
    assert "▲" not in rows[0]
    assert "no rays left" in rows[3]
