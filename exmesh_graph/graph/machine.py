"""What this process runs on, and who runs it: for records."""

from __future__ import annotations

import getpass
import os
import platform
import sys
from typing import Any

from exmesh_graph.resources import told_by_kernel
from exmesh_graph.version import __version__


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


def user_and_host() -> str:
    """`name@machine`, for records of what people decided."""
    try:
        name = getpass.getuser()
    except (OSError, KeyError):  # a user id without a name, as in some containers
        name = str(os.getuid())
    return f"{name}@{platform.node()}"
