"""The long nodes on the sample scene, killed with kill -9 at random times: the same digests in the end."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
GRAPH = f"""
name: cut
nodes:
  views: {{type: data.blender, path: {ROOT}/graphs/samples/spot, downscale: 4}}
  hull: {{type: init.visual_hull, views: "@views.train", resolution: 32}}
  start: {{type: stage1.init, carrier: "@hull.mesh", views: "@views.train"}}
  refine: {{type: stage1.refine, state: "@start.state", views: "@views.train", iterations: 500}}
"""
RUN = """
import sys
from pathlib import Path
from exmesh_graph.graph.run.backends.local import Local
from exmesh_graph.graph.language.check import check_file
from exmesh_graph.graph.declare.packs import load_packs
from exmesh_graph.graph.run.runner import Runner
from exmesh_graph.graph.run.rundir import RunFolder
from exmesh_graph.graph.cache.store import Store
folder = Path(sys.argv[1])
graph = check_file(folder / "g.yaml", [], load_packs())
runs = RunFolder(folder / "runs", "cut")
Runner(graph, Store(folder / "store"), runs, lambda event: None, backend=Local(1), checkpoint_every=0.05).run()
"""


def digests(folder: Path) -> dict[str, str]:
    record = json.loads((folder / "runs" / "latest" / "run.json").read_text())
    assert record["state"] == "done"
    return {row["name"]: {port: out["digest"] for port, out in row["outputs"].items()} for row in record["nodes"]}


@pytest.mark.slow
def test_refinement_killed_at_random_times_ends_with_the_same_bytes(tmp_path: Path) -> None:
    graph = GRAPH.replace("@hull.mesh", "@atlas.carrier").replace(
        "  start:", '  atlas: {type: uv.unwrap, mesh: "@hull.mesh", texture_size: 256}\n  start:'
    )
    kills = 0
    for name in ("whole", "cut"):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "g.yaml").write_text(graph)
        for _ in range(60):
            began = time.monotonic()
            words = [sys.executable, "-c", RUN, str(folder)]
            process = subprocess.Popen(words, env={**os.environ, "OMP_NUM_THREADS": "1"}, start_new_session=True)
            events = folder / "runs" / "latest" / "events.jsonl"
            old = events.resolve()
            while name == "cut" and process.poll() is None:
                time.sleep(0.05)
                refining = (
                    events.exists() and events.resolve() != old and '"node": "refine", "step"' in events.read_text()
                )
                if refining and kills < 4:
                    time.sleep(random.random())
                    process.kill()
                    kills += process.wait() == -signal.SIGKILL
                assert time.monotonic() < began + 120
            if process.wait() == 0:
                break
    assert kills >= 2
    assert digests(tmp_path / "cut") == digests(tmp_path / "whole")
    logs = "".join(p.read_text() for p in (tmp_path / "cut" / "runs").glob("2*/events.jsonl"))
    assert "goes on from the checkpoint at step" in logs
