"""What this process runs on, and how much memory it has used."""

from __future__ import annotations

import contextlib
import getpass
import os
import platform
import resource
import sys
from pathlib import Path
from typing import Any

from exmesh_graph.version import __version__


def machine_facts() -> dict[str, Any]:
    """Versions and hardware of this process; looks at torch only where it is loaded already."""
    facts: dict[str, Any] = {
        "exmesh_graph": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "processor": _told("/proc/cpuinfo", "model name") or platform.processor(),
        "cpus": len(os.sched_getaffinity(0)),
        "memory_gib": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
    }
    torch = sys.modules.get("torch")
    if torch is not None and hasattr(torch, "__version__"):
        facts["torch"] = str(torch.__version__)
        if torch.cuda.is_available():
            facts["gpu"] = torch.cuda.get_device_name()
    return facts


def user_and_host() -> str:
    """`name@machine`, for records of what people decided."""
    try:
        name = getpass.getuser()
    except (OSError, KeyError):  # a user id without a name, as in some containers
        name = str(os.getuid())
    return f"{name}@{platform.node()}"


def reset_peak_memory() -> None:
    """Start a new peak for `peak_memory`, where the system allows it (Linux)."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def memory_in_use() -> int:
    """Resident bytes of this process now."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")


def peak_memory() -> int:
    """Peak resident bytes since `reset_peak_memory` (since the process began where that is not possible)."""
    peak = _told("/proc/self/status", "VmHWM")
    return int(peak.split()[0] if peak else resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) * 1024


def _told(file: str, label: str) -> str:
    """What a file of the kernel says under a label, in its first line of that name; nothing where there is none."""
    with contextlib.suppress(OSError), open(file, encoding="utf-8") as lines:
        for line in lines:
            if line.startswith(label):
                return line.partition(":")[2].strip()
    return ""
