"""What this machine offers, how much of it this process may use, and the memory that it does use; who uses it."""

from __future__ import annotations

import contextlib
import ctypes
import getpass
import os
import platform
import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from exmesh_graph.version import __version__

_CONTROL_GROUPS = Path("/sys/fs/cgroup")  # not in the key: for limits
_granted = 0


# not in the key: how much there is of this machine, for limits and records
def usable_cores() -> int:
    """The cores to use now: those of the process's affinity, or fewer where a run shares them with other nodes.

    A kernel that asks at each launch follows what the run grants while it works.
    """
    own = len(os.sched_getaffinity(0))
    return min(own, _granted) if _granted else own


def grant_cores(count: int) -> None:
    """Use `count` cores at most from now on; 0: all that the process may use."""
    global _granted  # not in the key: how many cores work
    _granted = count


# not in the key: how much there is of this machine, for limits and records
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
        # not in the key: how much memory there is
        told = subprocess.run(words, capture_output=True, text=True, timeout=20, check=True).stdout
        return sum(float(line) for line in told.split()) * 2**20 / 1e9
    except (OSError, subprocess.SubprocessError, ValueError):
        return 0.0


def reset_peak_memory() -> None:
    """Start a new peak for `peak_memory`, where the system allows it (Linux)."""
    with contextlib.suppress(OSError):
        # not in the key: for limits
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def return_memory() -> None:
    """Give what this process has freed back to the system, where the C library keeps it (glibc)."""
    with contextlib.suppress(OSError, AttributeError):
        # not in the key: for limits
        ctypes.CDLL(None).malloc_trim(0)


# not in the key: how much there is of this machine, for limits and records
def memory_in_use() -> int:
    """Resident bytes of this process now."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")


def memory_of(pid: int) -> int:
    """Resident bytes of a process and all below it now; 0 where it is gone."""
    import psutil

    size = 0
    with contextlib.suppress(psutil.Error):
        process = psutil.Process(pid)
        for one in (process, *process.children(recursive=True)):
            with contextlib.suppress(psutil.Error):  # ended meanwhile
                size += one.memory_info().rss
    return size


# not in the key: how much there is of this machine, for limits and records
def memory_to_spare() -> int:
    """Bytes that this process may still take: what the machine has free, or less where a control group limits it."""
    import psutil

    free = [int(psutil.virtual_memory().available)]
    for controller, group in _own_groups():
        most, used = ("limit_in_bytes", "usage_in_bytes") if controller else ("max", "current")
        with contextlib.suppress(OSError, ValueError):  # not there, or `max`: no limit
            limit, taken = (int((group / f"memory.{name}").read_text(encoding="ascii")) for name in (most, used))
            free.append(limit - taken)
    return max(min(free), 0)


# not in the key: how much there is of this machine, for limits and records
def _own_groups() -> Iterator[tuple[str, Path]]:
    """(controller, folder) of the control groups that may limit this process's memory; of version 2 without a name."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/cgroup").read_text(encoding="ascii").splitlines():
            _, controller, place = line.split(":", 2)
            if controller in ("", "memory"):
                yield controller, _CONTROL_GROUPS / controller / place.strip("/")


# not in the key: how much there is of this machine, for limits and records
def confine(pid: int, most: int) -> Path | None:
    """Put a process into a control group (Linux, v2 or v1) in which it and all it starts get `most` bytes of memory.

    The kernel ends what asks for more. Returns the group's folder, to be removed when it is empty; None where this
    system does not let us make one.
    """
    for controller, own in _own_groups():
        group = own / f"exmesh-{os.getpid()}-{pid}"
        with contextlib.suppress(OSError):
            group.mkdir()
            try:
                name = "memory.limit_in_bytes" if controller else "memory.max"
                with (group / name).open("r+", encoding="ascii") as file:  # not made: it is there or it is not
                    file.write(str(most))
                (group / "cgroup.procs").write_text(str(pid), encoding="ascii")
                return group
            except OSError:
                group.rmdir()
    return None


def was_overdrawn(group: Path) -> bool:
    """Whether the kernel ended a process of a control group for want of the memory that `confine` gave it."""
    counted = [told_by_kernel(str(group / name), "oom_kill ", " ") for name in ("memory.events", "memory.oom_control")]
    return any(count not in ("", "0") for count in counted)


# not in the key: how much there is of this machine, for limits and records
def peak_memory() -> int:
    """Peak resident bytes since `reset_peak_memory` (since the process began where that is not possible)."""
    peak = told_by_kernel("/proc/self/status", "VmHWM")
    return int(peak.split()[0] if peak else resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) * 1024


def told_by_kernel(file: str, label: str, sign: str = ":") -> str:
    """What a file of the kernel says behind a label and a sign, in its first line of that name; nothing without one."""
    with contextlib.suppress(OSError), open(file, encoding="utf-8") as lines:
        for line in lines:
            if line.startswith(label):
                return line.partition(sign)[2].strip()
    return ""


# not in the key: how much there is of this machine, for limits and records
def machine_facts() -> dict[str, Any]:
    """Versions and hardware of this process; looks at torch only where it is loaded already."""
    facts: dict[str, Any] = {
        "exmesh_graph": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "processor": told_by_kernel("/proc/cpuinfo", "model name") or platform.processor(),
        "cpus": len(os.sched_getaffinity(0)),
        "memory_gib": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
    }
    torch = sys.modules.get("torch")
    if torch is not None and hasattr(torch, "__version__"):
        facts["torch"] = str(torch.__version__)
        if torch.cuda.is_available():
            facts["gpu"] = torch.cuda.get_device_name()
    return facts


# not in the key: how much there is of this machine, for limits and records
def user_and_host() -> str:
    """`name@machine`, for records of what people decided."""
    try:
        name = getpass.getuser()  # not in the key: for records, which are no results
    except (OSError, KeyError):  # a user id without a name, as in some containers
        name = str(os.getuid())
    return f"{name}@{platform.node()}"  # not in the key: for records, which are no results
