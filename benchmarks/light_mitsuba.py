"""Mitsuba 3 on the scene of the light benchmarks, with the paper's own BRDF.

Mitsuba's principled BSDF is another model (its diffuse lobe is Disney's, its Fresnel exact), so `exmesh` below is the
formula of `shading.brdf` written as a Mitsuba BSDF in Python; in the LLVM variant it is compiled into the same
kernels as the built-in ones. It is one-sided, samples q GGX (visible normals) + (1 - q) cosine, and reads vertex
attributes. Mitsuba's environment map has its nodes at other places than ours: row j of H' at v = j / (H' - 1). 2 H +
1 rows at the same width hold every kink of our bilinear map, so the resampled map below is the same function.
"""

from __future__ import annotations

import glob
import os
import re
from typing import Any

import numpy as np
import torch

from benchmarks.light_scene import EYE, FIELD, TARGET, Scene
from exmesh_graph.errors import MissingLibraryError
from exmesh_graph.shading import brdf, envmap


def load(threads: int) -> Any:
    """The `mitsuba` module in the variant llvm_ad_rgb with our BSDF and integrator registered."""
    found = glob.glob("/usr/lib/*/libLLVM*.so*")
    if found:  # Dr.Jit takes the first it meets; it needs 15 or newer
        newest = max(found, key=lambda name: [int(n) for n in re.findall(r"\d+", name)])
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", newest)
    try:
        import mitsuba as mi
    except ImportError as error:
        raise MissingLibraryError("this benchmark compares with Mitsuba 3", fix="pip install mitsuba") from error
    import drjit as dr

    mi.set_variant("llvm_ad_rgb")
    dr.set_thread_count(threads)
    _register(mi, dr)
    return mi


def scene_of(
    mi: Any,
    scene: Scene,
    *,
    spp: int,
    depth: int,
    specular: bool = True,
    integrator: str = "path",
    sampler: str = "independent",
) -> Any:
    """The Mitsuba scene: `depth` 2 is direct light, 3 adds one bounce. `specular` off leaves (1 - m) a / pi alone."""
    properties = mi.Properties()
    properties["brdf"] = mi.load_dict(
        {
            "type": "exmesh",
            "base": {"type": "mesh_attribute", "name": "vertex_base"},
            "roughness": {"type": "mesh_attribute", "name": "vertex_roughness"},
            "metallic": {"type": "mesh_attribute", "name": "vertex_metallic"},
            "specular": specular,
        }
    )
    mesh = mi.Mesh("mesh", len(scene.vertices), len(scene.faces), properties, False, False)
    attributes = scene.attributes.numpy()
    mesh.add_attribute("vertex_base", 3, attributes[:, :3].ravel())
    mesh.add_attribute("vertex_roughness", 1, attributes[:, 3])
    mesh.add_attribute("vertex_metallic", 1, attributes[:, 4] if scene.metallic else np.zeros(len(attributes)))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = scene.vertices.ravel()
    parameters["faces"] = scene.faces.ravel()
    parameters.update()
    side = {"width": scene.size, "height": scene.size}
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": integrator, "max_depth": depth, "rr_depth": 100, "hide_emitters": True},
            "sensor": {
                "type": "perspective",
                "fov": float(np.degrees(FIELD)),
                "to_world": mi.ScalarTransform4f().look_at(origin=EYE.tolist(), target=TARGET.tolist(), up=[0, 1, 0]),
                "film": {"type": "hdrfilm", **side, "rfilter": {"type": "box"}, "component_format": "float32"},
                "sampler": {"type": sampler, "sample_count": spp},
            },
            "sky": {"type": "envmap", "bitmap": mi.Bitmap(_nodes(scene.sky))},
            "mesh": mesh,
        }
    )


def _nodes(sky: torch.Tensor) -> np.ndarray:
    height, width = sky.shape[:2]
    v, u = torch.meshgrid(
        torch.arange(2 * height + 1, dtype=torch.float64) / (2 * height),
        (torch.arange(width, dtype=torch.float64) + 0.5) / width,
        indexing="ij",
    )
    index, weight = envmap.bilinear(height, width, u.reshape(-1), v.reshape(-1))
    values = (sky.double().reshape(-1, 3)[index] * weight[..., None]).sum(1)
    return values.reshape(2 * height + 1, width, 3).numpy().astype(np.float32)


def radiance(mi: Any, loaded: Any, scene: Scene, spp: int, seed: int) -> np.ndarray:
    """Radiance [N, 3] towards the eye at exactly the scene's points, by `spp` paths each."""
    import drjit as dr

    points = scene.points()
    direction = -points.view.repeat_interleave(spp, 0).numpy()
    rays = mi.RayDifferential3f(
        mi.Point3f(*[float(x) for x in EYE]), mi.Vector3f(direction[:, 0], direction[:, 1], direction[:, 2])
    )
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, len(direction))
    value, _, _ = loaded.integrator().sample(loaded, sampler, rays)
    return np.array(dr.ravel(value)).reshape(len(points), spp, 3).mean(1)


def _register(mi: Any, dr: Any) -> None:
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
            f0 = dr.lerp(mi.Spectrum(brdf.DIELECTRIC_F0), base, metallic)
            roughness = self.roughness.eval_1(si, active)
            alpha = dr.maximum(roughness * roughness, brdf.ALPHA_MIN)
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
            lit = (n_l > brdf.COSINE_MIN) & (n_v > brdf.COSINE_MIN)
            return dr.select(lit, value * n_l, 0)

        def _pdf(self, si: Any, wo: Any, alpha: Any, share: Any) -> Any:
            n_l, n_v = wo.z, dr.maximum(si.wi.z, brdf.COSINE_MIN)
            pdf = (1 - share) * n_l / dr.pi
            if self.specular:
                half = dr.normalize(si.wi + wo)
                a2 = alpha * alpha
                d = a2 + (1 - a2) * (half.x * half.x + half.y * half.y)
                smith = dr.sqrt(1 + a2 * (1 / (n_v * n_v) - 1))
                pdf += share * a2 / (dr.pi * d * d) / (2 * n_v * (1 + smith))
            return dr.select((n_l > brdf.COSINE_MIN) & (si.wi.z > 0), pdf, 0)

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
            active &= (si.wi.z > 0) & (wo.z > brdf.COSINE_MIN) & (pdf > 0)
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

    from mitsuba.python.ad.integrators.prb import PRBIntegrator

    class CentrePRB(PRBIntegrator):
        """Path replay backpropagation with all primary rays through the pixel centres."""

        def sample_rays(self, scene: Any, sensor: Any, sampler: Any) -> tuple:
            size = sensor.film().crop_size()
            index = dr.arange(mi.UInt32, dr.prod(size) * sampler.sample_count()) // sampler.sample_count()
            place = mi.Vector2f(mi.Float(index % size[0]), mi.Float(index // size[0]))
            where = (place + 0.5) / mi.Vector2f(mi.ScalarVector2f(size))
            ray, weight = sensor.sample_ray_differential(0.0, 0.0, where, mi.Vector2f(0))
            return ray, weight, place

    mi.register_integrator("prb_centre", lambda props: CentrePRB(props))
