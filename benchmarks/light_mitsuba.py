"""Mitsuba 3 on the scene of the light benchmarks, with the paper's own BRDF.

Mitsuba's principled BSDF is another model (its diffuse lobe is Disney's, its Fresnel exact), so `mitsuba_bsdf` is the
formula of `shading.brdf` written as a Mitsuba BSDF in Python; in the LLVM variant it is compiled into the same
kernels as the built-in ones. Here it reads vertex attributes. Mitsuba's environment map has its nodes at other places
than ours: row j of H' at v = j / (H' - 1). 2 H + 1 rows at the same width hold every kink of our bilinear map, so the
resampled map below is the same function.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from benchmarks import mitsuba_bsdf
from benchmarks.light_scene import EYE, FIELD, TARGET, Scene
from exmesh_graph.errors import MissingLibraryError
from exmesh_graph.shading import envmap


def load(threads: int) -> Any:
    """The `mitsuba` module in the variant llvm_ad_rgb with our BSDF and integrator registered."""
    try:
        mi = mitsuba_bsdf.load(threads)
    except ImportError as error:
        raise MissingLibraryError("this benchmark compares with Mitsuba 3", fix=str(error)) from error
    _register(mi)
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


def _register(mi: Any) -> None:
    import drjit as dr
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
