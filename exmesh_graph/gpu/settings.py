"""Where a node computes: the parameters that all of them share. Loads no torch."""

from __future__ import annotations

from typing import Any, Literal

from exmesh_graph.params import Params, param

ALL_CORES = {"cpu": 0}
"""What a node asks of the machine whose kernels take any number of cores."""

ON_DEVICE = ALL_CORES | {"gpu?": 1}
"""What a node with `DeviceSettings` asks of the machine: the GPU too, if there is one."""


class CoreSettings(Params):
    """Of `torch_setup.sharing`."""

    threads: int = param(0, ge=0, tuning=True, doc="CPU cores that kernels share; 0 takes all of this process.")


class DeviceSettings(CoreSettings):
    """Of `torch_setup.computing`."""

    device: Literal["auto", "cpu", "cuda"] = param(
        "auto", doc="Where to compute; auto takes a CUDA device if there is one."
    )


def loop_of(ctx: Any) -> dict[str, Any]:
    """What a solver's loop takes of its node's context: the seed, progress, and where to stop and go on."""
    return {"seed": ctx.seed, "progress": ctx.progress, "checkpoint": ctx.checkpoint, "resumed": ctx.resume()}
