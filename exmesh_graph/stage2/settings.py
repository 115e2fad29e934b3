"""Settings of Stage II: where a fit starts, and the fit. Defaults are the paper's Table 1 where it gives a value."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, field_validator

from exmesh_graph.params import Auto, Params, Takes, param

if TYPE_CHECKING:
    from exmesh_graph.types import Asset


class StartSettings(Params):
    """Where a fit starts that knows no better (stage2.init)."""

    base_color: Literal["texture", "gray", "tint"] = param(
        "texture",
        doc="The Stage I texture, linearised (the paper); mid-gray; or one colour, the texture's mean at `level`, "
        "so that the light starts white.",
    )
    level: float = param(0.36, gt=0, lt=1, doc="Luminance of the base colour that `tint` starts from.")
    roughness: Annotated[float, Field(gt=0, lt=1), Auto("needs")] = param(
        0.5, doc="Neutral roughness; auto: low where the probe finds that a fit from 0.5 misses sharp reflections."
    )
    metallic: float = param(0.0, ge=0, le=1, doc="Metallic; above 0 only for fits with metallic: true.")
    above: float = param(
        0.0, ge=0, le=0.95, doc="How much brighter than on average the sky is straight above, and darker below."
    )
    key_light: Annotated[bool, Auto("needs"), Takes("transport")] = param(
        False,
        doc="Look in Stage I's texture for a sun, or a lamp that outshines all else, and start with it, whose shadows "
        "end in the base colour otherwise.",
    )
    light_moves: Annotated[Literal[False, "turntable", "camera"], Auto("needs"), Takes("views")] = param(
        False,
        doc="What the light moves with: nothing; as lamps beside a turntable, about the axis that level cameras stand "
        "around; with the camera in every way, as its own flash.",
    )


class FitSettings(Params):
    """What any fit of Stage II may be told."""

    material_rate: float = param(2.5e-3, gt=0, doc="Learning rate of the maps (logits).")
    environment_rate: float = param(1.5e-2, gt=0, doc="Learning rate of the environment (softplus parameters).")
    factor_rate: float = param(
        3e-3,
        ge=0,
        doc="Learning rate of the common factor of base colour and light (logarithm); 0 = left to the texels.",
    )
    rate_decay: float = param(0.1, gt=0, le=1, doc="Last learning rate over the first; exponential in between.")
    rates_for: int = param(
        0,
        ge=0,
        unit="iterations",
        doc="Length the rates suit: a longer fit takes them times the root of this over its own length, the factor's "
        "times this over it; 0: as they are.",
    )
    log_weight: float = param(1.0, ge=0, doc="lambda_log of eq. 21.")
    ssim_weight: float = param(
        0.2, ge=0, doc="lambda_ssim of eq. 21, for (1 - SSIM) / 2 as in Stage I; 0 leaves it out."
    )
    material_weight: float = param(0.1, ge=0, doc="lambda_mat: screen-space total variation of the maps.")
    variation: Literal["linear", "log"] = param(
        "linear",
        doc="Total variation of base colour itself (eq. 23) or of its logarithm, which has no say in how bright the "
        "light is: smoothing linear base colour darkens it, and the light makes up for that.",
    )
    gloss_weight: float = param(
        1.0, ge=0, doc="How much the variation of roughness and metallic counts against that of base colour."
    )
    environment_weight: float = param(0.1, ge=0, doc="lambda_env: total variation of the environment.")
    above_weight: float = param(
        0.0,
        ge=0,
        doc="Weight of the square of how much lower the light stands than that of skies and rooms, in deviations.",
    )
    level_weight: float = param(
        0.0,
        ge=0,
        doc="Weight of the square of how much brighter than usual base colours are on the whole, in deviations; the "
        "common factor alone follows it (not at factor_rate 0).",
    )
    chroma_weight: float = param(0.1, ge=0, doc="lambda_chroma at the start; falls linearly to 0.")
    indirect_weight: float = param(1.0, ge=0, doc="Target of lambda_ind, the weight of interreflection.")
    indirect_ramp: int = param(1000, ge=0, unit="iterations", doc="Iterations until lambda_ind is reached.")
    metal_weight: float = param(
        0.0,
        ge=0,
        doc="Weight of mean m (1 - m) over texels of metallic m: a surface is metal or none. From 0 in the second "
        "half of the steps, when the light is found, to all of it.",
    )
    metal_variation: float = param(
        1.0,
        ge=0,
        doc="How many times material_weight counts in a fit with a metallic map, whose texels have one thing more to "
        "decide.",
    )
    palette_width: float = param(
        0.0,
        ge=0,
        le=1,
        doc="Width, in the logarithm of base colour, within which colours are drawn to the paint that they gather "
        "about (mean shift): up to three times on the way, after which the light moves alone for a while, to explain "
        "what was shade and no paint; colours of metal within three times that; 0: each texel for itself.",
    )
    corrections: int = param(4, ge=0, le=100, doc="How often rays re-measure the specular term; 0 = never.")
    correction_samples: int = param(
        16,
        ge=1,
        le=1024,
        unit="rays",
        doc="Rays of a pixel each time, those of its neighbours counted as far as they tell.",
    )
    min_coverage: float = param(0.99, gt=0, le=1, doc="Mask alpha from which a pixel takes part.")
    roughness_min: float = param(0.08, ge=0.03, lt=0.5, doc="Lower end of the roughness map.")
    keep_light: bool = param(False, doc="Keep the environment of `start`, a known light, and fit the maps alone.")
    exposure: bool = param(False, doc="Fit one gain per view, for photographs of varying exposure.")
    memory_gib: float | Literal["auto"] = param(
        "auto",
        tuning=True,
        unit="GiB",
        doc="Memory that the views' buffers may take, the others are made anew at each visit; auto: half of what is "
        "free, 4 at least.",
    )

    @field_validator("memory_gib")
    @classmethod
    def _no_less_than_none(cls, value: float | Literal["auto"]) -> float | Literal["auto"]:
        if value != "auto" and not value >= 0:
            raise ValueError("memory_gib is 0 GiB or more, or auto")
        return value


class DecompositionSettings(FitSettings):
    """What the fit may be told (stage2.fit)."""

    texture_size: Annotated[int, Field(ge=0, le=8192), Auto("needs")] = param(
        0, unit="texels", doc="Side of the maps; 0 keeps the Stage I texture's."
    )
    environment_height: Annotated[int, Field(ge=8, le=1024), Auto("needs")] = param(
        256, unit="texels", doc="Rows of the recovered environment; twice as many columns."
    )
    iterations: int = param(10_000, ge=1, doc="Adam steps of one training view each.")
    light_first: Annotated[float, Field(ge=0, lt=1), Auto("needs")] = param(
        0.0,
        doc="Share of the steps, the first, that move the light alone, so that what differs from wall to wall is the "
        "light's first and the paint's after; no such steps under keep_light.",
    )
    glossy_first: float = param(
        0.0,
        ge=0,
        lt=1,
        doc="Share of the steps, the first, that begin from a roughness of 0.2 at most where a metallic map is fitted, "
        "so that the light is found by what mirrors it; then roughness begins again, as `start` has it, and the light "
        "waits for a tenth of the steps. No such steps without metal, nor under keep_light.",
    )
    metallic: Annotated[bool, Auto("needs")] = param(False, doc="Fit a metallic map, from `start`'s or 0.2.")
    metal_share: float = param(
        0.0,
        ge=0,
        lt=1,
        doc="Share of metal among texels of like colour, at half of the steps, from which those are metal that have "
        "some of it near; what lies among metal is metal as well. 0: each texel decides alone, as it should in a fit "
        "that goes on from another, whose texels have agreed.",
    )
    normal_map: bool = param(
        False, doc="Fit a tangent-space normal map (+Y up), from `start`'s or flat; the probe does not judge it."
    )

    @property
    def variation_weight(self) -> float:
        """Weight of the materials' variation in this fit."""
        return self.material_weight * (self.metal_variation if self.metallic else 1)


class RetouchSettings(FitSettings):
    """What a fit that goes on from a finished asset may be told (stage2.retouch): its light has been found, so that
    steps are shorter."""

    iterations: int = param(300, ge=0, doc="Adam steps of one training view each; 0: the asset stays as it is.")
    material_rate: float = param(0.1, gt=0, doc="Learning rate of the maps (logits).")
    environment_rate: float = param(0.2, gt=0, doc="Learning rate of the environment (softplus parameters).")
    factor_rate: float = param(
        0.01,
        ge=0,
        doc="Learning rate of the common factor of base colour and light (logarithm); 0 = left to the texels.",
    )

    def of(self, asset: Asset) -> DecompositionSettings:
        """The fit of these settings that models what the asset has, in maps and a sky of its sizes."""
        names = FitSettings.model_fields  # not in the key: which are shared
        shared = {name: getattr(self, name) for name in names}
        return DecompositionSettings(
            **shared, iterations=self.iterations, texture_size=len(asset.base_color),
            environment_height=len(asset.environment), metallic=asset.metallic is not None,
            normal_map=asset.normal is not None,
        )  # fmt: skip
