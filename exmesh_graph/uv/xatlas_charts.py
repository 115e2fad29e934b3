"""xatlas in a process of its own, ended when its time is up: some meshes take it minutes, some for ever."""

from __future__ import annotations

import os
import subprocess
import sys
from io import BytesIO

import numpy as np

from exmesh_graph.uv.settings import XatlasSettings

_RESOLUTION = 1024  # of xatlas's own packing, which is thrown away: charts do not depend on the texture's size
_CHILD = "import sys; sys.path[:] = {path!r}; from exmesh_graph.uv.xatlas_charts import _serve; _serve()"


def xatlas_charts(
    points: np.ndarray, faces: np.ndarray, settings: XatlasSettings
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | str:
    """Charts by xatlas: (flat float64 [T, 2] in the unit of `points`, corners int64 [F, 3], uncharted bool [F]).

    points  float64 [V, 3] with a mean face area of 1: xatlas compares areas with an absolute 1e-7
    What went wrong, in words, if xatlas was not done after `max_seconds`, or its process died.
    """
    # not in the key: where this module, which is in the key, is found again
    code = _CHILD.format(path=[entry or os.getcwd() for entry in sys.path])
    options = [settings.max_cost, settings.chart_iterations]
    given = BytesIO()
    np.savez(given, points=points.astype(np.float32), faces=faces.astype(np.uint32), o=options)
    try:
        done = subprocess.run(  # not in the key: this module
            # not in the key: this Python
            [sys.executable, "-c", code],
            input=given.getvalue(),
            capture_output=True,
            timeout=settings.max_seconds,
        )
    except subprocess.TimeoutExpired:
        return f"xatlas was not done after {settings.max_seconds:g} s"
    if done.returncode != 0:
        last = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or ["no message"]
        return f"the process of xatlas ended with status {done.returncode} ({last[0]})"
    with np.load(BytesIO(done.stdout)) as answer:
        return answer["flat"], answer["corners"], answer["uncharted"]


def _serve() -> None:
    """The child: arrays on standard input, charts on standard output."""
    import xatlas

    with np.load(BytesIO(sys.stdin.buffer.read())) as given:  # not in the key: what this module sent
        points, faces, (max_cost, max_iterations) = given["points"], given["faces"], given["o"]
    atlas = xatlas.Atlas()
    atlas.add_mesh(points, faces)
    chart_options = xatlas.ChartOptions()
    chart_options.max_cost, chart_options.max_iterations = float(max_cost), int(max_iterations)
    pack_options = xatlas.PackOptions()
    # It turns charts by swapping u and v, which mirrors about half of them.
    pack_options.rotate_charts, pack_options.resolution = False, _RESOLUTION
    atlas.generate(chart_options, pack_options)
    _, corners, flat = atlas.get_mesh(0)
    flat = flat.astype(np.float64) * [atlas.width, atlas.height] / atlas.texels_per_unit
    corners = corners.astype(np.int64)
    uncharted = np.asarray(atlas.get_mesh_vertex_assignment(0)[0])[corners].min(axis=1) < 0
    answer = BytesIO()
    np.savez(answer, flat=flat, corners=corners, uncharted=uncharted)
    sys.stdout.buffer.write(answer.getvalue())
