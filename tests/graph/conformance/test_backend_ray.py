"""What is Ray's own: a cluster of several machines, one of which is lost, and the command line."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.errors import ExmeshError
from exmesh_graph.graph.run.backends import Inline

TOY = Path(__file__).parent.parent / "toy"
ray = pytest.importorskip("ray", reason="Ray is not installed (pip install 'exmesh-graph[ray]')")
pytestmark = [pytest.mark.ray, pytest.mark.slow]
MEMORY = 80 * 2**20  # bytes of Ray's object store, which nothing of ours uses


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Three node processes of Ray: a head without cpus and two machines of one cpu each."""
    from ray.cluster_utils import Cluster

    if ray.is_initialized():  # that of another test
        ray.shutdown()
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(TOY), os.environ.get("PYTHONPATH", "")]))
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "object_store_memory": MEMORY})
    for name in ("left", "right"):
        made.add_node(num_cpus=1, object_store_memory=MEMORY, resources={name: 1})
    made.wait_for_nodes()
    yield made
    ray.shutdown()
    made.shutdown()


COUNT = """
nodes:
  a: {type: toy.const}
  n: {type: toy.count, number: "@a.number", steps: 150MORE}
  m: {type: toy.count, number: "@a.number", steps: 150, seed: 5MORE}
  z: {type: toy.who, number: "@a.number"}
"""


def killer(cluster: Any, trace: Path, kill: Any) -> threading.Thread:
    """Calls `kill` as soon as 30 steps are done."""

    def work() -> None:
        end = time.monotonic() + 60
        while time.monotonic() < end and (not trace.exists() or len(trace.read_text().split()) < 30):
            time.sleep(0.02)
        kill()

    thread = threading.Thread(target=work)
    thread.start()
    return thread


def kill_worker() -> None:
    """kill -9 of the Ray worker process of a task that counts."""
    import psutil

    for process in psutil.process_iter(["cmdline"]):
        if process.info["cmdline"] and process.info["cmdline"][0] == "ray::work":
            process.kill()
            return
    raise AssertionError("no Ray worker was found")


@pytest.mark.reliability("a Ray cluster of three node processes; one machine or one worker is killed mid-run",
                         "the run completes from checkpoints, with the bytes of an undisturbed one")  # fmt: skip
@pytest.mark.parametrize("what", ["machine", "worker"])
def test_a_lost_machine_or_worker_costs_only_the_steps_since_its_checkpoint(
    bench: Any, cluster: Any, tmp_path: Path, what: str
) -> None:
    from exmesh_graph.graph.run.backends.ray import RayCluster

    other = type(bench)(tmp_path / "other", bench.packs)
    whole = other.run(COUNT.replace("MORE", ""), backend=Inline(other.store))
    trace = tmp_path / "trace"
    text = COUNT.replace("MORE", f", seconds: 0.05, trace: {trace}")
    machine = next(iter(cluster.worker_nodes))
    kill = kill_worker if what == "worker" else lambda: cluster.remove_node(machine, allow_graceful=False)
    thread = killer(cluster, trace, kill)
    record = bench.run(text, backend=RayCluster(bench.store, cluster.address), checkpoint_every=0.0)
    thread.join()
    assert record["state"] == "done"
    for there, here in zip(whole["nodes"][:3], record["nodes"][:3], strict=True):
        assert there["outputs"] == here["outputs"]
    messages = [event.get("message", "") for event in bench.events]
    assert any("Ray lost its worker" in message for message in messages)
    assert any("goes on from the checkpoint at step" in message for message in messages)
    assert len(trace.read_text().split()) < 300 + 30  # of the lost steps at most a few were done again
    assert list(bench.store.verify()) == []


def test_a_wish_that_no_machine_can_meet_is_a_failed_node(bench: Any, cluster: Any) -> None:
    from exmesh_graph.graph.run.backends.ray import RayCluster
    from exmesh_graph.graph.run.runner import NodeFailed

    text = 'nodes: {a: {type: toy.const}, x: {type: toy.gpu, number: "@a.number"}}'
    with pytest.raises(NodeFailed, match=r"toy\.gpu asks for gpu=1"):
        bench.run(text, backend=RayCluster(bench.store, cluster.address))
    with pytest.raises(NodeFailed, match="which no machine of the Ray cluster has"):
        bench.run(text, backend=RayCluster(bench.store), tokens={"gpu": 1})


def test_no_cluster_at_an_address_is_said(bench: Any) -> None:
    from exmesh_graph.graph.run.backends.ray import RayCluster

    if ray.is_initialized():
        ray.shutdown()
    with pytest.raises(ExmeshError, match="ray start --head"):
        RayCluster(bench.store, "auto")


def test_the_command_line_runs_a_graph_on_a_ray_of_its_own(bench: Any) -> None:
    bench.write('nodes: {a: {type: toy.const, value: 2}, b: {type: toy.add, a: "@a.number", b: "@a.number"}}')
    path = os.pathsep.join([str(TOY), os.environ.get("PYTHONPATH", "")])
    words = ["run", "graph.yaml", "--backend", "ray", "--store", str(bench.store.root)]
    command = [sys.executable, "-c", "from exmesh_graph.cli import main; main()", *words]
    done = subprocess.run(
        command,
        cwd=bench.root,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=90,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "2 nodes, 0 from the store, 2 run" in done.stdout
    assert "ray" not in done.stderr.lower()
