"""Is a finished asset worse than the Stage I texture that it began with, on the same held-out views, and why?"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from exmesh_graph.types import Asset

#: A fall counts from this many standard errors of the views' paired differences on, and from this many dB.
SIGMAS, LEAST = 2.0, 0.1


def set_beside(values: Mapping[str, Any], before: Mapping[str, Any], asset: Asset) -> dict[str, Any]:
    """What became of the held-out PSNR: `values` of evaluate.asset beside those of evaluate.stage1, `before`.

    gain       mean difference over the views that both scored [dB]; `error`, its standard error (0 for one view)
    worse      whether it fell by more than noise; `warning` then says so, with the likely cause
    Empty where no view was scored by both, or where they were exposed by different rules.
    """
    ours, theirs = values["held_out"], before["held_out"]
    now, then = ours["psnr_per_view"], theirs["psnr_per_view"]
    both = [name for name in now if name in then]
    if not both or ours.get("exposure") != theirs.get("exposure"):
        return {}
    # where Stage I's colours change with the direction, the asset began with the texture that was baked from them
    baked = theirs.get("psnr_baked", theirs["psnr"]) - theirs["psnr"]
    apart = np.array([now[name] - then[name] - baked for name in both])
    gain, error = float(apart.mean()), 0.0
    if len(both) > 1:
        error = float(apart.std(ddof=1) / math.sqrt(len(both)))
    worse = gain < -max(SIGMAS * error, LEAST)
    found: dict[str, Any] = {"gain": gain, "error": error, "views": len(both), "worse": worse}
    if worse:
        lost = (
            f"the asset is {-gain:.2f} dB below Stage I's texture on {len(both)} held-out views (error {error:.2f} dB)"
        )
        found["warning"] = f"{lost}: {_why(asset)}"
    return found


def _why(asset: Asset) -> str:
    maps, texture = asset.base_color.shape[0], asset.texture.shape[0]
    if maps < texture:
        return (
            f"its maps have {maps} texels a side, the texture {texture}; texture_size: auto of stage2.fit lets the "
            "pixels decide"
        )
    return (
        "its maps are as fine as the texture, so that the light is not explained: shadows finer than the transport "
        "(more `points` and `directions` of transport.direct), a light that moved with the camera or varied "
        "(`exposure` of stage2.fit), or interreflection left out (`bounces` of transport.bounce)"
    )
