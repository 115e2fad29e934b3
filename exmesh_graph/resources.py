"""What this machine offers, how much of it this process may use, and the memory that it does use."""

from __future__ import annotations

import contextlib
import os
import resource
import subprocess
from pathlib import Path

_granted = 0


def usable_cores() -> int:
    """The cores to use now: those of the process's affinity, or fewer where a run shares them with other nodes.

    A kernel that asks at each launch follows what the run grants while it works.
    """
    own = len(os.sched_getaffinity(0))
    return min(own, _granted) if _granted else own


def grant_cores(count: int) -> None:
    """Use `count` cores at most from now on; 0: all that the process may use."""
    global _granted
    _granted = count


def machine_tokens() -> dict[str, float]:
    """cpu (those this process may use), gpu (NVIDIA devices that are visible), ram_gb (physical)."""
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")  # not in the key: which GPU
    if visible is None:
        gpus = len(list(Path("/proc/driver/nvidia/gpus").glob("*")))
    else:
        gpus = len([word for word in visible.split(",") if word.strip() not in ("", "-1")])
    ram = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    return {"cpu": len(os.sched_getaffinity(0)), "gpu": gpus, "ram_gb": ram}


def gpu_memory() -> float:
    """Memory of all NVIDIA devices together in GB (10^9 bytes), 0 where nvidia-smi does not say."""
    words = ["nvidia-smi", "--query-gpu=memory.total", "--format=csv,noheader,nounits"]
    try:
        told = subprocess.run(words, capture_output=True, text=True, timeout=20, check=True).stdout
        return sum(float(line) for line in told.split()) * 2**20 / 1e9
    except (OSError, subprocess.SubprocessError, ValueError):
        return 0.0


def reset_peak_memory() -> None:
    """Start a new peak for `peak_memory`, where the system allows it (Linux)."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def memory_in_use() -> int:
    """Resident bytes of this process now."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")


def peak_memory() -> int:
    """Peak resident bytes since `reset_peak_memory` (since the process began where that is not possible)."""
    peak = told_by_kernel("/proc/self/status", "VmHWM")
    return int(peak.split()[0] if peak else resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) * 1024


def told_by_kernel(file: str, label: str) -> str:
    """What a file of the kernel says under a label, in its first line of that name; nothing where there is none."""
    with contextlib.suppress(OSError), open(file, encoding="utf-8") as lines:
        for line in lines:
            if line.startswith(label):
                return line.partition(":")[2].strip()
    return ""
