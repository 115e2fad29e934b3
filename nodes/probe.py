"""What a scene needs: short fits and measures of the mesh decide what is modelled."""

from typing import Annotated, NamedTuple

from exmesh_graph.gpu.settings import ALL_CORES, CoreSettings
from exmesh_graph.graph.declare.node import Context, facets, node
from exmesh_graph.params import param
from exmesh_graph.types import Carrier, Metrics, SceneNeeds, Views


class ProbeParams(CoreSettings):
    """What the probe looks at, and the cores that it may take."""

    thorough: bool = param(
        True,
        doc="Ask with two more fits of 500 steps whether the light should move alone at first (light_first), and look "
        "for a little metal with 36 views; false: it does not, and the look is a quick one with 16 views.",
    )


class ProbeOut(NamedTuple):
    needs: SceneNeeds
    decisions: Metrics


@node("scene.probe", version="3", libraries=("torch", "embreex", "warp-lang", "scipy"), resources=ALL_CORES)
def probe(
    ctx: Context, carrier: Carrier, views: Annotated[Views, facets(split="train")], *, p: ProbeParams
) -> ProbeOut:
    """Measure on a few coarse training views whether indirect light, a metallic map, finer maps or sky pay.

    `needs` decides parameters that are `auto`; `decisions` is the same for the report, with the seconds of steps.
    """
    from exmesh_graph.gpu.torch_setup import sharing
    from exmesh_graph.stage2.probe.scene import decision_rows, probe_scene

    with sharing(p.threads):
        probed = probe_scene(carrier, views, seed=ctx.seed, thorough=p.thorough, progress=ctx.progress)
    for name, decision in probed.needs.decisions.items():
        ctx.log(f"{name}: {decision.value}. {decision.reason}")
    return ProbeOut(probed.needs, Metrics(decision_rows(probed)))
