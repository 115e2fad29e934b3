# Made by `exmesh stubs` from the node types; edits are lost.
"""Node types by family: `g.nodes.init.visual_hull(views=views.train)`."""

from os import PathLike
from typing import Any, Literal

from exmesh_graph.api.scope import NodeScope
from exmesh_graph.api.values import Node, Parameter, Plug, Wire
from exmesh_graph.types.asset import Asset, EnvMap
from exmesh_graph.types.gaussians import PlanarGaussians, PointCloud
from exmesh_graph.types.mesh import Carrier, Mesh, Stage1State
from exmesh_graph.types.needs import SceneNeeds
from exmesh_graph.types.results import Files, Gallery, GltfAsset, Metrics, ObjAsset, ScoredViews, UsdAsset
from exmesh_graph.types.transport import Transport
from exmesh_graph.types.views import DepthMaps, Frame, LitViews, Region, SceneTruth, Views
from exmesh_nodes.appearance import Appearance
from exmesh_nodes.regulariser import Smoothness
from exmesh_nodes.stage2 import MaterialPrior
from exmesh_nodes.transport import MonteCarlo
class MetricsNode(Node):
    metrics: Wire[Metrics]
class MetricsScoredNode(Node):
    metrics: Wire[Metrics]
    scored: Wire[ScoredViews]
class TrainTestFrameTruthNode(Node):
    train: Wire[Views]
    test: Wire[Views]
    frame: Wire[Frame]
    truth: Wire[SceneTruth]
class LightNode(Node):
    light: Wire[EnvMap]
class TrainTestFrameNode(Node):
    train: Wire[Views]
    test: Wire[Views]
    frame: Wire[Frame]
class TrainTestFramePointsCamerasNode(Node):
    train: Wire[Views]
    test: Wire[Views]
    frame: Wire[Frame]
    points: Wire[PointCloud]
    cameras: Wire[Metrics]
class TrainTestFrameTruthNovelNode(Node):
    train: Wire[Views]
    test: Wire[Views]
    frame: Wire[Frame]
    truth: Wire[SceneTruth]
    novel: Wire[LitViews]
class FilesNode(Node):
    files: Wire[UsdAsset]
class AssetGalleryNode(Node):
    asset: Wire[Asset]
    gallery: Wire[Gallery]
class FilmNode(Node):
    film: Wire[Gallery]
class RegionNode(Node):
    region: Wire[Region]
class FilesNode2(Node):
    files: Wire[Files]
class FilesNode3(Node):
    files: Wire[GltfAsset]
class AssetNode(Node):
    asset: Wire[Asset]
class FilesNode4(Node):
    files: Wire[ObjAsset]
class GalleryNode(Node):
    gallery: Wire[Gallery]
class MeshDecisionsNode(Node):
    mesh: Wire[Mesh]
    decisions: Wire[Metrics]
class MeshNode(Node):
    mesh: Wire[Mesh]
class GaussiansNode(Node):
    gaussians: Wire[PlanarGaussians]
class GaussiansHistoryNode(Node):
    gaussians: Wire[PlanarGaussians]
    history: Wire[Metrics]
class TrainDecisionsDepthsGroundNode(Node):
    train: Wire[Views]
    decisions: Wire[Metrics]
    depths: Wire[DepthMaps]
    ground: Wire[Mesh]
class ViewsNode(Node):
    views: Wire[Views]
class StateNode(Node):
    state: Wire[Stage1State]
class DepthsNode(Node):
    depths: Wire[DepthMaps]
class NeedsDecisionsNode(Node):
    needs: Wire[SceneNeeds]
    decisions: Wire[Metrics]
class ViewsDecisionsNode(Node):
    views: Wire[Views]
    decisions: Wire[Metrics]
class StateHistoryNode(Node):
    state: Wire[Stage1State]
    history: Wire[Metrics]
class AssetHistoryNode(Node):
    asset: Wire[Asset]
    history: Wire[Metrics]
class TransportNode(Node):
    transport: Wire[Transport]
class CarrierNode(Node):
    carrier: Wire[Carrier]
class Family:
    def __init__(self, scope: NodeScope, family: str) -> None: ...
    def __getattr__(self, name: str) -> Any: ...
class _Appearance(Family):
    def auto(self, name: str = "", *, gloss: float | Parameter = 0.25) -> Node:
        """The texture alone; where parts of the object change their brightness much with the direction of view, as gloss

        gloss: Robust deviation of a part's brightness between views from which on it is much. [stops, >= 0]
        """
    def directional(self, name: str = "", *, order: Literal[1, 2] | Parameter = 2, shrinkage: float | Parameter = 0.1, rate: float | Parameter = 1.0) -> Node:
        """The texture, and on each vertex a small residual that is a low harmonic of the direction of view, for gloss and

        order: Highest order of the spherical harmonics: 3 or 8 functions.
        shrinkage: Weight of the residual's mean square. [>= 0]
        rate: Step of the residual over that of a texel. [> 0, <= 100]
        """
    def mlp(self, name: str = "", *, frequencies: int | Parameter = 6, width: int | Parameter = 64) -> Node:
        """A small network from place to colour (positional encoding, three layers); the texture is baked from it.

        frequencies: Of the positional encoding; the first spans the object. [octaves, >= 0, <= 12]
        width: Of the two hidden layers. [units, >= 4, <= 512]
        """
    def per_face(self, name: str = "") -> Node:
        """One colour per face; parts of a split face keep it, and the texture is baked from it."""
    def per_vertex(self, name: str = "") -> Node:
        """One colour per vertex, interpolated over the faces; splits interpolate it, and the texture is baked from it."""
    def uv_texture(self, name: str = "") -> Node:
        """The paper's RGB texture over the UV atlas; the default."""
