"""Calibrated photographs, the frame they live in, and the truth of a rendered scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

from exmesh_graph.errors import DataError
from exmesh_graph.types.artifact import ArrayArtifact, load_arrays, save_arrays
from exmesh_graph.types.pictures import Pictures

if TYPE_CHECKING:
    import numpy as np


@dataclass(frozen=True, eq=False)
class Views(ArrayArtifact):
    """N calibrated photographs of one size, in the normalised Y-up world (object inside the unit sphere).

    names            N file stems (unique where a loader made them)
    images           float32 [N, H, W, 3], linear RGB, premultiplied by alpha, background 0
    alpha            float32 [N, H, W], coverage in [0, 1] (all ones where a view has no mask)
    intrinsics       float64 [N, 3, 3], pixels; pixel centres at +0.5; principal point always kept
    camera_to_world  float64 [N, 4, 4], rigid, OpenCV camera axes (x right, y down, z forward)
    split            "train" or "test"
    has_masks        whether alpha was measured
    clipped          whether values above 1 were cut off in the files (8-bit photographs)

    Of a large set (`pictures.LARGE`) images and alpha are `Pictures`, stacks in files that decode one view when it is
    asked for: `views.images[i]` is an array in either case, `np.asarray(views.images)` all of them at once.
    """

    type_name: ClassVar[str] = "Views"
    conventions: ClassVar[Mapping[str, Any]] = {
        "camera": "opencv", "up": "y", "color": "linear", "units": "normalised",
    }  # fmt: skip
    layout: ClassVar[Mapping[str, str]] = {
        "images": "float32 N H W 3", "alpha": "float32 N H W", "intrinsics": "float64 N 3 3",
        "camera_to_world": "float64 N 4 4",
    }  # fmt: skip
    names: tuple[str, ...]
    images: np.ndarray | Pictures
    alpha: np.ndarray | Pictures
    intrinsics: np.ndarray
    camera_to_world: np.ndarray
    split: str
    has_masks: bool = True
    clipped: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_names(self, len(self.alpha))

    def __len__(self) -> int:
        return len(self.names)

    @property
    def height(self) -> int:
        return int(self.alpha.shape[1])

    @property
    def width(self) -> int:
        return int(self.alpha.shape[2])

    @property
    def world_to_camera(self) -> np.ndarray:
        """float64 [N, 4, 4], the inverse of `camera_to_world`."""
        import numpy as np

        try:
            return np.linalg.inv(self.camera_to_world)
        except np.linalg.LinAlgError:
            flat = [name for name, one in zip(self.names, self.camera_to_world, strict=True) if np.linalg.det(one) == 0]
            raise DataError("the camera cannot be inverted", where=", ".join(flat[:8]),
                            expected="camera_to_world: a rotation, a position, last row 0 0 0 1") from None  # fmt: skip

    @property
    def masked(self) -> np.ndarray:
        """bool [N], views whose mask is known: some may lack one where others have theirs (alpha is 1 all over)."""
        import numpy as np

        return np.array([self.has_masks and bool((alpha < 1).any()) for alpha in self.alpha], bool)

    @property
    def in_files(self) -> bool:
        """Whether pictures lie in files and are decoded when asked for."""
        return isinstance(self.images, Pictures) or isinstance(self.alpha, Pictures)

    @property
    def read_back(self) -> bool:
        return self.in_files

    def save(self, folder: Path) -> None:
        """As every ArrayArtifact; stacks in files become folders of their own."""
        kept = {name: getattr(self, name) for name in ("images", "alpha") if isinstance(getattr(self, name), Pictures)}
        super().save(folder)
        for name, stack in kept.items():
            stack.save(folder / name)

    @classmethod
    def stored(cls, folder: Path) -> dict[str, Any]:
        return super().stored(folder) | {
            name: Pictures.load(folder / name) for name in ("images", "alpha") if (folder / name).is_dir()
        }

    def subset(self, rows: Sequence[int] | np.ndarray) -> Self:
        """The views of these rows, in this order."""
        chosen = [int(row) for row in rows]
        arrays = {name: getattr(self, name)[chosen] for name in ("images", "alpha", "intrinsics", "camera_to_world")}
        return replace(self, names=tuple(self.names[row] for row in chosen), **arrays)

    def facets(self) -> dict[str, Any]:
        return {"split": self.split, "masks": self.has_masks}


@dataclass(frozen=True, eq=False)
class LitViews(Views):
    """Photographs that each have a measured light of their own, for scoring under it: never an input of a fit.

    environments  float32 [N, h, w, 3], canonical lat-long (types.EnvMap) in the normalised world
    """

    type_name: ClassVar[str] = "LitViews"
    layout: ClassVar[Mapping[str, str]] = {**Views.layout, "environments": "float32 N height width 3"}
    environments: np.ndarray | None = None  # a default only because fields of Views have some


@dataclass(frozen=True, eq=False)
class Frame(ArrayArtifact):
    """The recorded similarity between the normalised world and the scene's own units.

    scene_from_normalised  float64 [4, 4], maps normalised Y-up points to Y-up points in scene units
    dataset_from_scene     float64 [4, 4], the rotation back to the axes of the data set's files
    metres_per_unit        metres in one scene unit; 0 when unknown
    """

    type_name: ClassVar[str] = "Frame"
    layout: ClassVar[Mapping[str, str]] = {
        "scene_from_normalised": "float64 4 4", "dataset_from_scene": "float64 4 4",
    }  # fmt: skip
    scene_from_normalised: np.ndarray
    dataset_from_scene: np.ndarray
    metres_per_unit: float = 0.0

    def facets(self) -> dict[str, Any]:
        return {"metric": self.metres_per_unit > 0}


@dataclass(frozen=True, eq=False)
class DepthMaps(ArrayArtifact):
    """Depth along the camera's z axis, in normalised units, for the views of the same names.

    depth  float32 [N, H, W]; 0 = no measurement
    units  "normalised", or "relative": right up to a scale and a shift of each map, as networks give it
    """

    type_name: ClassVar[str] = "DepthMaps"
    conventions: ClassVar[Mapping[str, Any]] = {"depth": "z", "units": "normalised"}
    layout: ClassVar[Mapping[str, str]] = {"depth": "float32 N H W"}
    names: tuple[str, ...]
    depth: np.ndarray
    units: str = "normalised"

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_names(self, len(self.depth))

    def require_of(self, views: Views, where: str) -> None:
        """DataError naming `where` unless these are maps of `views`, in their order and size."""
        if tuple(self.names) != tuple(views.names) or self.depth.shape != views.alpha.shape:
            raise DataError(
                "the depth maps are not those of the views", where=where,
                expected=f"{len(views)} maps of {views.width} x {views.height}, names {views.names[0]} ...",
                fix="make them from these views, or load them for these views (prior.depth_files)",
            )  # fmt: skip

    def facets(self) -> dict[str, Any]:
        return {"units": self.units}


@dataclass(frozen=True, eq=False)
class Region(ArrayArtifact):
    """What counts in held-out views that have no masks: found in the data, the same for every result that is scored.

    names      the views it belongs to
    inside     bool [N, H, W], the pixels that count
    near, far  float32 [N, H, W], normalised units along the camera's z axis: between these depths lies the surface that
               such a pixel shows; what is elsewhere does not cover it. 0 outside
    source     "depth" (found by the photographs' own depth), "hull" (of the training views' masks) or "masks" (given
               for scoring only)
    """

    type_name: ClassVar[str] = "Region"
    conventions: ClassVar[Mapping[str, Any]] = {"depth": "z", "units": "normalised"}
    layout: ClassVar[Mapping[str, str]] = {
        "inside": "bool N H W", "near": "float32 N H W", "far": "float32 N H W",
    }  # fmt: skip
    names: tuple[str, ...]
    inside: np.ndarray
    near: np.ndarray
    far: np.ndarray
    source: str = "depth"

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_names(self, len(self.inside))


@dataclass(frozen=True, eq=False)
class SceneTruth(ArrayArtifact):
    """What is known of a rendered scene, for scoring only: never an input of a fit.

    mesh_vertices   float32 [V, 3] in the normalised Y-up world, or None;  mesh_faces int32 [F, 3]
    names           the M test views the maps below belong to
    albedo          float32 [M, H, W, 3] linear, averaged over the covered part of a pixel, or None
    roughness       float32 [M, H, W] or None
    depth           float32 [M, H, W] along the camera's z axis in normalised units, 0 where unknown, or None
    normal          float32 [M, H, W, 3], unit, OpenCV camera axes, 0 where unknown, or None
    environment     float32 [h, w, 3] canonical lat-long (types.EnvMap), the training light, or None
    relit           name -> (environment float32 [h, w, 3], images float32 [M, H, W, 3] linear premultiplied)
    relit_alpha     name -> float32 [M, H, W]
    """

    type_name: ClassVar[str] = "SceneTruth"
    layout: ClassVar[Mapping[str, str]] = {
        "mesh_vertices": "float32? V 3", "mesh_faces": "int32? F 3", "albedo": "float32? M H W 3",
        "roughness": "float32? M H W", "environment": "float32? height width 3", "depth": "float32? M H W",
        "normal": "float32? M H W 3",
    }  # fmt: skip
    names: tuple[str, ...]
    mesh_vertices: np.ndarray | None = None
    mesh_faces: np.ndarray | None = None
    albedo: np.ndarray | None = None
    roughness: np.ndarray | None = None
    environment: np.ndarray | None = None
    relit: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    relit_alpha: dict[str, np.ndarray] = field(default_factory=dict)
    depth: np.ndarray | None = None
    normal: np.ndarray | None = None

    def save(self, folder: Path) -> None:
        arrays = {name: getattr(self, name) for name in self.layout if getattr(self, name) is not None}
        for name, (environment, images) in self.relit.items():
            arrays[f"relit/{name}/environment"] = environment
            arrays[f"relit/{name}/images"] = images
            arrays[f"relit/{name}/alpha"] = self.relit_alpha[name]
        save_arrays(folder, arrays, {"names": list(self.names), "relit": sorted(self.relit)})

    @classmethod
    def load(cls, folder: Path) -> Self:
        arrays, meta = load_arrays(folder)
        relit = {name: (arrays[f"relit/{name}/environment"], arrays[f"relit/{name}/images"]) for name in meta["relit"]}
        return cls(
            names=tuple(meta["names"]),
            relit=relit,
            relit_alpha={name: arrays[f"relit/{name}/alpha"] for name in meta["relit"]},
            **{name: arrays.get(name) for name in cls.layout},
        )


def _check_names(value: Views | DepthMaps | Region, count: int) -> None:
    """DataError unless there is a name for each of the `count` views."""
    if len(value.names) != count:
        raise DataError(
            f"holds {len(value.names)} names", where=f"{type(value).__name__}.names",
            expected=f"one for each of the {count} views",
        )  # fmt: skip
