"""The paper's BRDF as a BSDF of Mitsuba 3, whose own principled model is another one; nothing of the method is used.

f = (1 - m) a / pi + D G F / (4 (n.l)(n.v)): GGX of alpha = r^2, height-correlated Smith, Schlick from F0 = 0.04 (1 - m)
+ a m; one-sided; the diffuse part is not weighted by 1 - F. It samples q GGX (visible normals) + (1 - q) cosine.
"""

from __future__ import annotations

import glob
import os
import re
from typing import Any

ALPHA_MIN = 3.6e-4
COSINE_MIN = 1e-4
DIELECTRIC_F0 = 0.04


def load(threads: int = 0) -> Any:
    """The module `mitsuba` in the variant llvm_ad_rgb with the BSDF "exmesh" registered; 0 threads: all.

    Raises ImportError that says what to install."""
    found = glob.glob("/usr/lib/*/libLLVM*.so*")
    if found:  # Dr.Jit takes the first it meets; it needs 15 or newer
        newest = max(found, key=lambda name: [int(n) for n in re.findall(r"\d+", os.path.basename(name))])
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", newest)
    try:
        import mitsuba as mi

        mi.set_variant("llvm_ad_rgb")
        import drjit as dr
    except ImportError as error:
        raise ImportError(
            f"Mitsuba 3 cannot be used ({error}): pip install mitsuba; its LLVM variants want the system's LLVM, "
            "apt-get install libllvm19"
        ) from error
    if threads:
        dr.set_thread_count(threads)
    if not getattr(mi, "_exmesh_registered", False):
        register(mi, dr)
        mi._exmesh_registered = True
    return mi


def register(mi: Any, dr: Any) -> None:
    """Register the BSDF "exmesh": textures base, roughness, metallic; `specular` off leaves the diffuse part."""

    class ExmeshBSDF(mi.BSDF):
        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            self.base, self.roughness, self.metallic = props["base"], props["roughness"], props["metallic"]
            self.specular = props.get("specular", True)
            flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
            if self.specular:
                flags |= mi.BSDFFlags.GlossyReflection
            self.m_components = [flags]
            self.m_flags = flags

        def traverse(self, callback: Any) -> None:
            for name in ("base", "roughness", "metallic"):
                callback.put(name, getattr(self, name), mi.ParamFlags.Differentiable)

        def _material(self, si: Any, active: Any) -> tuple:
            base, metallic = self.base.eval(si, active), self.metallic.eval_1(si, active)
            f0 = dr.lerp(mi.Spectrum(DIELECTRIC_F0), base, metallic)
            roughness = self.roughness.eval_1(si, active)
            alpha = dr.maximum(roughness * roughness, ALPHA_MIN)
            return base * (1 - metallic), alpha, f0

        def _share(self, si: Any, diffuse: Any, f0: Any) -> Any:
            if not self.specular:
                return mi.Float(0)
            fresnel = f0 + (1 - f0) * (1 - dr.clip(si.wi.z, 0, 1)) ** 5
            glossy, scattered = dr.mean(fresnel), dr.mean(diffuse)
            return dr.detach(dr.clip(glossy / dr.maximum(glossy + scattered, 1e-9), 0.1, 0.9))

        def _value(self, si: Any, wo: Any, diffuse: Any, alpha: Any, f0: Any) -> Any:
            n_l, n_v = wo.z, si.wi.z
            value = diffuse / dr.pi
            if self.specular:
                half = dr.normalize(si.wi + wo)
                a2 = alpha * alpha
                d = a2 + (1 - a2) * (half.x * half.x + half.y * half.y)
                masked = n_l * dr.sqrt(a2 + (1 - a2) * n_v * n_v) + n_v * dr.sqrt(a2 + (1 - a2) * n_l * n_l)
                scale = a2 / (dr.pi * d * d) * 0.5 / masked
                value += scale * (f0 + (1 - f0) * (1 - dr.clip(dr.dot(si.wi, half), 0, 1)) ** 5)
            lit = (n_l > COSINE_MIN) & (n_v > COSINE_MIN)
            return dr.select(lit, value * n_l, 0)

        def _pdf(self, si: Any, wo: Any, alpha: Any, share: Any) -> Any:
            n_l, n_v = wo.z, dr.maximum(si.wi.z, COSINE_MIN)
            pdf = (1 - share) * n_l / dr.pi
            if self.specular:
                half = dr.normalize(si.wi + wo)
                a2 = alpha * alpha
                d = a2 + (1 - a2) * (half.x * half.x + half.y * half.y)
                smith = dr.sqrt(1 + a2 * (1 / (n_v * n_v) - 1))
                pdf += share * a2 / (dr.pi * d * d) / (2 * n_v * (1 + smith))
            return dr.select((n_l > COSINE_MIN) & (si.wi.z > 0), pdf, 0)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any) -> tuple:
            diffuse, alpha, f0 = self._material(si, active)
            share = self._share(si, diffuse, f0)
            wo = mi.warp.square_to_cosine_hemisphere(sample2)
            if self.specular:
                distribution = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, dr.detach(alpha), True)
                half, _ = distribution.sample(si.wi, sample2)
                wo = dr.select(sample1 < share, mi.reflect(si.wi, half), wo)
            wo = dr.detach(wo)
            pdf = dr.detach(self._pdf(si, wo, alpha, share))
            active &= (si.wi.z > 0) & (wo.z > COSINE_MIN) & (pdf > 0)
            sampled = mi.BSDFSample3f()
            sampled.wo, sampled.pdf, sampled.eta = wo, pdf, 1.0
            sampled.sampled_type, sampled.sampled_component = mi.UInt32(+self.m_flags), mi.UInt32(0)
            weight = self._value(si, wo, diffuse, alpha, f0) / pdf
            return sampled, dr.select(active, weight, 0)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any) -> Any:
            return dr.select(active, self._value(si, wo, *self._material(si, active)), 0)

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any) -> Any:
            diffuse, alpha, f0 = self._material(si, active)
            return dr.select(active, self._pdf(si, wo, alpha, self._share(si, diffuse, f0)), 0)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any) -> tuple:
            diffuse, alpha, f0 = self._material(si, active)
            pdf = self._pdf(si, wo, alpha, self._share(si, diffuse, f0))
            return dr.select(active, self._value(si, wo, diffuse, alpha, f0), 0), dr.select(active, pdf, 0)

        def eval_diffuse_reflectance(self, si: Any, active: Any) -> Any:
            return self.base.eval(si, active)

        def to_string(self) -> str:
            return "ExmeshBSDF[]"

    mi.register_bsdf("exmesh", ExmeshBSDF)
