"""Pictures by Mitsuba 3: paths of up to five surface interactions, no Russian roulette, no denoising, box filter."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks import mitsuba_bsdf
from benchmarks.scenes.cameras import FIELD
from benchmarks.scenes.lights import lookup
from benchmarks.scenes.model import Model, decode

DEPTH = 6
#: Samples a pixel in one launch: bounds memory.
LAUNCH = 64
#: How far before the middle of the scene a lens is focused.
FOCUSED = 0.6


class Stage:
    """A model under a light. `background` shows the light behind it (alpha 1); `guest`, if any, is a black board
    (vertices [V, 3], faces [F, 3]) that can be moved from picture to picture. `aperture`: radius of the lens, which is
    focused on the nearer side of an object of radius 1 about the origin; 0: a pinhole."""

    def __init__(
        self, model: Model, *, background: bool, guest: bool = False, threads: int = 0, aperture: float = 0.0
    ) -> None:
        self.mi = mitsuba_bsdf.load(threads)
        self.model, self.background, self.aperture = model, background, aperture
        self.mesh = self._mesh(model)
        self.guest = self._board() if guest else None
        self.scenes: dict[tuple[str, int], Any] = {}

    def lit(self, name: str, light: np.ndarray, depth: int = DEPTH) -> Any:
        """The Mitsuba scene under the light, kept by its name."""
        if (name, depth) not in self.scenes:
            self.scenes[name, depth] = self.mi.load_dict(
                {
                    "type": "scene",
                    "integrator": {
                        "type": "path", "max_depth": depth, "rr_depth": 100, "hide_emitters": not self.background,
                    },
                    "sky": {
                        "type": "envmap",
                        "bitmap": self.mi.Bitmap(nodes(light)),
                        "to_world": self.mi.ScalarTransform4f([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]),
                    },
                    "mesh": self.mesh,
                    **({"guest": self.guest} if self.guest is not None else {}),
                }
            )  # fmt: skip
        return self.scenes[name, depth]

    def picture(self, scene: Any, pose: np.ndarray, size: int, samples: int, seed: int) -> np.ndarray:
        """float32 [size, size, 4]: linear colour, premultiplied, and coverage."""
        mi = self.mi
        turned = pose @ np.diag([-1.0, 1, -1, 1])  # Mitsuba's camera: x left, y up, looking along +z
        total, done, launch = np.zeros((size, size, 4)), 0, 0
        while done < samples:
            count = min(LAUNCH, samples - done)
            sensor = mi.load_dict(
                {
                    **self._lens(pose),
                    "fov": float(np.degrees(FIELD)),
                    "near_clip": 0.01,
                    "to_world": mi.ScalarTransform4f(turned.tolist()),
                    "film": {
                        "type": "hdrfilm", "width": size, "height": size, "pixel_format": "rgba",
                        "rfilter": {"type": "box"}, "component_format": "float32",
                    },
                    "sampler": {"type": "multijitter", "sample_count": count},
                }
            )  # fmt: skip
            part = mi.render(scene, sensor=sensor, spp=count, seed=(seed * 1000003 + launch * 7919) % 2**31)
            total += count * np.array(part, np.float64)
            done, launch = done + count, launch + 1
        total /= samples
        if self.background:
            total[..., 3] = 1
        return np.nan_to_num(total, posinf=0).clip(0).astype(np.float32)

    def _lens(self, pose: np.ndarray) -> dict[str, Any]:
        if not self.aperture:
            return {"type": "perspective"}
        near = float(np.linalg.norm(pose[:3, 3])) - FOCUSED
        return {"type": "thinlens", "aperture_radius": self.aperture, "focus_distance": near}

    def along(self, scene: Any, rays: np.ndarray, samples: int, seed: int) -> np.ndarray:
        """Radiance [N, 3] that comes along rays [N, 6], by `samples` paths each."""
        import drjit as dr

        mi = self.mi
        many = np.repeat(rays.astype(np.float32), samples, axis=0)
        ray = mi.RayDifferential3f(mi.Point3f(*many[:, :3].T.copy()), mi.Vector3f(*many[:, 3:].T.copy()))
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, len(many))
        value, _, _ = scene.integrator().sample(scene, sampler, ray)
        return np.array(dr.ravel(value)).reshape(len(rays), samples, 3).mean(1)

    def place_guest(self, vertices: np.ndarray) -> None:
        """Move the black board: float32 [8, 3], the corners of a box. Every scene that was lit must be lit again."""
        parameters = self.mi.traverse(self.guest)
        parameters["vertex_positions"] = vertices.astype(np.float32).ravel()
        parameters.update()
        self.scenes.clear()

    def _mesh(self, model: Model) -> Any:
        mi = self.mi

        def texture(values: np.ndarray) -> dict[str, Any]:
            values = np.ascontiguousarray(values if values.ndim == 3 else values[..., None], np.float32)
            return {"type": "bitmap", "bitmap": mi.Bitmap(values), "raw": True, "filter_type": "bilinear"}

        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict(
            {
                "type": "exmesh",
                "base": texture(decode(model.base / 255.0)),
                "roughness": texture(model.roughness / 255.0),
                "metallic": texture(model.metallic / 255.0),
            }
        )
        mesh = mi.Mesh("model", len(model.vertices), len(model.faces), properties, True, True)
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = model.vertices.ravel()
        parameters["vertex_normals"] = model.normals.ravel()
        parameters["vertex_texcoords"] = (model.uv * [1, -1] + [0, 1]).astype(np.float32).ravel()
        parameters["faces"] = model.faces.astype(np.uint32).ravel()
        parameters.update()
        return mesh

    def _board(self) -> Any:
        mi = self.mi
        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict({"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}})
        mesh = mi.Mesh("guest", 8, 12, properties, False, False)
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = (100 + np.indices((2, 2, 2)).reshape(3, -1).T).astype(np.float32).ravel()
        parameters["faces"] = BOX.astype(np.uint32).ravel()
        parameters.update()
        return mesh


#: Triangles of a box whose corner k has the bits of k as x, y, z.
BOX = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


def nodes(light: np.ndarray) -> np.ndarray:
    """The map on Mitsuba's nodes: row j of 2 H + 1 at v = j / (2 H), columns as ours; the same function between."""
    height = len(light)
    rows = np.clip(np.arange(2 * height + 1) / 2 - 0.5, 0, height - 1)
    low = np.minimum(rows.astype(int), height - 2)
    share = (rows - low)[:, None, None]
    return ((1 - share) * light[low] + share * light[low + 1]).astype(np.float32)


def environment_error(mi: Any, light: np.ndarray, count: int = 5000) -> float:
    """Largest difference of Mitsuba's lookup from `lights.lookup` over random directions, over the radiance there and
    the mean radiance together."""
    towards = np.random.default_rng(1).normal(size=(count, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    sky = mi.load_dict(
        {
            "type": "envmap", "bitmap": mi.Bitmap(nodes(light)),
            "to_world": mi.ScalarTransform4f([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]),
        }
    )  # fmt: skip
    interaction = mi.SurfaceInteraction3f()
    interaction.wi = -mi.Vector3f(*towards.T.astype(np.float32).copy())
    found = np.array(sky.eval(interaction)).T
    expected = lookup(light, towards)
    return float((np.abs(found - expected) / (expected + light.mean())).max())