class _Benchmark(Family):
    def dtu(self, name: str = "", *, mesh: Wire[Mesh] | Node, frame: Wire[Frame] | Node, folder: str | PathLike[str] | Parameter, scan: int | Parameter, train: Wire[Views] | Node | None = None, test: Wire[Views] | Node | None = None, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> MetricsNode:
        """DTU's Chamfer distance in mm, unculled and, with views that have masks, culled by 2DGS's rule.

        folder: DTU's evaluation data: Points/stl/ and ObsMask/.
        scan: Number of the scan. [>= 1]
        """
    def nerf_synthetic(self, name: str = "", *, mesh: Wire[Mesh] | Node, truth: Wire[SceneTruth] | Node, views: Wire[Views] | Node, frame: Wire[Frame] | Node, scene: str | Parameter = "", samples: int | Parameter = 100000, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> MetricsNode:
        """Chamfer distance on what the test cameras see and on the whole surface, in thousandths of a Blender unit.

        scene: The scene's name in the table.
        samples: Points on each surface, and rays from the test cameras. [>= 100]
        """
    def speed(self, name: str = "", *, asset: Wire[Asset] | Node, views: Wire[Views] | Node, directions: int | Parameter = 256, bounces: int | Parameter = 8, supersampling: int | Parameter = 1, specular_samples: int | Parameter = 8, size: int | Parameter = 1600, frames: int | Parameter = 4, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> MetricsNode:
        """Relighting frames per second by the paper's rule, vertices, and the mesh's size as PLY.

        directions: Directions per surface point of the light transport. [>= 32]
        bounces: Interreflections in the scored renders. [>= 0, <= 16]
        supersampling: Antialiasing. [samples per pixel side, >= 1, <= 8]
        specular_samples: GGX rays per sample of a pixel. [>= 1]
        size: Side of the rendered pictures; the paper's is 1600. [px, >= 16, <= 4096]
        frames: Frames; the first is a warm-up and not counted. [>= 2]
        """
    def stanford_orb(self, name: str = "", *, asset: Wire[Asset] | Node, views: Wire[Views] | Node, novel: Wire[LitViews] | Node, truth: Wire[SceneTruth] | Node, frame: Wire[Frame] | Node, directions: int | Parameter = 256, bounces: int | Parameter = 8, supersampling: int | Parameter = 2, specular_samples: int | Parameter = 12, max_views: int | Parameter = 0, lpips: str | PathLike[str] | None | Parameter = None, scene: str | Parameter = "", seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> MetricsNode:
        """Stanford-ORB's PSNR-H, PSNR-L and SSIM in new views and under new lights; depth, normal, shape, albedo.

        directions: Directions per surface point of the light transport. [>= 32]
        bounces: Interreflections in the scored renders. [>= 0, <= 16]
        supersampling: Antialiasing. [samples per pixel side, >= 1, <= 8]
        specular_samples: GGX rays per sample of a pixel. [>= 1]
        max_views: Score this many views, evenly spread; 0: all. [>= 0]
        lpips: LPIPS's weights, a safetensors file (docs/metrics.md); none: left out.
        scene: The scene's name in the table.
        """
    def synthetic4relight(self, name: str = "", *, asset: Wire[Asset] | Node, views: Wire[Views] | Node, truth: Wire[SceneTruth] | Node, train: Wire[Views] | Node | None = None, directions: int | Parameter = 256, bounces: int | Parameter = 8, supersampling: int | Parameter = 2, specular_samples: int | Parameter = 12, max_views: int | Parameter = 0, lpips: str | PathLike[str] | None | Parameter = None, scene: str | Parameter = "", rule: Literal["median", "median_red", "mean", "none", "least_squares", "sampled_median", "sampled_red"] | Parameter = "median", pictures: int | Parameter = 3, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> MetricsScoredNode:
        """New views, relit views, albedo by every published rule, roughness; what `evaluate.asset` gives as well.

        directions: Directions per surface point of the light transport. [>= 32]
        bounces: Interreflections in the scored renders. [>= 0, <= 16]
        supersampling: Antialiasing. [samples per pixel side, >= 1, <= 8]
        specular_samples: GGX rays per sample of a pixel. [>= 1]
        max_views: Score this many views, evenly spread; 0: all. [>= 0]
        lpips: LPIPS's weights, a safetensors file (docs/metrics.md); none: left out.
        scene: The scene's name in the table.
        rule: How the albedo's scale is found, which relit pictures get too (docs/metrics.md).
        pictures: Held-out views handed on for pictures (gallery.asset). [>= 0]
        """
class _Data(Family):
    def blender(self, name: str = "", *, path: str | PathLike[str] | Parameter, train_side: int | Parameter = 0, train_megapixels: float | Parameter = 0.0, hdr: Literal["auto", "true", "false"] | bool | Parameter = "auto", downscale: int | Parameter = 1, max_views: int | Parameter = 0, max_test_views: int | Parameter = 0, test: Literal["auto", "file", "holdout"] | Parameter = "auto", holdout: int | Parameter = 8, min_test_views: int | Parameter = 2, up: Literal["y", "-y", "z", "-z", "x", "-x", "auto"] | Parameter = "z", truth: bool | Parameter = True, true_mesh: str | Parameter = "", wrong_masks: int | Parameter = 0, box: tuple[tuple[float, ...] | list[float], ...] | list[tuple[float, ...] | list[float]] | None | Parameter = None, metres_per_unit: float | Parameter = 0.0, key: bool | Parameter = True, checks: Literal["error", "warn", "off"] | Parameter = "error", seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> TrainTestFrameTruthNode:
        """Photographs in the Blender / NeRF-Synthetic layout, with the truth of rendered scenes.

        path: Folder with transforms_train.json (or transforms.json).
        train_side: Longer side of the training pictures at most: all are reduced by one whole factor, test pictures are not. 0: as they are. [px, >= 0]
        train_megapixels: Of all training pictures together at most, by such a factor; 0: no limit. [Mpx, >= 0]
        hdr: Linear EXR pictures where they are there (auto), always (true), or 8-bit ones (false).
        downscale: Reduce by this factor, by exact area averaging in linear light. [>= 1, <= 16]
        max_views: Keep at most so many training views, evenly spread; 0 = all. [views, >= 0]
        max_test_views: Keep at most so many test views; 0 = all. [views, >= 0]
        test: Test views: the file's own if it has enough (auto), always the file's, or held-out training views.
        holdout: Every how many training views one is held out, where needed. [views, >= 2]
        min_test_views: Fewer test frames than this count as none (auto). [views, >= 1]
        up: The up axis of the files' world; auto: found from level cameras.
        truth: Read true mesh, maps, light and relit pictures where they are there.
        true_mesh: The true mesh, a file below the folder, as of the object without its table; empty: mesh/mesh.obj.
        wrong_masks: Masks that may be wrong at a point, for normalisation. [views, >= 0]
        box: The object's box in the files' units; default: found from the masks.
        metres_per_unit: Metres in one unit of the files; 0 = unknown. [m, >= 0]
        key: Pictures without alpha or masks that stand on one flat colour: what differs from it is the object.
        checks: Grave faults of cameras and pictures: an error, a warning, or not looked for (off).
        """
    def environment(self, name: str = "", *, path: str | PathLike[str] | Parameter, convention: Literal["openexr", "blender"] | Parameter = "openexr", seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> LightNode:
        """A lat-long environment map.

        path: Lat-long picture: EXR or HDR.
        convention: Where the picture's middle looks: +Z of the Y-up world, or Blender's +X of its z-up world.
        """
    def idr(self, name: str = "", *, path: str | PathLike[str] | Parameter, train_side: int | Parameter = 0, train_megapixels: float | Parameter = 0.0, holdout: int | Parameter = 8, first: int | Parameter = 3, max_views: int | Parameter = 0, pixel_offset: float | Literal["auto"] | Parameter = "auto", checks: Literal["error", "warn", "off"] | Parameter = "error", downscale: int | Parameter = 1, up: Literal["y", "-y", "z", "-z", "x", "-x", "auto"] | Parameter = "auto", masks: str | Parameter = "auto", metres_per_unit: float | Parameter = 0.001, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> TrainTestFrameNode:
        """Photographs in the IDR / NeuS layout (DTU and others), with masks or without.

        path: Folder with cameras_sphere.npz and image/.
        train_side: Longer side of the training pictures at most: all are reduced by one whole factor, test pictures are not. 0: as they are. [px, >= 0]
        train_megapixels: Of all training pictures together at most, by such a factor; 0: no limit. [Mpx, >= 0]
        holdout: Every how many views one is held out for testing. [views, >= 2]
        first: Index of the first test view, counted from 0. [>= 0]
        max_views: Keep at most so many training views, evenly spread; 0 = all. [views, >= 0]
        pixel_offset: Added to the principal point: 0.5 where the file's pixel centres are whole numbers; auto: matches between the pictures decide between 0 and 0.5. [px]
        checks: Grave faults of cameras and pictures: an error, a warning, or not looked for (off).
        downscale: Reduce by this factor, by exact area averaging in linear light. [>= 1, <= 16]
        up: The up axis of the files' world; auto: the direction level cameras agree on.
        masks: Folder of masks inside the scene; auto = mask/ where it is there; none = ignore.
        metres_per_unit: Metres in one unit of the files; 0 = unknown. [m, >= 0]
        """
    def middlebury(self, name: str = "", *, path: str | PathLike[str] | Parameter, train_side: int | Parameter = 0, train_megapixels: float | Parameter = 0.0, holdout: int | Parameter = 8, first: int | Parameter = 3, max_views: int | Parameter = 0, pixel_offset: float | Literal["auto"] | Parameter = 0.5, checks: Literal["error", "warn", "off"] | Parameter = "error", downscale: int | Parameter = 2, up: Literal["y", "-y", "z", "-z", "x", "-x", "auto"] | Parameter = "y", masks: bool | Parameter = True, wrong_masks: int | Parameter = 1, box: tuple[tuple[float, ...] | list[float], ...] | list[tuple[float, ...] | list[float]] | None | Parameter = None, metres_per_unit: float | Parameter = 1.0, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> TrainTestFrameNode:
        """Photographs in the Middlebury multi-view layout (templeRing and others).

        path: Folder with <name>_par.txt, image/ and mask/.
        train_side: Longer side of the training pictures at most: all are reduced by one whole factor, test pictures are not. 0: as they are. [px, >= 0]
        train_megapixels: Of all training pictures together at most, by such a factor; 0: no limit. [Mpx, >= 0]
        holdout: Every how many views one is held out for testing. [views, >= 2]
        first: Index of the first test view, counted from 0. [>= 0]
        max_views: Keep at most so many training views, evenly spread; 0 = all. [views, >= 0]
        pixel_offset: Added to the principal point: 0.5 where the file's pixel centres are whole numbers; auto: matches between the pictures decide between 0 and 0.5. [px]
        checks: Grave faults of cameras and pictures: an error, a warning, or not looked for (off).
        downscale: Reduce by this factor, by exact area averaging in linear light. [>= 1, <= 16]
        up: The up axis of the files' world; auto: found from level cameras.
        masks: Use mask/ where it is there.
        wrong_masks: Masks that may be wrong at a point, for normalisation. [views, >= 0]
        box: The object's box in the files' units; default: found from the masks.
        metres_per_unit: Metres in one unit of the files; 0 = unknown. [m, >= 0]
        """
    def photos(self, name: str = "", *, path: str | PathLike[str] | Parameter, lens: Literal["pinhole", "radial", "opencv"] | Parameter = "radial", one_camera: bool | Parameter = True, focal: float | Parameter = 0.0, features: int | Parameter = 4096, feature_size: int | Parameter = 1600, registered: float | Parameter = 0.5, mapping: Literal["auto", "incremental", "easier", "global"] | Parameter = "auto", matching: Literal["auto", "plain", "wide", "even"] | Parameter = "auto", partners: int | Parameter = 30, turntable: bool | Parameter = True, threads: int | Parameter = 0, train_side: int | Parameter = 0, train_megapixels: float | Parameter = 0.0, keep: Literal["all", "object"] | Parameter = "all", cameras: Literal["auto", "file", "find"] | Parameter = "auto", adjust: bool | Parameter = True, vignetting: bool | Parameter = False, masks: bool | Parameter = True, frames: int | Parameter = 60, blurred: float | Parameter = 0.4, alike: float | Parameter = 0.002, megapixels: float | Parameter = 2.0, downscale: int | Parameter = 1, holdout: int | Parameter = 8, first: int | Parameter = 3, wrong_masks: int | Parameter = 1, checks: Literal["error", "warn", "off"] | Parameter = "error", seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> TrainTestFramePointsCamerasNode:
        """A folder of photographs, or a video: cameras and sparse points by structure from motion (needs pycolmap).

        path: Folder of pictures (or its images/) with masks/ beside them, or alpha; or a video.
        lens: What is found of the lens: focal length; and one term of distortion; or four and two lengths.
        one_camera: Pictures of one size, camera and focal length (EXIF) share a lens; false: each has its own.
        focal: Known focal length to start from, in pixels of the files; 0: from EXIF, else a guess. [px, >= 0]
        features: SIFT features of a picture at most; time grows with the square. [>= 100]
        feature_size: Longer side of the pictures in which they are found. [px, >= 100]
        registered: Share of the pictures that must get a camera. [> 0, <= 1]
        mapping: Which of COLMAP's: incremental, with easier thresholds, global; or what most matches agree with.
        matching: plain: upright patches, precise; wide: affine patches and matches along epipolar lines, which bear larger turns of the camera; even: wide, on pictures of even contrast, for dark and smooth ones; auto: wide where plain leaves pictures with few points or without a camera, and even where wide leaves some without.
        partners: Of more than 80 pictures each is matched with so many that look most alike; 0: all pairs are matched. [pictures, >= 0]
        turntable: Where the object turns before a camera on a tripod: leave out the features that stand still.
        threads: For features and matching; mapping runs on one. 0: all cores of this process. [>= 0]
        train_side: Longer side of the training pictures at most: all are reduced by one whole factor, test pictures are not. 0: as they are. [px, >= 0]
        train_megapixels: Of all training pictures together at most, by such a factor; 0: no limit. [Mpx, >= 0]
        keep: Find cameras by the whole picture, or (turntable) by what the masks show only.
        cameras: auto: those of COLMAP, nerfstudio, Metashape or RealityScan where their files lie in the folder, else found from the pictures; file: these, or an error; find: found from the pictures.
        adjust: Adjust the cameras found, their focal lengths and how much lenses bend until the photographs agree pixel by pixel; not where alpha cuts objects out.
        vignetting: Take out by how much the lens darkens pictures towards their corners, where they show it beyond doubt; not on turntables.
        masks: Use masks where they are there.
        frames: Frames of a video: the sharpest of so many equal parts of the way that its pictures move. [>= 3]
        blurred: Pictures with less than this share of the set's median sharpness are left out; 0: none is. [>= 0, < 1]
        alike: Of neighbours between which nothing moves by this share of the width the less sharp is left out; 0: none. [>= 0, < 1]
        megapixels: Pictures above this size are reduced to it, before anything else; 0: none is. [Mpx, >= 0]
        downscale: Reduce the views further, by this factor, once cameras are found. [>= 1, <= 16]
        holdout: Every how many views one is held out for testing. [views, >= 2]
        first: Index of the first test view, counted from 0. [>= 0]
        wrong_masks: Masks that may be wrong at a point, for normalisation. [views, >= 0]
        checks: Grave faults of cameras and pictures: an error, a warning, or not looked for (off).
        """
    def stanford_orb(self, name: str = "", *, path: str | PathLike[str] | Parameter, downscale: int | Parameter = 4, max_views: int | Parameter = 0, max_test_views: int | Parameter = 0, max_novel_views: int | Parameter = 0, checks: Literal["error", "warn", "off"] | Parameter = "error", seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> TrainTestFrameTruthNovelNode:
        """A capture of Stanford-ORB: HDR photographs, scanned truth, and views under two other measured lights.

        path: Folder of a capture, blender_HDR/<object>_scene00x; ground_truth/ beside blender_HDR/.
        downscale: Reduce by this factor; the benchmark scores 2048 / 4 pixels. [>= 1, <= 16]
        max_views: Keep at most so many training views, evenly spread; 0 = all. [views, >= 0]
        max_test_views: Keep at most so many test views; 0 = all. [views, >= 0]
        max_novel_views: Keep at most so many views under other lights; 0 = all. [views, >= 0]
        checks: Grave faults of cameras and pictures: an error, a warning, or not looked for (off).
        """
    def synthetic4relight(self, name: str = "", *, path: str | PathLike[str] | Parameter, lights: tuple[str, ...] | list[str] | Parameter = ..., downscale: int | Parameter = 1, max_views: int | Parameter = 0, max_test_views: int | Parameter = 0, checks: Literal["error", "warn", "off"] | Parameter = "error", seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> TrainTestFrameTruthNode:
        """A scene of Synthetic4Relight: linear training pictures, test views with materials, relit pictures.

        path: Folder of a scene, with transforms_train.json and test_rli/; envmaps/ in it or beside it.
        lights: Relit test pictures that are scored.
        downscale: Reduce by this factor, by exact area averaging in linear light. [>= 1, <= 16]
        max_views: Keep at most so many training views, evenly spread; 0 = all. [views, >= 0]
        max_test_views: Keep at most so many test views; 0 = all. [views, >= 0]
        checks: Grave faults of cameras and pictures: an error, a warning, or not looked for (off).
        """
    def usd(self, name: str = "", *, path: str | PathLike[str] | Parameter, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> FilesNode:
        """A USD package from elsewhere, to be composed with others; what the gate finds in it is a warning.

        path: A USD package (.usdz), which holds all that it needs.
        """
class _Edit(Family):
    def material(self, name: str = "", *, asset: Wire[Asset] | Node, views: Wire[Views] | Node | None = None, frame: Wire[Frame] | Node | None = None, channel: Literal["base_color", "roughness", "metallic"] | Parameter = "base_color", operation: Literal["set", "scale", "paint"] | Parameter = "set", value: tuple[float, ...] | list[float] | Parameter = ..., picture: str | PathLike[str] | None | Parameter = None, mask: str | PathLike[str] | None | Parameter = None, center: tuple[float, ...] | list[float] | None | Parameter = None, view: str | Parameter = "", pixel: tuple[float, ...] | list[float] | None | Parameter = None, radius: float | Parameter = 0.0, feather: float | Parameter = 0.0, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> AssetGalleryNode:
        """Set, scale or paint a map in a region; all other texels keep their bytes.

        channel: The map to change.
        operation: Set to `value`, scale by it, or paint `picture` over.
        value: One number, or for base_color three (linear RGB), for set and scale.
        picture: RGBA picture for paint: a decal on the ball, or in the atlas's layout where the region is no ball.
        mask: Region: a picture in the atlas's layout (row 0 is v = 1), white is changed.
        center: Region: middle of a ball, normalised units (scene units where a frame is wired).
        view: Region: the ball's middle is what this view shows at `pixel`; needs wired views.
        pixel: x to the right, y down. [px]
        radius: Radius of the ball, in the units of `center`. [>= 0]
        feather: Share of the radius over which the edit fades out. [>= 0, <= 1]
        """
    def relight(self, name: str = "", *, asset: Wire[Asset] | Node, light: Wire[EnvMap] | Node | None = None, views: Wire[Views] | Node | None = None, transport: Wire[Transport] | Node | None = None, rotation: float | Parameter = 0.0, exposure: float | Parameter = 0.0, pictures: int | Parameter = 3, size: int | Parameter = 384, bounces: int | Parameter = 8, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> AssetGalleryNode:
        """The asset under another environment, turned and exposed (its own where none is wired), with pictures.

        rotation: Turn of the light about +Y, counter-clockwise from above. [rad, >= -6.283185307179586, <= 6.283185307179586]
        exposure: The light is multiplied by 2 to this power. [stops, >= -20, <= 20]
        pictures: Pictures in the report: of the wired views, or around the object. [>= 0, <= 64]
        size: Side of pictures that no view gives a size. [px, >= 16, <= 4096]
        bounces: Interreflections in the pictures, where no transport is wired. [>= 0, <= 16]
        """
    def turntable(self, name: str = "", *, asset: Wire[Asset] | Node, transport: Wire[Transport] | Node | None = None, frames: int | Parameter = 36, size: int | Parameter = 384, seconds: float | Parameter = 4.0, elevation: float | Parameter = 0.35, turn: Literal["camera", "light"] | Parameter = "camera", bounces: int | Parameter = 8, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> FilmNode:
        """A film of the asset turning under its light (animated WebP, shown in the report).

        frames: Pictures in one turn. [>= 2, <= 720]
        size: Side of a picture. [px, >= 16, <= 2160]
        seconds: Duration of one turn. [s, > 0, <= 120]
        elevation: Height of the camera above the horizon. [rad, > -1.5, < 1.5]
        turn: What goes round.
        bounces: Interreflections, where no transport is wired. [>= 0, <= 16]
        """
class _Evaluate(Family):
    def asset(self, name: str = "", *, asset: Wire[Asset] | Node, views: Wire[Views] | Node, truth: Wire[SceneTruth] | Node | None = None, train: Wire[Views] | Node | None = None, region: Wire[Region] | Node | None = None, before: Wire[Metrics] | Node | None = None, directions: int | Parameter = 256, bounces: int | Parameter = 8, supersampling: int | Parameter = 2, specular_samples: int | Parameter = 12, max_views: int | Parameter = 0, lpips: str | PathLike[str] | None | Parameter = None, exposure: Literal["fixed", "fitted"] | Parameter = "fixed", pictures: int | Parameter = 3, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> MetricsScoredNode:
        """Held-out and relit PSNR, albedo and roughness, each beside the score of a gray object.

        directions: Directions per surface point of the light transport. [>= 32]
        bounces: Interreflections in the scored renders. [>= 0, <= 16]
        supersampling: Antialiasing. [samples per pixel side, >= 1, <= 8]
        specular_samples: GGX rays per sample of a pixel. [>= 1]
        max_views: Score this many views, evenly spread; 0: all. [>= 0]
        lpips: LPIPS's weights, a safetensors file (docs/metrics.md); none: left out.
        exposure: Fitted: of each held-out photograph one factor per channel is fitted before it is compared, as Stage I fits those of the training photographs (gains); the report says so, and the figure without stands beside.
        pictures: Held-out views handed on for pictures (gallery.asset). [>= 0]
        """
    def capture(self, name: str = "", *, views: Wire[Views] | Node, mesh: Wire[Mesh] | Node, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> MetricsNode:
        """What the photographs cover of the surface, and from where more of them would help most."""
    def mesh(self, name: str = "", *, mesh: Wire[Mesh] | Node, truth: Wire[SceneTruth] | Node | None = None, samples: int | Parameter = 40000, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> MetricsNode:
        """Chamfer distance to the true surface, whether the mesh is closed and manifold, its size.

        samples: Points on each surface for the Chamfer distance. [>= 100]
        """
    def region(self, name: str = "", *, views: Wire[Views] | Node, train: Wire[Views] | Node | None = None, ground: Wire[Mesh] | Node | None = None, box: tuple[tuple[float, ...] | list[float], ...] | list[tuple[float, ...] | list[float]] | None | Parameter = None, masks: str | PathLike[str] | None | Parameter = None, table: Literal["auto", "keep"] | Parameter = "auto", tolerance: float | Parameter = 0.1, incidence: float | Parameter = 80.0, downscale: int | Parameter = 2, neighbours: int | Parameter = 8, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> RegionNode:
        """What counts in held-out views without masks: what shows the hull of the training masks, or their own depth says.

        box: Two corners, normalised units: only surface inside counts. Default: the sphere around the object.
        masks: Folder of masks for scoring only, named as the held-out views; white counts. Never used by a fit.
        table: Auto: a plane that the object stands on, and that goes on beside it, does not count; keep: it does.
        tolerance: How far from the photographs' depth surface may lie and cover a pixel; 1: the radius. [> 0, <= 1]
        incidence: Depth seen at a more grazing angle is left out. [degrees, > 0, <= 90]
        downscale: Look for depth in pictures reduced by this factor. [>= 1, <= 16]
        neighbours: Training views near each that stereo may compare with. [views, >= 2, <= 32]
        """
    def round(self, name: str = "", *, state: Wire[Carrier] | Node, views: Wire[Views] | Node | None = None, truth: Wire[SceneTruth] | Node | None = None, region: Wire[Region] | Node | None = None, samples: int | Parameter = 10000, max_views: int | Parameter = 8, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> MetricsNode:
        """What a round of Stage I has reached: error against seconds and vertices.

        samples: Points on each surface for the Chamfer distance. [>= 100]
        max_views: Held-out views that the PSNR is taken on, evenly spread. [>= 1]
        """
    def stage1(self, name: str = "", *, carrier: Wire[Carrier] | Node, views: Wire[Views] | Node, region: Wire[Region] | Node | None = None, train: Wire[Views] | Node | None = None, max_views: int | Parameter = 0, lpips: str | PathLike[str] | None | Parameter = None, exposure: Literal["fixed", "fitted"] | Parameter = "fixed", pictures: int | Parameter = 2, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> MetricsScoredNode:
        """Held-out PSNR and SSIM of the mesh with its Stage I appearance.

        max_views: Score this many views, evenly spread; 0: all. [>= 0]
        lpips: LPIPS's weights, a safetensors file (docs/metrics.md); none: left out.
        exposure: Fitted: of each held-out photograph one factor per channel is fitted before it is compared, as Stage I fits those of the training photographs (gains); the report says so, and the figure without stands beside.
        pictures: Scored views handed on for pictures (gallery.stage1). [>= 0]
        """
class _Export(Family):
    def gaussians(self, node_name: str = "", /, *, gaussians: Wire[PlanarGaussians] | Node, frame: Wire[Frame] | Node | None = None, units: Literal["normalised", "scene", "dataset"] | Parameter = "dataset", name: str | Parameter = "gaussians", seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> FilesNode2:
        """Write Gaussians as PLY in the common 3DGS layout.

        units: The file's space: the normalised world, the Y-up scene, or the data set's own axes and units.
        name: File name, without .ply.
        """
    def gltf(self, node_name: str = "", /, *, asset: Wire[Asset] | Node, frame: Wire[Frame] | Node | None = None, metrics: Wire[Metrics] | Node | None = None, name: str | Parameter = "asset", roughness_floor: float | Parameter = 0.04, dilation: int | Parameter = 8, recentre: bool | Parameter = False, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> FilesNode3:
        """Write mesh, tangents and maps as one binary glTF file, in metres; glTF holds no environment.

        name: Name of the asset and its files: letters, digits and _.
        roughness_floor: Lowest roughness written: below it, highlights are spikes that renderers disagree about; how many texels were raised is reported. [>= 0.0, <= 1.0]
        dilation: Padding of the charts, so that mip levels do not bleed. [texels, >= 0, <= 64]
        recentre: Put the object's middle at the origin, for scenes far from theirs; the move is kept in the asset.
        """
    def lod(self, name: str = "", *, asset: Wire[Asset] | Node, views: Wire[Views] | Node | None = None, share: float | Parameter = 0.25, texture_size: int | Parameter = 0, fit_pixels: bool | Parameter = False, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> AssetNode:
        """A coarser level of detail: fewer faces on the same atlas, normals baked from the fine mesh, smaller maps.

        share: Faces of the result, as a share of the asset's. [> 0, <= 1]
        texture_size: Side of the maps, a divisor of theirs; 0: as they are. [texels, >= 0, <= 8192]
        fit_pixels: Side of the maps at which a texel is no larger than a pixel in the wired views, for 95 % of the surface.
        """
    def obj(self, node_name: str = "", /, *, asset: Wire[Asset] | Node, frame: Wire[Frame] | Node | None = None, name: str | Parameter = "asset", roughness_floor: float | Parameter = 0.04, dilation: int | Parameter = 8, recentre: bool | Parameter = False, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> FilesNode4:
        """Write mesh and maps as Wavefront OBJ with an MTL file; OBJ holds neither light nor units.

        name: Name of the asset and its files: letters, digits and _.
        roughness_floor: Lowest roughness written: below it, highlights are spikes that renderers disagree about; how many texels were raised is reported. [>= 0.0, <= 1.0]
        dilation: Padding of the charts, so that mip levels do not bleed. [texels, >= 0, <= 64]
        recentre: Put the object's middle at the origin, for scenes far from theirs; the move is kept in the asset.
        """
    def usd(self, node_name: str = "", /, *, asset: Wire[Asset] | Node, frame: Wire[Frame] | Node | None = None, views: Wire[Views] | Node | None = None, mid: Wire[Asset] | Node | None = None, low: Wire[Asset] | Node | None = None, metrics: Wire[Metrics] | Node | None = None, name: str | Parameter = "asset", roughness_floor: float | Parameter = 0.04, dilation: int | Parameter = 8, recentre: bool | Parameter = False, up_axis: Literal["Y", "Z"] | Parameter = "Y", normal_bits: Literal[8, 16] | Parameter = 8, clip: bool | Parameter = False, require_scale: bool | Parameter = False, require_closed: bool | Parameter = False, gate: bool | Parameter = True, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> FilesNode:
        """Write mesh, maps, light and cameras as USD; judged by the gate before anything is published.

        name: Name of the asset and its files: letters, digits and _.
        roughness_floor: Lowest roughness written: below it, highlights are spikes that renderers disagree about; how many texels were raised is reported. [>= 0.0, <= 1.0]
        dilation: Padding of the charts, so that mip levels do not bleed. [texels, >= 0, <= 64]
        recentre: Put the object's middle at the origin, for scenes far from theirs; the move is kept in the asset.
        up_axis: Z turns points, cameras and light; many tools turn Y-up by themselves.
        normal_bits: Depth of the normal map. [bits]
        clip: Clip base colour to [0, 1] and light to half floats; else values outside are errors.
        require_scale: Refuse an asset whose metric scale is not known.
        require_closed: Refuse an open or non-manifold mesh.
        gate: Refuse to publish a file that fails the checks; false is noted in the asset.
        """
class _Gallery(Family):
    def asset(self, name: str = "", *, asset: Wire[Asset] | Node, scored: Wire[ScoredViews] | Node, truth: Wire[SceneTruth] | Node | None = None, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> GalleryNode:
        """What evaluate.asset or benchmark.synthetic4relight compared, light, atlas, geometry, a model to turn."""
    def blender(self, name: str = "", *, files: Wire[UsdAsset] | Node, python: str | Parameter, cameras: tuple[str, ...] | list[str] | Parameter = ..., pictures: int | Parameter = 3, samples: int | Parameter = 64, scale: float | Parameter = 1.0, background: bool | Parameter = False, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> GalleryNode:
        """Pictures of an exported file by Blender's Cycles, from the file's own cameras.

        python: Path of a Python with bpy (docs/usd.md); not looked for anywhere else.
        cameras: Names of the file's cameras; none: the first `pictures` of them.
        pictures: How many cameras are rendered where `cameras` names none. [>= 1, <= 64]
        samples: Cycles' samples. [paths per pixel, >= 1]
        scale: Factor on the pictures' sides. [> 0, <= 8]
        background: Show the light behind the objects.
        """
    def round(self, name: str = "", *, state: Wire[Carrier] | Node, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> GalleryNode:
        """A round of Stage I: the shape from six sides, its edges, its atlas in colours of stretch."""
    def stage1(self, name: str = "", *, carrier: Wire[Carrier] | Node, scored: Wire[ScoredViews] | Node, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> GalleryNode:
        """The views that evaluate.stage1 scored, geometry, texture, a model to turn."""
class _Init(Family):
    def auto(self, name: str = "", *, views: Wire[Views] | Node, points: Wire[PointCloud] | Node | None = None, depths: Wire[DepthMaps] | Node | None = None, stereo: Wire[DepthMaps] | Node | None = None, ground: Wire[Mesh] | Node | None = None, threads: int | Parameter = 0, device: Literal["auto", "cpu", "cuda"] | Parameter = "auto", method: Literal["auto", "hull", "tsdf", "stereo", "pgsr", "sphere"] | Parameter = "auto", seconds: float | Parameter = 300.0, iterations: int | Parameter = 0, side: int | Parameter = 400, count: int | Parameter = 20000, resolution: int | Parameter = 0, faces: int | Parameter = 5000, edge: float | Parameter = 0.0, tolerance: float | Parameter = 0.02, close_holes: int | Parameter = 60, wrong_masks: int | Parameter = 0, table: Literal["auto", "remove", "keep"] | Parameter = "auto", openings: bool | Parameter = True, flat_base: bool | Parameter = True, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> MeshDecisionsNode:
        """A coarse mesh by what there is: the hull of masks, carved by stereo; without masks the depth of stereo, fused.

        threads: CPU cores that kernels share; 0 takes all of this process. [>= 0]
        device: Where to compute; auto takes a CUDA device if there is one.
        method: auto: by what there is and `seconds`; else init.visual_hull, init.tsdf (of depths, or of prior.patch_match: stereo), init.pgsr, init.sphere.
        seconds: Processor time the start may take, by a fixed estimate. [s, > 0]
        iterations: Of planar Gaussians (beside stereo with masks, else alone); 0: 500 to 1500 if needed, by `seconds`. [>= 0]
        side: Longer side of the pictures for stereo, and to which Gaussians are fitted, about. [px, >= 16]
        count: Gaussians at the start where no points are wired in. [>= 1]
        resolution: Of the hull or the fusion; 0: as fine as masks show it, without masks 128. [voxels, >= 0, <= 512]
        faces: Face budget of the result. [faces, >= 20]
        edge: With masks: more faces, up to 12 000, where edges would span more pixels of the photographs; 0: no. [pixels, >= 0]
        tolerance: With masks: more faces, where so few would lose thin parts (as init.clean). [>= 0, <= 1]
        close_holes: Without masks: fill holes of at most so many edges. [edges, >= 0]
        wrong_masks: Masks that may be wrong at a point. [views, >= 0]
        table: Without masks: the plane that the object stands on, as in init.object; lumps in the air go anyway.
        openings: With masks: open flat parts of the surface where photographs say so: vessels, whose depth no outline shows.
        flat_base: With masks and without a `ground`: where cameras look down at it, the hull ends at the lowest level that outlines show; else it goes on below in a cone.
        """
    def clean(self, name: str = "", *, mesh: Wire[Mesh] | Node, faces: int | Parameter = 5000, tolerance: float | Parameter = 0.0, max_faces: int | Parameter = 12000, method: Literal["builtin", "pymeshlab", "open3d"] | Parameter = "builtin", components: int | Parameter = 1, min_area: float | Parameter = 0.0, close_holes: int | Parameter = 0, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> MeshNode:
        """Largest parts, manifold, evenly triangulated within a face budget; closed stays closed.

        faces: Face budget of the result. [faces, >= 20]
        tolerance: The budget doubles until 99 % of the surface is kept to within this share of its radius (half the box's diagonal), so that thin parts stay; 0: never. [>= 0, <= 1]
        max_faces: Where doubling ends (`tolerance`). [faces, >= 20]
        method: builtin, pymeshlab (GPL-3): isotropic remeshing; open3d: quadric decimation.
        components: Connected parts to keep, largest area first; 0 = all. [>= 0]
        min_area: Drop parts below this share of the largest part's area. [>= 0, <= 1]
        close_holes: Fill holes of at most so many edges (not open3d); 0 = none. [edges, >= 0]
        """
    def gaussian_file(self, name: str = "", *, path: str | PathLike[str] | Parameter, frame: Wire[Frame] | Node | None = None, units: Literal["normalised", "scene", "dataset"] | Parameter = "dataset", seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> GaussiansNode:
        """Gaussians from a PLY file of 3DGS, 2DGS or PGSR.

        path: PLY file of Gaussians in the common 3DGS layout.
        units: The file's space: the normalised world, the Y-up scene, or the data set's own axes and units.
        """
    def mesh_file(self, name: str = "", *, path: str | PathLike[str] | Parameter, frame: Wire[Frame] | Node | None = None, units: Literal["normalised", "scene", "dataset"] | Parameter = "dataset", seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> MeshNode:
        """A mesh from an OBJ or PLY file.

        path: OBJ or PLY file.
        units: The file's space: the normalised world, the Y-up scene, or the data set's own axes and units.
        """
    def object(self, name: str = "", *, views: Wire[Views] | Node, points: Wire[PointCloud] | Node | None = None, depths: Wire[DepthMaps] | Node | None = None, table: Literal["auto", "remove", "keep"] | Parameter = "auto", resolution: int | Parameter = 128, reach: float | Parameter = 1.3, least_part: float | Parameter = 0.05, least_structure: float | Parameter = 0.006, threads: int | Parameter = 0, side: int | Parameter = 400, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> MeshNode:
        """The object alone, closed and rough, from views without masks: what stereo shows of it, without its table.

        table: A plane that the object stands on: auto takes it away where it goes on beside the object; keep it, or take it away in any case (an error where there is none).
        resolution: Along the diameter of what is looked at. [voxels, >= 32, <= 512]
        reach: How far is looked, in radii of the world's sphere, which is a guess without masks. [>= 1, <= 4]
        least_part: Parts apart from the largest stay from this share of its area on. [>= 0, <= 1]
        least_structure: Depth counts where display values vary by this deviation in 3 x 3 pixels: flat ones have a neighbour's. [>= 0, <= 1]
        threads: CPU cores that kernels share; 0 takes all of this process. [>= 0]
        side: Longer side of the pictures for stereo, and in which the object is sought. [px, >= 32]
        """
    def pgsr(self, name: str = "", *, views: Wire[Views] | Node, points: Wire[PointCloud] | Node | None = None, begin: Wire[PlanarGaussians] | Node | None = None, iterations: int | Parameter = 1500, start: Literal["auto", "points", "hull", "random"] | Parameter = "auto", count: int | Parameter = 20000, max_gaussians: int | Parameter = 40000, wrong_masks: int | Parameter = 0, degree: int | Parameter = 3, ssim_weight: float | Parameter = 0.2, mask_weight: float | Parameter = 0.2, flatten_weight: float | Parameter = 100.0, normal_weight: float | Parameter = 0.015, geometric_weight: float | Parameter = 0.03, photometric_weight: float | Parameter = 0.15, geometry_from: float | Parameter = 0.25, samples: int | Parameter = 4096, mean_rate: float | Parameter = 0.002, mean_decay: float | Parameter = 0.01, scale_rate: float | Parameter = 0.005, rotation_rate: float | Parameter = 0.002, opacity_rate: float | Parameter = 0.05, colour_rate: float | Parameter = 0.005, densify: float | Parameter = 0.0002, densify_absolute: float | Parameter = 0.0008, densify_from: float | Parameter = 0.08, densify_to: float | Parameter = 0.6, densify_rounds: int | Parameter = 15, min_opacity: float | Parameter = 0.01, reset_at: float | Parameter = 0.0, gains: bool | Parameter = False, downscale: int | Parameter = 1, threads: int | Parameter = 0, device: Literal["auto", "cpu", "cuda"] | Parameter = "auto", seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> GaussiansHistoryNode:
        """Fit planar Gaussians to the photographs (PGSR): a coarse surface that opens what no outline shows.

        iterations: Length of the fit, one view each; every schedule is a share of it. [>= 1]
        start: points wired in, in the visual hull of the masks, or at random in the unit sphere; auto: the first of these that there is.
        count: Gaussians at the start (hull, random). [>= 1]
        max_gaussians: Gaussians at most. [>= 1]
        wrong_masks: Masks that may be wrong at a point (hull). [views, >= 0]
        degree: Degree of the spherical harmonics at the end. [>= 0, <= 3]
        ssim_weight: Share of 1 - SSIM in the colour loss. [>= 0, <= 1]
        mask_weight: Weight of coverage against the mask, where there is one. [>= 0]
        flatten_weight: Weight of the Gaussians' mean thickness, in world units. [>= 0]
        normal_weight: Weight of rendered normals agreeing with rendered depth. [>= 0]
        geometric_weight: Weight of depth agreeing with a neighbouring view's. [>= 0]
        photometric_weight: Weight of patches correlating with a neighbouring view's. [>= 0]
        geometry_from: Share of the iterations after which these three act. [>= 0, <= 1]
        samples: Pixels compared with the neighbour in an iteration. [pixels, >= 1]
        mean_rate: Step of the means at the start, in world units. [> 0]
        mean_decay: The means' step ends at this share of its start. [> 0, <= 1]
        scale_rate: Step of the scales' logarithms. [>= 0]
        rotation_rate: Step of the quaternions. [>= 0]
        opacity_rate: Step of the opacities' logits. [>= 0]
        colour_rate: Step of the colour; that of higher harmonics is a twentieth. [>= 0]
        densify: Mean screen gradient above which a Gaussian is doubled or split; a picture is 2 wide, over the views that saw it. [> 0]
        densify_absolute: The same for the sum of its absolute values over the pixels. [> 0]
        densify_from: Share of the iterations after the first round of splitting. [>= 0, <= 1]
        densify_to: Share of the iterations after the last round of splitting. [>= 0, <= 1]
        densify_rounds: Rounds of splitting and pruning; 0: none. [>= 0]
        min_opacity: A round prunes fainter Gaussians. [>= 0, < 1]
        reset_at: Share of the iterations at which opacities are reset; 0: never. [>= 0, < 1]
        gains: Fit one factor per view and channel, for photographs of wandering exposure.
        downscale: Work on pictures reduced by this factor. [>= 1, <= 16]
        threads: CPU cores that kernels share; 0 takes all of this process. [>= 0]
        device: Where to compute; auto takes a CUDA device if there is one.
        """
    def photometric(self, name: str = "", *, mesh: Wire[Mesh] | Node, views: Wire[Views] | Node, passes: int | Parameter = 2, reach: float | Parameter = 3.0, smoothness: float | Parameter = 0.03, threads: int | Parameter = 0, device: Literal["auto", "cpu", "cuda"] | Parameter = "auto", seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> MeshNode:
        """Open cavities that no outline shows: move a coarse mesh to where patches of the photographs agree.

        passes: Sweeps over the mesh. [>= 0, <= 20]
        reach: Largest move of a pass inwards; outwards a quarter. [mean edges, > 0, <= 20]
        smoothness: Weight of neighbours moving alike against what the photographs say. [> 0]
        threads: CPU cores that kernels share; 0 takes all of this process. [>= 0]
        device: Where to compute; auto takes a CUDA device if there is one.
        """
    def sphere(self, name: str = "", *, faces: int | Parameter = 1280, radius: float | Parameter = 0.8, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> MeshNode:
        """A sphere that knows nothing of the photographs: what Stage I makes of the worst start.

        faces: Upper limit; a sphere has 20, 80, 320, 1280, 5120, ... faces. [faces, >= 20]
        radius: Around the origin of the normalised world, which the unit sphere bounds. [> 0, <= 1]
        """
    def tsdf(self, name: str = "", *, views: Wire[Views] | Node, depths: Wire[DepthMaps] | Node, resolution: int | Parameter = 128, truncation: float | Parameter = 4.0, masked: bool | Parameter = True, min_weight: float | Parameter = 1.0, radius: float | Parameter = 0.0, solid: bool | Parameter = False, wrong_masks: int | Parameter = 0, clear: float | Parameter = 1.0, blur: float | Parameter = 0.0, incidence: float | Parameter = 0.0, agreeing: int | Parameter = 0, tolerance: float | Parameter = 0.01, parts: int | Parameter = 0, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> MeshNode:
        """Fuse depth maps into one surface (truncated signed distance): open (Open3D), or closed by the visual hull.

        resolution: Voxels along the unit sphere's diameter; 0: 128, solid: as init.visual_hull. [voxels, >= 0, <= 512]
        truncation: Distance at which the field is cut off. [voxels, >= 1.5, <= 32]
        masked: Ignore depth where alpha < 1/2.
        min_weight: Views that must have seen a voxel. [views, >= 1]
        radius: Ignore depth of points farther than this from the origin; 0: none. [>= 0]
        solid: Cut what the depth maps look through out of the visual hull, which fills what they do not see: closed (needs masks; resolution is along the object's longest side).
        wrong_masks: Masks that may be wrong at a point (solid). [views, >= 0]
        clear: How far below the hull depth maps must go to carve; 2 for stereo (solid). [voxels, >= 0, <= 8]
        blur: Smooth the field where depth maps carve; 1 for stereo (solid). [voxels, >= 0, <= 8]
        incidence: Ignore surfaces seen at more than this angle; 0: none ignored. [degrees, >= 0, <= 90]
        agreeing: Neighbours that must show the same point; 0: none asked. [views, >= 0]
        tolerance: How far those may be off, as a share of the depth. [> 0, <= 1]
        parts: Connected parts to keep, largest area first; 0 = all. [>= 0]
        """
    def visual_hull(self, name: str = "", *, views: Wire[Views] | Node, resolution: int | Parameter = 128, wrong_masks: int | Parameter = 0, smooth: int | Parameter = 10, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> MeshNode:
        """The largest closed shape that agrees with the masks.

        resolution: Voxels along the object's longest side; 0: as fine as pictures show it, 1.25 pixels, 64 to 192 voxels. [voxels, >= 0, <= 512]
        wrong_masks: Masks that may be wrong at a point; 1 for hand-made masks. [views, >= 0]
        smooth: Taubin smoothing steps (no shrinking) after marching cubes. [steps, >= 0, <= 200]
        """
class _Mask(Family):
    def auto(self, name: str = "", *, views: Wire[Views] | Node, points: Wire[PointCloud] | Node | None = None, least_overlap: float | Parameter = 0.85, least_apart: float | Parameter = 0.8, least_seen: float | Parameter = 0.6, most_contradicted: float | Parameter = 0.2, table: Literal["auto", "remove", "keep"] | Parameter = "auto", resolution: int | Parameter = 128, reach: float | Parameter = 1.3, least_part: float | Parameter = 0.05, least_structure: float | Parameter = 0.006, side: int | Parameter = 400, band: float | Parameter = 8.0, smoothness: float | Parameter = 2.0, threads: int | Parameter = 0, find: bool | Parameter = True, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> TrainDecisionsDepthsGroundNode:
        """Masks for photographs that have none, where an object stands apart, and a check of them.

        least_overlap: Median over the views of masks and their common shape, drawn back: intersection over union, or the part of the first masks that it covers, whichever is less. [>= 0, <= 1]
        least_apart: Share of the surface amidst the views, less its table, that most of the views show. [>= 0, <= 1]
        least_seen: Share of the views that must show the object. [>= 0, <= 1]
        most_contradicted: Share of the views whose mask may be another than the common shape. [>= 0, <= 1]
        table: A plane that the object stands on: auto takes it away where it goes on beside the object; keep it, or take it away in any case (an error where there is none).
        resolution: Along the diameter of what is looked at. [voxels, >= 32, <= 512]
        reach: How far is looked, in radii of the world's sphere, which is a guess without masks. [>= 1, <= 4]
        least_part: Parts apart from the largest stay from this share of its area on. [>= 0, <= 1]
        least_structure: Depth counts where display values vary by this deviation in 3 x 3 pixels: flat ones have a neighbour's. [>= 0, <= 1]
        side: Longer side of the pictures in which outlines are first moved; of stereo too. [px, >= 32]
        band: How far an outline may move to an edge of the picture, at that size; in pictures below 256 less, to half. [px, >= 1, <= 64]
        smoothness: Cost of a pixel of outline where the picture is flat; that of a wrong pixel is 1. [>= 0, <= 100]
        threads: CPU cores that kernels share; 0 takes all of this process. [>= 0]
        find: Look for masks where there are none; false passes the views on as they are.
        """
    def files(self, name: str = "", *, views: Wire[Views] | Node, path: str | PathLike[str] | Parameter, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> ViewsNode:
        """Masks from files, laid on views that have none: white on the object, as the views have the pictures.

        path: Folder of masks, PNG, called as the views: NAME_mask.png, NAME.png or NAME.jpg.png.
        """
    def from_surface(self, name: str = "", *, views: Wire[Views] | Node, surface: Wire[Mesh] | Node, side: int | Parameter = 400, band: float | Parameter = 8.0, smoothness: float | Parameter = 2.0, threads: int | Parameter = 0, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> ViewsNode:
        """Masks of what shows a surface: drawn into each view, and cut to the picture's edges around its outline.

        side: Longer side of the pictures in which outlines are first moved; of stereo too. [px, >= 32]
        band: How far an outline may move to an edge of the picture, at that size; in pictures below 256 less, to half. [px, >= 1, <= 64]
        smoothness: Cost of a pixel of outline where the picture is flat; that of a wrong pixel is 1. [>= 0, <= 100]
        threads: CPU cores that kernels share; 0 takes all of this process. [>= 0]
        """
class _Material(Family):
    def alike(self, name: str = "", *, doubt: float | Parameter = 0.1) -> Node:
        """Where no highlight tells the roughness, that of texels of like colour.

        doubt: Variance of fitted roughness over what independent errors of pixels give: TV has taken most away. [> 0]
        """
class _Mesh(Family):
    def flip(self, name: str = "", *, state: Wire[Stage1State] | Node, method: Literal["delaunay", "valence"] | Parameter = "delaunay", max_bend: float | Parameter = 0.5, max_shift: float | Parameter = 0.1, min_shape: float | Parameter = 0.1, max_rounds: int | Parameter = 8, relax: int | Parameter = 2, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> StateNode:
        """Flip edges inside charts to even out the triangles that splits and merges leave, then space vertices evenly.

        method: Which edges turn: those whose two opposite angles sum to more than half a turn, or those between vertices whose degrees then come nearer to six (four on a boundary).
        max_bend: Only pairs of faces that are flatter than this. [radians, >= 0.0, <= 1.5]
        max_shift: How far the texture may move under the new edge; 0 allows rounding only. [diagonals, >= 0.0]
        min_shape: A new face is not more degenerate (eq. 4) than this, unless the worse old one was. [>= 0.0, <= 1.0]
        max_rounds: Passes over the mesh; it ends early when no edge is left to flip. [>= 1, <= 64]
        relax: Then glide vertices, with their UVs, towards even spacing. [steps, >= 0, <= 20]
        """
    def merge(self, name: str = "", *, state: Wire[Stage1State] | Node, views: Wire[Views] | Node | None = None, degenerate: float | Parameter = 0.05, area_quantile: float | Parameter = 0.3, method: Literal["degenerate", "random"] | Parameter = "degenerate", share: float | Parameter = 0.1, tries: int | Parameter = 3, checks: Literal["shape", "topology"] | Parameter = "shape", uv: Literal["survivor", "own"] | Parameter = "survivor", min_faces: int | Parameter = 100, min_cosine: float | Parameter = 0.5, outline_cosine: float | Parameter = 0.7, supersample: int | Parameter = 2, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> StateNode:
        """Collapse small faces that are degenerate or, with views given, that no view shows.

        degenerate: tau_degen of eq. 4: faces below this area / longest edge squared go. [>= 0.0, <= 1.0]
        area_quantile: Only faces up to this quantile of area may go. [>= 0.0, <= 1.0]
        method: Which faces go: degenerate or never rendered ones, or a share of the small ones at random.
        share: Share of the small faces that `random` takes. [>= 0.0, <= 1.0]
        tries: Edges of a face tried in turn; the paper stops at the first. [edges, >= 1, <= 3]
        checks: What a collapse must keep: normals, shapes, outlines and the atlas too, or a manifold alone (the paper).
        uv: UV of the corners that a collapse moves: the survivor's in their chart, or their own (paper).
        min_faces: The mesh keeps at least this many. [faces, >= 4]
        min_cosine: A face that stays keeps its normal within the angle of this cosine. [>= -1.0, <= 1.0]
        outline_cosine: A vertex on a boundary or seam goes only where that line turns by no more than the angle of this cosine. [>= -1.0, <= 1.0]
        supersample: Views are searched for each face at this multiple of their resolution. [>= 1, <= 8]
        """
    def split(self, name: str = "", *, state: Wire[Stage1State] | Node, views: Wire[Views] | Node | None = None, max_faces: int | Parameter = 200000, target_faces: int | Parameter = 0, growth: float | Parameter = 1.5, min_edge: float | Parameter = 0.0, method: Literal["score", "area", "random", "uniform"] | Parameter = "score", position: Literal["projection", "midpoint", "random"] | Parameter = "projection", edge_degrees: Literal["opposite", "endpoints"] | Parameter = "opposite", score: Literal["ranks", "values"] | Parameter = "ranks", gradient_weight: float | Parameter = 0.6, curvature_weight: float | Parameter = 0.4, area_quantile: float | Parameter = 0.5, max_degree: int | Parameter = 10, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> StateNode:
        """Split faces that are large, curved or far from their images; UVs, moments and gradients follow.

        max_faces: Never exceeded (Table 1). [faces, >= 4]
        target_faces: Split up to this many faces; 0: use growth. [faces, >= 0]
        growth: Faces after over faces before, when target_faces is 0. [>= 1.0, <= 16.0]
        min_edge: Mean edge below which no split goes, in the photographs of `views`; 0: any. [px, >= 0, <= 64]
        method: Which faces split: eq. 3, the largest, at random, or all into four (stops at max_faces).
        position: Where on its edge a vertex goes.
        edge_degrees: Whose degrees divide the length in the edge score: those that rise, or the edge's own (paper).
        score: G and K enter eq. 3 by rank within the mesh, or as they are (the paper's letter).
        gradient_weight: w_g of eq. 3. [>= 0.0]
        curvature_weight: w_k of eq. 3. [>= 0.0]
        area_quantile: Faces from this quantile of area on may be selected. [>= 0.0, < 1.0]
        max_degree: An edge is not split when a vertex opposite to it has this degree as a round begins; splits on two sides of a vertex in one round may pass it by one. [>= 6]
        """
    def untangle(self, name: str = "", *, state: Wire[Stage1State] | Node, steps: int | Parameter = 12, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> StateNode:
        """Smooth faces apart that cut one another; nothing else moves. For starts and photographs that leave such faces.

        steps: Steps of smoothing at most; it ends when no face cuts another. [>= 1, <= 200]
        """
class _Prior(Family):
    def align(self, name: str = "", *, relative: Wire[DepthMaps] | Node, measured: Wire[DepthMaps] | Node, reach: float | Parameter = 0.03, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> DepthsNode:
        """Bring relative depth maps to the world by measured depths: scale and shift of each view, corrected nearby.

        reach: How far measured depths correct the fit around them, and beyond which there is none; 0: fit alone. [picture widths, >= 0, <= 1]
        """
    def depth_anything(self, name: str = "", *, views: Wire[Views] | Node, model: str | Parameter = "depth-anything/DA3-BASE", revision: str | Parameter = "", weights: str | PathLike[str] | None | Parameter = None, resolution: int | Parameter = 504, batch: int | Parameter = 8, cameras: bool | Parameter = True, device: Literal["auto", "cpu", "cuda"] | Parameter = "auto", seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> DepthsNode:
        """Relative depth by Depth Anything 3; needs the optional package and its weights (docs/data.md).

        model: Model on the Hugging Face hub; unused where weights are given. [min_length 1]
        revision: Branch, tag or commit of the model; empty: the newest.
        weights: Folder with config.json and model.safetensors, instead of the hub.
        resolution: Longest side of the pictures in the network. [pixels, >= 56, <= 4096]
        batch: Views that the network sees at once; bounds memory. [views, >= 1]
        cameras: Tell the network the cameras; false for the monocular and metric models.
        device: Where to compute.
        """
    def depth_files(self, name: str = "", *, views: Wire[Views] | Node, folder: str | PathLike[str] | Parameter, frame: Wire[Frame] | Node | None = None, pattern: str | Parameter = "{name}", scale: float | Parameter = 1.0, units: Literal["normalised", "scene", "relative"] | Parameter = "scene", seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> DepthsNode:
        """Depth along the camera's axis, one file for each view.

        folder: Folder with one depth map (EXR, NPY or 16-bit PNG) for each view.
        pattern: File name in `folder` of a view's map, with {name} or {stem}; the ending may be left out.
        scale: File values times this give the stated units (0.001 for millimetres as integers). [> 0]
        units: After scaling: the normalised world's, the scene's own (then wire `frame`), or relative: right up to a scale and a shift of each map, as networks give it (for the depth loss, or prior.align).
        """
    def depth_from_gaussians(self, name: str = "", *, gaussians: Wire[PlanarGaussians] | Node, views: Wire[Views] | Node, surface: Literal["middle", "blended"] | Parameter = "middle", incidence: float | Parameter = 80.0, agreeing: int | Parameter = 1, tolerance: float | Parameter = 0.01, outward: float | Parameter = 0.5, threads: int | Parameter = 0, device: Literal["auto", "cpu", "cuda"] | Parameter = "auto", seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> DepthsNode:
        """Depth maps of fitted Gaussians, without grazing planes and what neighbouring views contradict.

        surface: Plane of the Gaussian at which half of the light is gone, or all planes blended.
        incidence: Drop planes seen at more than this angle. [degrees, > 0, <= 90]
        agreeing: Neighbours that must show the same point; 0: none asked. [views, >= 0]
        tolerance: How far those may be off, as a share of the depth. [> 0, <= 1]
        outward: Added along the surface's normal: a fit shrinks the object by about so much. [px, >= 0, <= 4]
        threads: CPU cores that kernels share; 0 takes all of this process. [>= 0]
        device: Where to compute; auto takes a CUDA device if there is one.
        """
    def patch_match(self, name: str = "", *, views: Wire[Views] | Node, points: Wire[PointCloud] | Node | None = None, side: int | Parameter = 640, sources: int | Parameter = 4, best: int | Parameter = 2, window: int | Parameter = 5, step: int | Parameter = 2, trials: int | Parameter = 2, min_score: float | Parameter = 0.4, agreeing: int | Parameter = 2, tolerance: float | Parameter = 0.01, threads: int | Parameter = 0, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> DepthsNode:
        """Depth from the photographs alone, dense: planes that spread from pixel to pixel (PatchMatch stereo).

        side: Compare pictures whose longer side is at most this. [px, >= 32]
        sources: Views compared with, about 15 degrees away. [views, >= 1, <= 16]
        best: How many of them, the most alike, decide at a pixel. [views, >= 1, <= 8]
        window: Side of the compared windows; odd. [samples, >= 3, <= 9]
        step: Between a window's samples; 1: finer, where paint is rich. [pixels, >= 1, <= 3]
        trials: Random planes tried at a pixel in an iteration. [planes, >= 0, <= 16]
        min_score: Least confidence in views without a mask; with one, other views alone decide. [>= -1, <= 1]
        agreeing: Neighbours, of up to eight, that must have found the same point. [views, >= 0]
        tolerance: How far those may be off, as a share of the depth. [> 0, <= 1]
        threads: CPU cores that kernels share; 0 takes all of this process. [>= 0]
        """
    def plane_sweep(self, name: str = "", *, views: Wire[Views] | Node, planes: int | Parameter = 128, neighbours: int | Parameter = 4, window: int | Parameter = 9, downscale: int | Parameter = 2, min_score: float | Parameter = 0.6, agreeing: int | Parameter = 2, tolerance: float | Parameter = 0.01, threads: int | Parameter = 0, device: Literal["auto", "cpu", "cuda"] | Parameter = "auto", seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> DepthsNode:
        """Depth from the photographs alone: where windows of neighbouring views correlate best (plane sweep).

        planes: Depths tried for every pixel, over the unit sphere. [>= 8, <= 1024]
        neighbours: Views compared with, about 10 degrees away. [views, >= 1, <= 16]
        window: Side of the compared windows, in reduced pictures; odd. [pixels, >= 3, <= 31]
        downscale: Compare pictures reduced by this factor. [>= 1, <= 16]
        min_score: Least correlation of the windows. [>= -1, <= 1]
        agreeing: Neighbours that must have found the same point. [views, >= 0]
        tolerance: How far those may be off, as a share of the depth. [> 0, <= 1]
        threads: CPU cores that kernels share; 0 takes all of this process. [>= 0]
        device: Where to compute; auto takes a CUDA device if there is one.
        """
class _Regulariser(Family):
    def bilaplacian(self, name: str = "", *, weight: float | Parameter = 0.3, edge: float | Parameter = 0.0, normals: float | Parameter = 0.0, normals_width: float | Parameter = 0.02) -> Node:
        """The Laplacian's square, which does not shrink round shapes; the default.

        weight: Weight of L_s in its scale-free form; 0: none. [>= 0]
        edge: Edge that the weight suits: where edges span more pixels, it falls with their square, to a quarter at most; 0: any edge. [pixels, >= 0]
        normals: Weight of how much normals vary beside it: walls come out flat, creases stay. 0: none. [>= 0]
        normals_width: Bends between two faces below this cost by their square, so that round stays round. [rad, > 0]
        """
    def laplacian(self, name: str = "", *, weight: float | Parameter = 0.3, units: Literal["edges", "world"] | Parameter = "edges") -> Node:
        """The paper's Laplacian, divided by the squared mean edge length.

        weight: Weight of L_s, per square of `units`; 0: no smoothness. [>= 0]
        units: What distances are measured in: mean edge lengths, or units of the normalised world (the paper).
        """
    def large_steps(self, name: str = "", *, strength: float | Parameter = 19.0) -> Node:
        """Preconditioned steps (Nicolet et al. 2021): smooth motions are fast, noise is damped, no term in the loss.

        strength: lambda of the paper; the filter reaches about its root, in edges. [>= 0]
        """
class _Scene(Family):
    def probe(self, name: str = "", *, carrier: Wire[Carrier] | Node, views: Wire[Views] | Node, threads: int | Parameter = 0, thorough: bool | Parameter = True, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> NeedsDecisionsNode:
        """Measure on a few coarse training views whether indirect light, a metallic map, finer maps or sky pay.

        threads: CPU cores that kernels share; 0 takes all of this process. [>= 0]
        thorough: Ask with two more fits of 500 steps whether the light should move alone at first (light_first), and look for a little metal with 36 views; false: it does not, and the look is a quick one with 16 views.
        """
class _Stage1(Family):
    def balance(self, name: str = "", *, views: Wire[Views] | Node, mesh: Wire[Mesh] | Node, exposure: Literal["auto", "on", "off"] | Parameter = "auto", wander: float | Parameter = 0.07, beyond_gloss: float | Parameter = 0.75, threads: int | Parameter = 0, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> ViewsDecisionsNode:
        """The photographs as one exposure and white balance would have taken them, where theirs wander.

        exposure: Take exposure and white balance out of the views: where they wander, always, never.
        wander: auto: least deviation of a view's brightness from its neighbours' that counts. [stops, >= 0]
        beyond_gloss: auto: the same, as a share of how parts of one view differ by gloss and shadows. [>= 0]
        threads: CPU cores that kernels share; 0 takes all of this process. [>= 0]
        """
    def init(self, name: str = "", *, carrier: Wire[Carrier] | Node, views: Wire[Views] | Node, appearance: Plug[Appearance] | Appearance | Node | None = None, threads: int | Parameter = 0, device: Literal["auto", "cpu", "cuda"] | Parameter = "auto", texture: Literal["views", "carrier", "grey"] | Parameter = "views", seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> StateNode:
        """Start Stage I: colour the carrier's atlas from the photographs, optimiser moments at zero.

        threads: CPU cores that kernels share; 0 takes all of this process. [>= 0]
        device: Where to compute; auto takes a CUDA device if there is one.
        texture: First texture: projected from the photographs, the carrier's own, or plain grey.
        """
    def refine(self, name: str = "", *, state: Wire[Stage1State] | Node, views: Wire[Views] | Node, depths: Wire[DepthMaps] | Node | None = None, smoothness: Plug[Smoothness] | Smoothness | Node | None = None, region: Wire[Mesh] | Node | None = None, appearance: Plug[Appearance] | Appearance | Node | None = None, iterations: int | Parameter = 500, total_iterations: int | Parameter = 0, vertex_lr: float | Parameter = 0.02, vertex_decay: float | Parameter = 0.025, vertex_hold: float | Parameter = 0.27, evidence: float | Parameter = 0.0, gloss_firmness: float | Parameter = 0.0, texture_lr: float | Parameter = 0.02, texture_decay: float | Parameter = 0.05, ssim_weight: float | Parameter = 0.2, silhouette: Literal["l1", "bce"] | Parameter = "l1", silhouette_weight: float | Parameter = 5.0, coverage_weight: float | Parameter = 1.0, hold_unseen: bool | Parameter = True, deviation_weight: float | Parameter = 0.0, facing_weight: float | Parameter = 1.0, depth_weight: float | Parameter = 0.01, gradient_decay: float | Parameter = 0.95, uv_gradient: bool | Parameter = True, gains: bool | Parameter = False, downscale: int | Parameter = 1, memory_gib: float | Parameter = 4.0, fill_unseen: bool | Parameter = True, threads: int | Parameter = 0, device: Literal["auto", "cpu", "cuda"] | Parameter = "auto", share: float | Parameter = 0.0, seconds: float | Parameter = 0.0, vertex_units: Literal["edges", "world"] | Parameter = "edges", deviation_units: Literal["edges", "world"] | Parameter = "edges", seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> StateHistoryNode:
        """Move vertices and texels against the photographs on a fixed topology.

        iterations: Iterations of this round, one view each. [>= 0]
        total_iterations: Length of the whole Stage I, over which learning rates decay; 0 = up to this round's end. [>= 0]
        vertex_lr: Length of a vertex's step at the start (mean edge of the round's mesh). [mean edge lengths, >= 0, <= 1]
        vertex_decay: A vertex's step ends at this share of its start. [> 0, <= 1]
        vertex_hold: Of the schedule, how long a vertex's step stays as long as at the start. [>= 0, < 1]
        evidence: Without masks: vertices whose gradients are below this share of the median's take shorter steps. Where pictures are silent (blown out, dark, unpainted) Adam makes full steps of what little they say. 0: does not. [of the median, >= 0]
        gloss_firmness: How much firmer the surface is where it shines: smoothness pulls up to 1 + this times as much where its brightness changes from view to view (by 0.4 stops; from 0.15 on). Highlights that wander else end as dents. 0: alike everywhere. [>= 0]
        texture_lr: Step of a texel at the start, in sRGB-encoded units. [>= 0, <= 1]
        texture_decay: A texel's step ends at this share of its start. [> 0, <= 1]
        ssim_weight: Share of D-SSIM, (1 - SSIM) / 2, in the colour loss (lambda_ssim). [>= 0, <= 1]
        silhouette: Silhouette loss: l1, or the paper's cross-entropy.
        silhouette_weight: Weight of the silhouette loss; unused without masks. [>= 0]
        coverage_weight: Weight of what stays uncovered inside the region; used where one is wired. [>= 0]
        hold_unseen: Vertices that fewer than two views show stay, and follow those around them when the round ends. Smoothness alone would bend what nothing is known of.
        deviation_weight: Weight of L_b, neighbours moving alike, in its scale-free form. [>= 0]
        facing_weight: Weight of what shows a closed surface from behind: sides of thin sheets that changed places. [>= 0]
        depth_weight: Weight of the depth correlation L_d; used where depths are wired. [>= 0]
        gradient_decay: beta_g of the vertices' gradient average (eq. 1). [>= 0, < 1]
        uv_gradient: Let colour move vertices inside the silhouette too.
        gains: Fit one factor per view and channel, for photographs of wandering exposure.
        downscale: Work on pictures reduced by this factor. [>= 1, <= 16]
        memory_gib: Memory for pictures ready to be compared; of a larger set the rest is made anew at each visit. [GiB, >= 0]
        fill_unseen: Fill texels that this round never touched from their neighbours.
        threads: CPU cores that kernels share; 0 takes all of this process. [>= 0]
        device: Where to compute; auto takes a CUDA device if there is one.
        share: This round's part of total_iterations; above 0 it stands in place of iterations. [>= 0, <= 1]
        seconds: Processor time of the whole Stage I, by a fixed estimate from the pictures' size: above 0 it decides total_iterations, of which this round takes its `share`. [s, >= 0]
        vertex_units: Unit of vertex_lr: mean edges of the round's mesh, or the normalised world's (the paper).
        deviation_units: Unit of the distances in L_b: mean edges of the round's mesh, or the world's (the paper).
        """
class _Stage2(Family):
    def fit(self, name: str = "", *, carrier: Wire[Carrier] | Node, views: Wire[Views] | Node, transport: Wire[Transport | MonteCarlo] | Node | Plug[Any], start: Wire[Asset] | Node | None = None, needs: Wire[SceneNeeds] | Node | None = None, prior: Plug[MaterialPrior] | MaterialPrior | Node | None = None, threads: int | Parameter = 0, device: Literal["auto", "cpu", "cuda"] | Parameter = "auto", material_rate: float | Parameter = 0.0025, environment_rate: float | Parameter = 0.015, factor_rate: float | Parameter = 0.003, rate_decay: float | Parameter = 0.1, rates_for: int | Parameter = 0, log_weight: float | Parameter = 1.0, ssim_weight: float | Parameter = 0.2, material_weight: float | Parameter = 0.1, variation: Literal["linear", "log"] | Parameter = "linear", gloss_weight: float | Parameter = 1.0, environment_weight: float | Parameter = 0.1, above_weight: float | Parameter = 0.0, level_weight: float | Parameter = 0.0, chroma_weight: float | Parameter = 0.1, indirect_weight: float | Parameter = 1.0, indirect_ramp: int | Parameter = 1000, metal_weight: float | Parameter = 0.0, metal_variation: float | Parameter = 1.0, palette_width: float | Parameter = 0.0, corrections: int | Parameter = 4, correction_samples: int | Parameter = 16, min_coverage: float | Parameter = 0.99, roughness_min: float | Parameter = 0.08, keep_light: bool | Parameter = False, exposure: bool | Parameter = False, memory_gib: float | Literal["auto"] | Parameter = "auto", texture_size: int | Literal["auto"] | Parameter = 0, environment_height: int | Literal["auto"] | Parameter = 256, iterations: int | Parameter = 10000, light_first: float | Literal["auto"] | Parameter = 0.0, glossy_first: float | Parameter = 0.0, metallic: bool | Literal["auto"] | Parameter = False, metal_share: float | Parameter = 0.0, normal_map: bool | Parameter = False, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> AssetHistoryNode:
        """Recover base colour, roughness and environment from the training views (paper, section 5).

        threads: CPU cores that kernels share; 0 takes all of this process. [>= 0]
        device: Where to compute; auto takes a CUDA device if there is one.
        material_rate: Learning rate of the maps (logits). [> 0]
        environment_rate: Learning rate of the environment (softplus parameters). [> 0]
        factor_rate: Learning rate of the common factor of base colour and light (logarithm); 0 = left to the texels. [>= 0]
        rate_decay: Last learning rate over the first; exponential in between. [> 0, <= 1]
        rates_for: Length the rates suit: a longer fit takes them times the root of this over its own length, the factor's times this over it; 0: as they are. [iterations, >= 0]
        log_weight: lambda_log of eq. 21. [>= 0]
        ssim_weight: lambda_ssim of eq. 21, for (1 - SSIM) / 2 as in Stage I; 0 leaves it out. [>= 0]
        material_weight: lambda_mat: screen-space total variation of the maps. [>= 0]
        variation: Total variation of base colour itself (eq. 23) or of its logarithm, which has no say in how bright the light is: smoothing linear base colour darkens it, and the light makes up for that.
        gloss_weight: How much the variation of roughness and metallic counts against that of base colour. [>= 0]
        environment_weight: lambda_env: total variation of the environment. [>= 0]
        above_weight: Weight of the square of how much lower the light stands than that of skies and rooms, in deviations. [>= 0]
        level_weight: Weight of the square of how much brighter than usual base colours are on the whole, in deviations; the common factor alone follows it (not at factor_rate 0). [>= 0]
        chroma_weight: lambda_chroma at the start; falls linearly to 0. [>= 0]
        indirect_weight: Target of lambda_ind, the weight of interreflection. [>= 0]
        indirect_ramp: Iterations until lambda_ind is reached. [iterations, >= 0]
        metal_weight: Weight of mean m (1 - m) over texels of metallic m: a surface is metal or none. From 0 in the second half of the steps, when the light is found, to all of it. [>= 0]
        metal_variation: How many times material_weight counts in a fit with a metallic map, whose texels have one thing more to decide. [>= 0]
        palette_width: Width, in the logarithm of base colour, within which colours are drawn to the paint that they gather about (mean shift): up to three times on the way, after which the light moves alone for a while, to explain what was shade and no paint; colours of metal within three times that; 0: each texel for itself. [>= 0, <= 1]
        corrections: How often rays re-measure the specular term; 0 = never. [>= 0, <= 100]
        correction_samples: Rays of a pixel each time, those of its neighbours counted as far as they tell. [rays, >= 1, <= 1024]
        min_coverage: Mask alpha from which a pixel takes part. [> 0, <= 1]
        roughness_min: Lower end of the roughness map. [>= 0.03, < 0.5]
        keep_light: Keep the environment of `start`, a known light, and fit the maps alone.
        exposure: Fit one gain per view, for photographs of varying exposure.
        memory_gib: Memory that the views' buffers may take, the others are made anew at each visit; auto: half of what is free, 4 at least. [GiB]
        texture_size: Side of the maps; 0 keeps the Stage I texture's. [texels, >= 0, <= 8192, or auto, by needs]
        environment_height: Rows of the recovered environment; twice as many columns. [texels, >= 8, <= 1024, or auto, by needs]
        iterations: Adam steps of one training view each. [>= 1]
        light_first: Share of the steps, the first, that move the light alone, so that what differs from wall to wall is the light's first and the paint's after; no such steps under keep_light. [>= 0, < 1, or auto, by needs]
        glossy_first: Share of the steps, the first, that begin from a roughness of 0.2 at most where a metallic map is fitted, so that the light is found by what mirrors it; then roughness begins again, as `start` has it, and the light waits for a tenth of the steps. No such steps without metal, nor under keep_light. [>= 0, < 1]
        metallic: Fit a metallic map, from `start`'s or 0.2. [or auto, by needs]
        metal_share: Share of metal among texels of like colour, at half of the steps, from which those are metal that have some of it near; what lies among metal is metal as well. 0: each texel decides alone, as it should in a fit that goes on from another, whose texels have agreed. [>= 0, < 1]
        normal_map: Fit a tangent-space normal map (+Y up), from `start`'s or flat; the probe does not judge it.
        """
    def init(self, name: str = "", *, carrier: Wire[Carrier] | Node, needs: Wire[SceneNeeds] | Node | None = None, transport: Wire[Transport] | Node | None = None, views: Wire[Views] | Node | None = None, base_color: Literal["texture", "gray", "tint"] | Parameter = "texture", level: float | Parameter = 0.36, roughness: float | Literal["auto"] | Parameter = 0.5, metallic: float | Parameter = 0.0, above: float | Parameter = 0.0, key_light: bool | Literal["auto"] | Parameter = False, light_moves: Literal[False, "turntable", "camera"] | Literal["auto"] | Parameter = False, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> AssetNode:
        """Where stage2.fit starts: base colour of the Stage I texture or one colour, else neutral, under white light.

        base_color: The Stage I texture, linearised (the paper); mid-gray; or one colour, the texture's mean at `level`, so that the light starts white.
        level: Luminance of the base colour that `tint` starts from. [> 0, < 1]
        roughness: Neutral roughness; auto: low where the probe finds that a fit from 0.5 misses sharp reflections. [> 0, < 1, or auto, by needs]
        metallic: Metallic; above 0 only for fits with metallic: true. [>= 0, <= 1]
        above: How much brighter than on average the sky is straight above, and darker below. [>= 0, <= 0.95]
        key_light: Look in Stage I's texture for a sun, or a lamp that outshines all else, and start with it, whose shadows end in the base colour otherwise. [or auto, by needs, takes transport]
        light_moves: What the light moves with: nothing; as lamps beside a turntable, about the axis that level cameras stand around; with the camera in every way, as its own flash. [or auto, by needs, takes views]
        """
    def retouch(self, name: str = "", *, asset: Wire[Asset] | Node, views: Wire[Views] | Node, needs: Wire[SceneNeeds] | Node | None = None, prior: Plug[MaterialPrior] | MaterialPrior | Node | None = None, threads: int | Parameter = 0, device: Literal["auto", "cpu", "cuda"] | Parameter = "auto", bounces: int | Literal["auto"] | Parameter = 1, deeper: bool | Parameter = False, secondary_material: bool | Parameter = True, directions: int | Parameter = 128, points: int | Parameter = 12000, material_rate: float | Parameter = 0.1, environment_rate: float | Parameter = 0.2, factor_rate: float | Parameter = 0.01, rate_decay: float | Parameter = 0.1, rates_for: int | Parameter = 0, log_weight: float | Parameter = 1.0, ssim_weight: float | Parameter = 0.2, material_weight: float | Parameter = 0.1, variation: Literal["linear", "log"] | Parameter = "linear", gloss_weight: float | Parameter = 1.0, environment_weight: float | Parameter = 0.1, above_weight: float | Parameter = 0.0, level_weight: float | Parameter = 0.0, chroma_weight: float | Parameter = 0.1, indirect_weight: float | Parameter = 1.0, indirect_ramp: int | Parameter = 1000, metal_weight: float | Parameter = 0.0, metal_variation: float | Parameter = 1.0, palette_width: float | Parameter = 0.0, corrections: int | Parameter = 4, correction_samples: int | Parameter = 16, min_coverage: float | Parameter = 0.99, roughness_min: float | Parameter = 0.08, keep_light: bool | Parameter = False, exposure: bool | Parameter = False, memory_gib: float | Literal["auto"] | Parameter = "auto", iterations: int | Parameter = 300, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> AssetHistoryNode:
        """Fit the materials and the light of a finished asset again, on the shape that stage3.refine gave it.

        threads: CPU cores that kernels share; 0 takes all of this process. [>= 0]
        device: Where to compute; auto takes a CUDA device if there is one.
        bounces: Diffuse interreflections to add; the paper has 1. 0 hands the direct light on. [>= 0, <= 16, or auto, by needs]
        deeper: Bounces beyond these count too: in a fit as they were a step before, which costs no more; the paper has none.
        secondary_material: Light from the mesh carries the maps of where it comes from; else the receiver's own (an ablation).
        directions: Equal-area directions traced from every surface point. [>= 16, <= 8192]
        points: Least number of surface points, spread over the mesh by the size of its faces. [>= 1, <= 2000000]
        material_rate: Learning rate of the maps (logits). [> 0]
        environment_rate: Learning rate of the environment (softplus parameters). [> 0]
        factor_rate: Learning rate of the common factor of base colour and light (logarithm); 0 = left to the texels. [>= 0]
        rate_decay: Last learning rate over the first; exponential in between. [> 0, <= 1]
        rates_for: Length the rates suit: a longer fit takes them times the root of this over its own length, the factor's times this over it; 0: as they are. [iterations, >= 0]
        log_weight: lambda_log of eq. 21. [>= 0]
        ssim_weight: lambda_ssim of eq. 21, for (1 - SSIM) / 2 as in Stage I; 0 leaves it out. [>= 0]
        material_weight: lambda_mat: screen-space total variation of the maps. [>= 0]
        variation: Total variation of base colour itself (eq. 23) or of its logarithm, which has no say in how bright the light is: smoothing linear base colour darkens it, and the light makes up for that.
        gloss_weight: How much the variation of roughness and metallic counts against that of base colour. [>= 0]
        environment_weight: lambda_env: total variation of the environment. [>= 0]
        above_weight: Weight of the square of how much lower the light stands than that of skies and rooms, in deviations. [>= 0]
        level_weight: Weight of the square of how much brighter than usual base colours are on the whole, in deviations; the common factor alone follows it (not at factor_rate 0). [>= 0]
        chroma_weight: lambda_chroma at the start; falls linearly to 0. [>= 0]
        indirect_weight: Target of lambda_ind, the weight of interreflection. [>= 0]
        indirect_ramp: Iterations until lambda_ind is reached. [iterations, >= 0]
        metal_weight: Weight of mean m (1 - m) over texels of metallic m: a surface is metal or none. From 0 in the second half of the steps, when the light is found, to all of it. [>= 0]
        metal_variation: How many times material_weight counts in a fit with a metallic map, whose texels have one thing more to decide. [>= 0]
        palette_width: Width, in the logarithm of base colour, within which colours are drawn to the paint that they gather about (mean shift): up to three times on the way, after which the light moves alone for a while, to explain what was shade and no paint; colours of metal within three times that; 0: each texel for itself. [>= 0, <= 1]
        corrections: How often rays re-measure the specular term; 0 = never. [>= 0, <= 100]
        correction_samples: Rays of a pixel each time, those of its neighbours counted as far as they tell. [rays, >= 1, <= 1024]
        min_coverage: Mask alpha from which a pixel takes part. [> 0, <= 1]
        roughness_min: Lower end of the roughness map. [>= 0.03, < 0.5]
        keep_light: Keep the environment of `start`, a known light, and fit the maps alone.
        exposure: Fit one gain per view, for photographs of varying exposure.
        memory_gib: Memory that the views' buffers may take, the others are made anew at each visit; auto: half of what is free, 4 at least. [GiB]
        iterations: Adam steps of one training view each; 0: the asset stays as it is. [>= 0]
        """
class _Stage3(Family):
    def refine(self, name: str = "", *, asset: Wire[Asset] | Node, views: Wire[Views] | Node, transport: Wire[Transport] | Node, smoothness: Plug[Smoothness] | Smoothness | Node | None = None, region: Wire[Mesh] | Node | None = None, iterations: int | Parameter = 300, vertex_lr: float | Parameter = 0.008, vertex_decay: float | Parameter = 0.18, texture_lr: float | Parameter = 0.0027, texture_decay: float | Parameter = 0.37, ssim_weight: float | Parameter = 0.2, silhouette_weight: float | Parameter = 5.0, gains: bool | Parameter = False, evidence: float | Parameter = 0.0, lobe_samples: int | Parameter = 16, memory_gib: float | Parameter = 4.0, threads: int | Parameter = 0, device: Literal["auto", "cpu", "cuda"] | Parameter = "auto", seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> AssetHistoryNode:
        """Move the vertices of a finished asset: highlights and shading of its own light now say where its normals point.

        iterations: Iterations, one view each; 0: the asset stays as it is. [>= 0]
        vertex_lr: Length of a vertex's step at the start. [mean edge lengths, >= 0, <= 1]
        vertex_decay: A vertex's step ends at this share of its start. [> 0, <= 1]
        texture_lr: Step of a texel at the start, in sRGB-encoded units. [>= 0, <= 1]
        texture_decay: A texel's step ends at this share of its start. [> 0, <= 1]
        ssim_weight: Share of D-SSIM, (1 - SSIM) / 2, in the colour loss. [>= 0, <= 1]
        silhouette_weight: Weight of the silhouette loss; unused without masks. [>= 0]
        gains: Fit one factor per view and channel, for photographs of wandering exposure.
        evidence: Without masks: vertices whose gradients are below this share of the median's take shorter steps. 0: no. [of the median, >= 0]
        lobe_samples: Rays of a vertex's specular lobe, per view, before the start. [>= 1, <= 1024]
        memory_gib: Memory for pictures ready to be compared; of a larger set the rest is made anew at each visit. [GiB, >= 0]
        threads: CPU cores that kernels share; 0 takes all of this process. [>= 0]
        device: Where to compute; auto takes a CUDA device if there is one.
        """
class _Transport(Family):
    def bounce(self, name: str = "", *, light: Wire[Transport] | Node, needs: Wire[SceneNeeds] | Node | None = None, bounces: int | Literal["auto"] | Parameter = 1, deeper: bool | Parameter = False, secondary_material: bool | Parameter = True, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> TransportNode:
        """Build the interreflection operator from the secondary hits and switch it on.

        bounces: Diffuse interreflections to add; the paper has 1. 0 hands the direct light on. [>= 0, <= 16, or auto, by needs]
        deeper: Bounces beyond these count too: in a fit as they were a step before, which costs no more; the paper has none.
        secondary_material: Light from the mesh carries the maps of where it comes from; else the receiver's own (an ablation).
        """
    def direct(self, name: str = "", *, mesh: Wire[Carrier] | Node, directions: int | Parameter = 128, points: int | Parameter = 12000, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> TransportNode:
        """Trace the visibility and the secondary hits of the mesh along fixed directions.

        directions: Equal-area directions traced from every surface point. [>= 16, <= 8192]
        points: Least number of surface points, spread over the mesh by the size of its faces. [>= 1, <= 2000000]
        """
    def monte_carlo(self, name: str = "", *, technique: Literal["environment", "brdf", "mis", "cosine"] | Literal["auto"] | Parameter = "environment", samples: int | Parameter = 8, bounces: Literal[0, 1] | Parameter = 1, secondary_rays: int | Parameter = 16, secondary_samples: int | Parameter = 4, half_resolution: bool | Parameter = True, secondary_material: bool | Parameter = True, secondary_lobes: bool | Parameter = False, kept: int | Parameter = 0, independent_gradient: bool | Parameter = True) -> Node:
        """The paper's Monte Carlo light, drawn in every step; the defaults are its sample counts.

        technique: Where direct samples go; mis = half to the environment, half to the lobes. [or auto, by needs]
        samples: N_d, direct samples per pixel. [rays, >= 2, <= 4096]
        bounces: 0: direct light only; 1: one diffuse bounce.
        secondary_rays: N_b, rays per pixel that look for the mesh. [rays, >= 1, <= 4096]
        secondary_samples: N_s, light samples at each secondary hit. [rays, >= 1, <= 4096]
        half_resolution: Secondary rays for one pixel of each 2 x 2 block, then upsampled.
        secondary_material: Secondary hits read the maps; else the primary point's material stands in (an ablation).
        secondary_lobes: Hits also send what their lobes reflect, as precomputed light has it; the paper's do not.
        kept: Estimates per view whose rays are kept between corrections; 0: none. [estimates, >= 0, <= 64]
        independent_gradient: Draw the gradient's samples by a seed of their own, or from the next kept ones: a fit with less bias.
        """
class _Usd(Family):
    def compose(self, name: str = "", *, light: Wire[EnvMap] | Node, first: Wire[UsdAsset] | Node, second: Wire[UsdAsset] | Node | None = None, third: Wire[UsdAsset] | Node | None = None, height: float | Parameter = 0.3, turn: tuple[float, ...] | list[float] | Parameter = ..., gap: float | Parameter = 0.15, table_color: tuple[float, ...] | list[float] | Parameter = ..., table_roughness: float | Parameter = 0.35, width: int | Parameter = 640, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> FilesNode:
        """Assets side by side on a table top under one light, as a USD scene that references them; with a camera.

        height: Every piece is scaled to this height. [m, > 0]
        turn: Turn of each piece about the vertical, in the order of the ports. [rad]
        gap: Room between the pieces, in heights. [>= 0]
        table_color: Base colour of the table, linear.
        table_roughness: Roughness of the table. [>= 0, <= 1]
        width: Width of the camera's picture. [px, >= 16, <= 8192]
        """
class _Uv(Family):
    def maintain(self, name: str = "", *, state: Wire[Stage1State] | Node, dilation: float | Parameter = 8.0, max_flipped: float | Parameter = 0.01, max_stretch: float | Parameter = 4.0, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> StateNode:
        """Check the atlas, drop unused UVs and spread the texture beyond its charts.

        dilation: How far colours are spread beyond charts. [texels, >= 0.0, <= 4096.0]
        max_flipped: Part of the faces folded over in the atlas before a warning. [>= 0.0, <= 1.0]
        max_stretch: Spread of texel sizes (95th over 5th percentile) before a warning. [>= 1.0]
        """
    def regenerate(self, name: str = "", *, state: Wire[Stage1State] | Node, views: Wire[Views] | Node | None = None, texture_size: int | Parameter = 0, padding: int | Parameter = 4, cut_nonmanifold: bool | Parameter = True, bend: float | Parameter = 0.45, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> StateNode:
        """Make a new atlas and move texture and texture moments over, texel by texel.

        texture_size: Side of the new texture; 0: as fine as `views` show it, without views the old one's. [texels, >= 0, <= 8192]
        padding: Space kept free between charts. [texels, >= 0, <= 64]
        cut_nonmanifold: Cut a non-manifold mesh open where it is, with a warning, instead of refusing it.
        bend: How far a chart may bend, 1 - |mean normal|^2: more, fewer and more stretched charts. [> 0.0, < 1.0]
        """
    def unwrap(self, name: str = "", *, mesh: Wire[Mesh] | Node, views: Wire[Views] | Node | None = None, texture_size: int | Parameter = 1024, fill: float | Parameter = 0.5, padding: int | Parameter = 4, cut_nonmanifold: bool | Parameter = True, bend: float | Parameter = 0.45, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> CarrierNode:
        """Unwrap a mesh into an atlas of nearly flat discs, laid out as rigidly as possible; give it a grey texture.

        texture_size: Side of the square texture; 0: as fine as `views` show it, 1.25 pixels, in multiples of 64. [texels, >= 0, <= 8192]
        fill: Grey that the sRGB texture starts with. [>= 0.0, <= 1.0]
        padding: Space kept free between charts. [texels, >= 0, <= 64]
        cut_nonmanifold: Cut a non-manifold mesh open where it is, with a warning, instead of refusing it.
        bend: How far a chart may bend, 1 - |mean normal|^2: more, fewer and more stretched charts. [> 0.0, < 1.0]
        """
    def xatlas_regen(self, name: str = "", *, state: Wire[Stage1State] | Node, views: Wire[Views] | Node | None = None, texture_size: int | Parameter = 0, padding: int | Parameter = 4, cut_nonmanifold: bool | Parameter = True, max_cost: float | Parameter = 2.0, chart_iterations: int | Parameter = 1, max_seconds: float | Parameter = 120.0, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> StateNode:
        """Make a new atlas with the charts of xatlas and move texture and texture moments over, texel by texel.

        texture_size: Side of the new texture; 0: as fine as `views` show it, without views the old one's. [texels, >= 0, <= 8192]
        padding: Space kept free between charts. [texels, >= 0, <= 64]
        cut_nonmanifold: Cut a non-manifold mesh open where it is, with a warning, instead of refusing it.
        max_cost: xatlas: larger gives fewer and more stretched charts. [> 0.0, <= 64.0]
        chart_iterations: xatlas: rounds of chart growing. [>= 1, <= 8]
        max_seconds: When xatlas is not done by then, uv.unwrap's charts take its place, with a warning. [s, > 0.0]
        """
    def xatlas_unwrap(self, name: str = "", *, mesh: Wire[Mesh] | Node, views: Wire[Views] | Node | None = None, texture_size: int | Parameter = 1024, fill: float | Parameter = 0.5, padding: int | Parameter = 4, cut_nonmanifold: bool | Parameter = True, max_cost: float | Parameter = 2.0, chart_iterations: int | Parameter = 1, max_seconds: float | Parameter = 120.0, seed: int | Parameter = 0, at: dict[int, Any] = {}, every: dict[int, Any] = {}, each: str | list[str] = [], limits: dict[str, Any] = {}) -> CarrierNode:
        """Unwrap a mesh into an atlas with the charts of xatlas (slow on large or rough meshes); give it a grey texture.

        texture_size: Side of the square texture; 0: as fine as `views` show it, 1.25 pixels, in multiples of 64. [texels, >= 0, <= 8192]
        fill: Grey that the sRGB texture starts with. [>= 0.0, <= 1.0]
        padding: Space kept free between charts. [texels, >= 0, <= 64]
        cut_nonmanifold: Cut a non-manifold mesh open where it is, with a warning, instead of refusing it.
        max_cost: xatlas: larger gives fewer and more stretched charts. [> 0.0, <= 64.0]
        chart_iterations: xatlas: rounds of chart growing. [>= 1, <= 8]
        max_seconds: When xatlas is not done by then, uv.unwrap's charts take its place, with a warning. [s, > 0.0]
        """
class Families:
    def __init__(self, scope: NodeScope) -> None: ...
    def __getattr__(self, name: str) -> Family: ...
    appearance: _Appearance
    benchmark: _Benchmark
    data: _Data
    edit: _Edit
    evaluate: _Evaluate
    export: _Export
    gallery: _Gallery
    init: _Init
    mask: _Mask
    material: _Material
    mesh: _Mesh
    prior: _Prior
    regulariser: _Regulariser
    scene: _Scene
    stage1: _Stage1
    stage2: _Stage2
    stage3: _Stage3
    transport: _Transport
    usd: _Usd
    uv: _Uv
