"""The reliability table: every fault that the framework is tested against, with its trials and its result.

    python -m benchmarks.reliability                # many trials (at least 500 kills), some minutes
    python -m benchmarks.reliability --quick        # as many as the test suite makes, without the slow tests
    python -m benchmarks.reliability --json out.json

Runs every test marked `@pytest.mark.reliability("what is done to it", "what must hold")` in a child process and
prints a row for each. Ends with 1 when a row fails. Run it in the repository's root.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest

TABLE = "EXMESH_RELIABILITY_TABLE"
ROOT = Path(__file__).parent.parent


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few trials, no slow tests")
    parser.add_argument("--only", default="", help="pytest's -k: only tests whose names match")
    parser.add_argument("--json", type=Path, help="write the table here as well")
    args = parser.parse_args()

    marks = "reliability and not slow" if args.quick else "reliability"
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "table.jsonl"
        command = [sys.executable, "-m", "pytest", "-p", "benchmarks.reliability", "-p", "no:cacheprovider", "-q"]
        command += ["-m", marks, "-k", args.only, "--basetemp", f"{folder}/tmp", "tests"]
        settings = {TABLE: str(table), "EXMESH_TRIALS": "few" if args.quick else "full"}
        done = subprocess.run(command, cwd=ROOT, env={**os.environ, **settings}, capture_output=True, text=True)
        outcomes = [json.loads(line) for line in table.read_text().splitlines()] if table.exists() else []
    rows = combined(outcomes)
    show(rows)
    failed = done.returncode != 0 or not rows
    if failed:
        print(done.stdout[-8000:] + done.stderr[-2000:])
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return int(failed)


def combined(outcomes: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row per title; tests that share one add up their trials."""
    rows: dict[str, dict[str, Any]] = {}
    for outcome in outcomes:
        row = rows.setdefault(outcome["row"], {**outcome, "trials": 0, "seconds": 0.0, "result": "held"})
        row["seconds"] = round(row["seconds"] + outcome["seconds"], 1)
        if outcome["result"] == "passed":
            row["trials"] += outcome["trials"]
        elif row["result"] != "FAILED":
            row["result"] = "FAILED" if outcome["result"] == "failed" else f"skipped: {outcome['why']}"
    return list(rows.values())


def show(rows: list[dict[str, Any]]) -> None:
    """Print the table as Markdown."""
    print("| what is done to it | what must hold | trials | seconds | result |\n| --- | --- | ---: | ---: | --- |")
    for row in rows:
        print("| {row} | {holds} | {trials} | {seconds} | {result} |".format(**row))


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Any:
    """pytest calls this after each phase of a test; the outcome of marked ones goes to the table."""
    report = (yield).get_result()
    mark = item.get_closest_marker("reliability")
    if mark is None or not (report.when == "call" or (report.when == "setup" and not report.passed)):
        return
    why = report.longrepr[2] if report.skipped and isinstance(report.longrepr, tuple) else ""
    outcome = {"row": mark.args[0], "holds": mark.args[1], "trials": dict(item.user_properties).get("trials", 1),
               "seconds": call.duration, "result": report.outcome, "why": why.removeprefix("Skipped: ")}  # fmt: skip
    with open(os.environ[TABLE], "a", encoding="utf-8") as table:
        table.write(json.dumps(outcome) + "\n")


if __name__ == "__main__":
    sys.exit(main())
