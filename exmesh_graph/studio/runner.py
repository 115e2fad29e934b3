"""One run or sweep in a process of its own, which outlives the server: `python -m exmesh_graph.studio.runner JOB.json`.

It writes `started.json` with the run's id once there is a run folder, and `ended.json` with how it ended.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from exmesh_graph.errors import ExmeshError


def main(file: Path) -> int:
    """Do the job in a file. The exit code is that of `exmesh run`."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a server without a terminal may have it ignored
    signal.signal(signal.SIGTERM, _interrupt)
    job = json.loads(file.read_text(encoding="utf-8"))
    folder = file.parent

    def listen(event: Mapping[str, Any]) -> None:
        if event["event"] == "run_started":
            write(folder / "started.json", {"run": event["run"], "pid": os.getpid()})

    state, told, code = "done", {}, 0
    try:
        _work(job, listen)
    except KeyboardInterrupt:
        state, code = "interrupted", 130
    except ExmeshError as error:
        told = {"what": error.what, "where": error.where, "expected": error.expected, "fix": error.fix}
        state, code = "failed", 2 if error.code == "graph" else 1
    except Exception as error:
        told, state, code = {"what": f"{type(error).__name__}: {error}"}, "failed", 1
        raise
    finally:
        write(folder / "ended.json", {"state": state, "error": told})
    return code


def write(path: Path, value: Mapping[str, Any]) -> None:
    """Write a JSON file in one step."""
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    draft.write_text(json.dumps(value), encoding="utf-8")
    os.replace(draft, path)


def _work(job: Mapping[str, Any], listen: Any) -> None:
    common = {
        "set": job["set"], "nodes": job["nodes"], "store": job["store"], "shared": job["shared"], "runs": job["runs"],
        "workers": job["workers"], "keep_going": job["keep_going"], "progress": False, "listener": listen,
    }  # fmt: skip
    if job["kind"] == "sweep":
        from exmesh_graph.api.sweeps import sweep

        sweep(job["graph"], only=job["only"] or None, **common)
    else:
        from exmesh_graph.api.runs import run

        run(job["graph"], variant=job["variant"] or None, force=job["force"], start=job.get("start"), **common)


def _interrupt(signum: int, frame: Any) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
