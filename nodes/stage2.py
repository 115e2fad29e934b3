"""Stage II: UV-PBR decomposition on the frozen carrier."""

from typing import Annotated, Literal, NamedTuple

from exmesh_nodes.transport import LightModel
from pydantic import Field

from exmesh_graph.graph.declare.node import Context, facets, node
from exmesh_graph.params import Auto, Params, param
from exmesh_graph.types import Asset, Carrier, Metrics, SceneNeeds, Transport, Views, decided


class InitParams(Params):
    base_color: Literal["texture", "gray"] = param(
        "texture", doc="The Stage I texture, linearised (the paper), or mid-gray: better for short fits."
    )
    roughness: float = param(0.5, gt=0, lt=1, doc="Neutral roughness.")
    metallic: float = param(0.0, ge=0, le=1, doc="Metallic; above 0 only for fits with metallic: true.")


class InitOut(NamedTuple):
    asset: Asset


@node("stage2.init", version="1", libraries=("torch",))
def init(ctx: Context, carrier: Carrier, *, p: InitParams) -> InitOut:
    """Where stage2.fit starts: base colour from the Stage I texture or gray, the rest neutral, under white light."""
    from exmesh_graph.stage2.init import neutral_asset

    return InitOut(neutral_asset(carrier, p.base_color, p.roughness, p.metallic))


class FitParams(Params):
    texture_size: Annotated[int, Field(ge=0, le=8192), Auto("needs")] = param(
        0, unit="texels", doc="Side of the maps; 0 keeps the Stage I texture's."
    )
    environment_height: Annotated[int, Field(ge=8, le=1024), Auto("needs")] = param(
        256, unit="texels", doc="Rows of the recovered environment; twice as many columns."
    )
    iterations: int = param(10_000, ge=1, doc="Adam steps of one training view each.")
    material_rate: float = param(2.5e-3, gt=0, doc="Learning rate of the maps (logits).")
    environment_rate: float = param(1.5e-2, gt=0, doc="Learning rate of the environment (softplus parameters).")
    factor_rate: float = param(
        3e-3,
        ge=0,
        doc="Learning rate of the common factor of base colour and light (logarithm); 0 = left to the texels.",
    )
    rate_decay: float = param(0.1, gt=0, le=1, doc="Last learning rate over the first; exponential in between.")
    log_weight: float = param(1.0, ge=0, doc="lambda_log of eq. 21.")
    ssim_weight: float = param(0.2, ge=0, doc="lambda_ssim of eq. 21; 0 leaves the D-SSIM term out.")
    material_weight: float = param(0.1, ge=0, doc="lambda_mat: screen-space total variation of the maps.")
    environment_weight: float = param(0.1, ge=0, doc="lambda_env: total variation of the environment.")
    chroma_weight: float = param(0.1, ge=0, doc="lambda_chroma at the start; falls linearly to 0.")
    indirect_weight: float = param(1.0, ge=0, doc="Target of lambda_ind, the weight of interreflection.")
    indirect_ramp: int = param(1000, ge=0, unit="iterations", doc="Iterations until lambda_ind is reached.")
    metallic: Annotated[bool, Auto("needs")] = param(False, doc="Fit a metallic map, from `start`'s or 0.")
    normal_map: bool = param(
        False, doc="Fit a tangent-space normal map (+Y up), from `start`'s or flat; the probe does not judge it."
    )
    corrections: int = param(4, ge=0, le=100, doc="How often rays re-measure the specular term; 0 = never.")
    correction_samples: int = param(16, ge=1, le=1024, unit="rays", doc="Rays per pixel each time.")
    min_coverage: float = param(0.99, gt=0, le=1, doc="Mask alpha from which a pixel takes part.")
    roughness_min: float = param(0.08, ge=0.03, lt=0.5, doc="Lower end of the roughness map.")
    keep_light: bool = param(False, doc="Keep the environment of `start`, a known light, and fit the maps alone.")
    exposure: bool = param(False, doc="Fit one gain per view, for photographs of varying exposure.")
    memory_gib: float = param(
        4.0, ge=0, tuning=True, unit="GiB", doc="Memory that the views' buffers may take; the rest are made anew."
    )
    threads: int = param(1, ge=0, tuning=True, doc="torch CPU threads; 0 keeps the process's setting.")


class FitOut(NamedTuple):
    asset: Asset
    history: Metrics


@node(
    "stage2.fit",
    version="1",
    libraries=("torch", "embreex", "warp-lang", "scipy"),
    resumable=True,
    resources={"cpu": 0, "gpu?": 1},
)
def fit(
    ctx: Context,
    carrier: Carrier,
    views: Annotated[Views, facets(split="train")],
    transport: Transport | LightModel,
    start: Asset | None = None,
    needs: SceneNeeds | None = None,
    *,
    p: FitParams,
) -> FitOut:
    """Recover base colour, roughness and environment from the training views (paper, section 5).

    `start` is stage2.init's asset, which unwired stands for its defaults, or that of an earlier fit to go on from.
    """
    from exmesh_graph.gpu.torch_setup import torch_threads
    from exmesh_graph.graph.machine import memory_in_use
    from exmesh_graph.stage2.fit import fit as run
    from exmesh_graph.stage2.memory import plan_memory
    from exmesh_graph.stage2.settings import FitSettings

    def progress(step: int, total: int, figures: dict[str, float]) -> None:
        ctx.progress(step, total, **figures)

    given = p.model_dump(exclude={"threads", "memory_gib"})
    settings = FitSettings(**{name: decided(value, needs, name) for name, value in given.items()})
    precomputed = transport if isinstance(transport, Transport) else None
    plan = plan_memory(carrier, views, precomputed, settings, p.memory_gib * 2**30, memory_in_use())
    ctx.log(str(plan))
    with torch_threads(p.threads):
        asset, curves = run(
            carrier,
            views,
            transport if isinstance(transport, Transport) else transport.made(needs),
            settings,
            seed=ctx.seed,
            progress=progress,
            checkpoint=ctx.checkpoint,
            resumed=ctx.resume(),
            warn=ctx.warn,
            log=ctx.log,
            budget=p.memory_gib * 2**30,
            start=start,
        )
    # the plan depends on the process and on a tuning knob: it must not be in what the store keeps
    return FitOut(asset, Metrics({"curves": curves}))
