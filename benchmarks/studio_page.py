"""The studio's page in headless Chromium: how soon a large graph is drawn, and what a page that watches a run costs it.

Called by `benchmarks.studio`; needs the extras `studio` and `browser`, and a Chromium.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
PLAIN = ("--no-sandbox", "--disable-gpu")
"""Without a GPU a browser draws with the processor; one that emulates a GPU for WebGL takes many times as much."""
_DRAWN = """(() => {
  const look = () => document.querySelector('.react-flow__node .box')
    ? requestAnimationFrame(() => setTimeout(() => { window.drawn = performance.now(); }))
    : requestAnimationFrame(look);
  requestAnimationFrame(look);
})()"""


def paint(args: argparse.Namespace, folder: Path) -> Iterator[dict[str, Any]]:
    """A graph of many nodes of the real types is opened: the first time after the server began, and again."""
    from tests.studio.browser import Studio, browser_page

    folder.mkdir(parents=True)
    studio = Studio(large_graph(folder / "large.yaml", args.nodes))
    try:
        with browser_page() as page:
            page.add_init_script(_DRAWN)
            session = page.context.new_cdp_session(page)
            session.send("Performance.enable", {"timeDomain": "threadTicks"})
            for number in range(args.repeats):
                before = tree_seconds(studio.process.pid)
                page.goto(studio.address if number == 0 else studio.address.partition("?")[0])
                while not page.evaluate("window.drawn ?? 0"):
                    time.sleep(0.05)
                server = tree_seconds(studio.process.pid) - before
                told = {one["name"]: one["value"] for one in session.send("Performance.getMetrics")["metrics"]}
                sizes = page.evaluate(
                    "performance.getEntriesByType('resource').filter(e => e.name.endsWith('/api/document'))"
                    ".map(e => [e.transferSize, e.decodedBodySize])[0]"
                )
                yield {
                    "opened": number + 1, "nodes": args.nodes, "drawn after, s": round(page.evaluate("drawn") / 1e3, 2),
                    "server, processor s": round(server, 2), "page, processor s": round(told["TaskDuration"], 2),
                    "document, kB sent": round(sizes[0] / 1e3), "kB": round(sizes[1] / 1e3),
                }  # fmt: skip
                time.sleep(1)
    finally:
        studio.end()


def large_graph(file: Path, count: int) -> Path:
    """The quickstart without its rounds, over and over, until it has `count` nodes."""
    from ruamel.yaml import YAML

    from exmesh_graph.graph.language.extends import load_merged
    from exmesh_graph.graph.problems import Problems
    from exmesh_graph.studio.values import plain

    def of_copy(value: Any, copy: int) -> Any:
        if isinstance(value, str) and value.startswith("@"):
            node, dot, port = value[1:].replace("rounds.", "start.").partition(".")
            return f"@{node}_{copy}{dot}{port}"
        return {key: of_copy(item, copy) for key, item in value.items()} if isinstance(value, dict) else value

    source = plain(load_merged(ROOT / "graphs" / "quickstart.yaml", Problems()))
    source["params"]["scene"] = str(ROOT / "graphs" / "samples" / "spot")
    parts = [(name, entry) for name, entry in source["nodes"].items() if "repeat" not in entry]
    nodes = {f"{name}_{k}": of_copy(entry, k) for k in range(1, count) for name, entry in parts[: max(1, count)]}
    kept = dict(list(nodes.items())[:count])
    YAML(typ="safe").dump({"name": "large", "params": source["params"], "nodes": kept}, file)
    return file


def watch(args: argparse.Namespace, folder: Path) -> Iterator[dict[str, Any]]:
    """A run that a page watches: the processor seconds of the server and the whole browser against what there was.

    A run that has the machine to itself loses at most their share of its cores' time. On a busy machine it takes
    longer: then their share of the run's own processor seconds tells more than that of the cores' time.
    """
    from tests.studio.browser import Studio, browser_page

    folder.mkdir(parents=True)
    sets = [word for text in args.sets for word in ("--set", text)]
    studio = Studio(args.graph.resolve(), 0, *sets, home=folder)
    try:
        with browser_page(motion="no-preference", options=PLAIN) as page:
            page.goto(studio.address)
            page.wait_for_selector(".plan:has-text('would run')")
            time.sleep(5)
            idle = spent(studio.process.pid)
            time.sleep(10)
            resting = [b - a for a, b in zip(idle, spent(studio.process.pid), strict=True)]
            yield {"nothing runs, for 10 s": "", **told(*resting, 10.0)}
            page.click("button.run")
            started: list[Path] = []
            while not started:
                time.sleep(0.2)
                started = list((folder / ".exmesh" / "studio" / "jobs").glob("*/started.json"))
            job = json.loads(started[0].read_text())
            run, runner, ran, state = folder / "runs" / job["run"], int(job["pid"]), 0.0, {}
            began, before = time.monotonic(), spent(studio.process.pid)
            while state.get("state", "unfinished") == "unfinished":  # its files say it: a question to the page is work
                time.sleep(0.5)
                ran = max(ran, tree_seconds(runner, ended=True))
                state = json.loads((run / "run.json").read_text())
            seconds = time.monotonic() - began
            shares = [b - a for a, b in zip(before, spent(studio.process.pid), strict=True)]
            lines = (run / "events.jsonl").read_text().count("\n")
            yield {
                "run of": args.graph.stem, "nodes": len(state["nodes"]), "state": state["state"], "events": lines,
                "run, processor s": round(ran, 1), "of the run's": f"{sum(shares) / ran:.2%}",
                **told(*shares, seconds),
            }  # fmt: skip
    finally:
        studio.end()


def told(server: float, browser: float, seconds: float) -> dict[str, Any]:
    """Processor seconds, and their share of all that the machine had."""
    cores = len(os.sched_getaffinity(0))
    return {
        "seconds": round(seconds, 1), "cores": cores, "server, processor s": round(server, 2),
        "browser, processor s": round(browser, 2), "server's share": f"{server / seconds / cores:.2%}",
        "both": f"{(server + browser) / seconds / cores:.2%}",
    }  # fmt: skip


def spent(server: int) -> tuple[float, float]:
    """Processor seconds so far of the server alone, and of the browser with all its processes.

    What Playwright uses to drive it is no part of it.
    """
    own, drivers = tree_seconds(server, children=False), [pid for pid in children_of(os.getpid()) if pid != server]
    return own, sum(tree_seconds(pid) for driver in drivers for pid in children_of(driver))


def tree_seconds(pid: int, children: bool = True, ended: bool = False) -> float:
    """Processor seconds of a process, and of those below it that live; with `ended` also of those that ended."""
    try:
        words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    own = sum(map(int, words[11 : 15 if ended else 13])) / os.sysconf("SC_CLK_TCK")
    return own + (sum(tree_seconds(child, True, ended) for child in children_of(pid)) if children else 0.0)


def children_of(pid: int) -> list[int]:
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            words = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(words[1]) == pid:
            found.append(int(path.parent.name))
    return found
