"""Whether CUDA may be taken without being asked for: only where every operation has given there what the CPU gives.

The check runs once for each device, driver and version, in a process of its own, and its outcome is kept.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import warnings
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import torch

from exmesh_graph.version import __version__

_LIMIT_S = 300


@cache
def cuda_fault() -> str:
    """Why `device: auto` must not take CUDA here; empty where it may. Warns once where it may not."""
    kept = _kept()
    key = _machine()
    if key not in kept:
        kept[key] = run_check("cuda")
        _keep(kept)
    fault = faults_of(kept[key])
    if fault:
        warnings.warn(
            f"the GPU is not used: {fault}. Look with `exmesh doctor --gpu`; update the driver, torch or warp-lang, or "
            f"take it nevertheless with `device: cuda`",
            stacklevel=2,
        )
    return fault


def run_check(device: str) -> list[dict[str, Any]]:
    """The outcomes of `exmesh_graph.device_check` in a new process: operation, fault, seconds."""
    command = [sys.executable, "-m", "exmesh_graph.device_check", device]  # not in the key: as below
    try:
        # not in the key: this project's own check of the device
        done = subprocess.run(command, capture_output=True, text=True, timeout=_LIMIT_S, check=False)
        return list(json.loads(done.stdout.strip().splitlines()[-1]))
    except subprocess.TimeoutExpired:
        fault = f"the check did not end within {_LIMIT_S} s"
    except (OSError, ValueError, IndexError):
        last = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
        fault = f"the check broke off with {done.returncode} ({last})"
    return [{"operation": "the check itself", "fault": fault, "seconds": 0.0}]


def faults_of(outcomes: list[dict[str, Any]]) -> str:
    """The faults in one line; empty where there are none."""
    return "; ".join(f"{o['operation']}: {o['fault']}" for o in outcomes if o["fault"])


def remember(outcomes: list[dict[str, Any]]) -> None:
    """Keep the outcomes of a check of CUDA that somebody asked for."""
    _keep({**_kept(), _machine(): outcomes})
    cuda_fault.cache_clear()


def _machine() -> str:
    """Device, driver and versions that the outcome of a check holds for."""
    driver = Path("/proc/driver/nvidia/version")  # not in the key: which verdicts are known
    try:
        warp = version("warp-lang")  # not in the key: which verdicts are known
    except PackageNotFoundError:
        warp = "none"
    facts = [
        torch.cuda.get_device_name(), str(torch.version.cuda), torch.__version__, warp, __version__,
        driver.read_text(encoding="utf-8").splitlines()[0] if driver.is_file() else "unknown driver",
    ]  # fmt: skip
    return " | ".join(facts)


def _place() -> Path:
    # not in the key: a cache of what this machine can do
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "exmesh-graph" / "gpu.json"


def _kept() -> dict[str, list[dict[str, Any]]]:
    try:
        return dict(json.loads(_place().read_text(encoding="utf-8")))
    except (OSError, ValueError):
        return {}


def _keep(kept: dict[str, list[dict[str, Any]]]) -> None:
    place = _place()
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        draft = place.with_suffix(f".{os.getpid()}")  # not in the key: a draft's name
        draft.write_text(json.dumps(kept, indent=1), encoding="utf-8")
        os.replace(draft, place)
    except OSError:  # a read-only home: the check runs again in the next process
        return
