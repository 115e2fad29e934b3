"""Settings of the Stage II fit. Defaults are the paper's Table 1 where it gives a value."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FitSettings:
    """What `fit` may be told.

    texture_size      side of the maps in texels; 0 keeps the Stage I texture's
    environment_height  rows of the recovered map, half its columns
    iterations        Adam steps, one training view each
    material_rate, environment_rate  learning rates; `rate_decay` is the ratio of the last to the first
    factor_rate       learning rate of the factor that base colour and light share (stage2.common_factor); 0 = left out
    log_weight, ssim_weight  lambda_log, lambda_ssim of eq. 21
    material_weight, environment_weight, chroma_weight  lambda_mat, lambda_env, lambda_chroma^0 of eq. 22
    indirect_weight, indirect_ramp  lambda_ind's target and the iterations it takes to reach it
    metallic          fit a metallic map (starts at 0)
    normal_map        fit a tangent-space normal map (starts flat)
    corrections       how often rays measure what the split sum leaves out; 0 = never
    correction_samples  rays per pixel each time
    min_coverage      mask alpha from which a pixel takes part
    roughness_min     lower end of the roughness map
    keep_light        fit the maps alone, under the start's environment
    exposure          fit one gain per view (stage2.exposure)
    """

    texture_size: int = 0
    environment_height: int = 256
    iterations: int = 10_000
    material_rate: float = 2.5e-3
    environment_rate: float = 1.5e-2
    factor_rate: float = 3e-3
    rate_decay: float = 0.1
    log_weight: float = 1.0
    ssim_weight: float = 0.2
    material_weight: float = 0.1
    environment_weight: float = 0.1
    chroma_weight: float = 0.1
    indirect_weight: float = 1.0
    indirect_ramp: int = 1000
    metallic: bool = False
    normal_map: bool = False
    corrections: int = 4
    correction_samples: int = 16
    min_coverage: float = 0.99
    roughness_min: float = 0.08
    exposure: bool = False
    keep_light: bool = False
