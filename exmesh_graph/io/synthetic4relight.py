"""Synthetic4Relight as InvRender published it: NeRF-Synthetic's layout with linear training pictures and relit tests.

scene/transforms_{train,test}.json; train/000_rgb.exr (linear) and 000_mask.png; test/000_rgba.png, 000_albedo.png,
000_rough.png; test_rli/envmap6_000.png and envmap12_000.png. The maps, in Blender's lat-long orientation, lie beside
the scene: envmaps/envmap{3,6,12}.exr (InvRender's code/envmaps). envmap3 lit the training pictures; the published
relighting figure is the mean over the other two.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from exmesh_graph.errors import DataError
from exmesh_graph.io.blender import blender_files, list_blender
from exmesh_graph.io.settings import BlenderOptions, Synthetic4RelightOptions
from exmesh_graph.io.truth_files import MAP_FOLDERS, relit_light, relit_pictures

if TYPE_CHECKING:
    from exmesh_graph.io.scene import Scene

TRAINING_LIGHT = "envmap3"


def load_synthetic4relight(path: Path, options: Synthetic4RelightOptions | None = None) -> Scene:
    """Load a scene with the truth of its test views. DataError where one of `lights` has no pictures or no map."""
    from exmesh_graph.io.blender import load_blender
    from exmesh_graph.io.envmaps import canonical_from_blender, read_environment

    options = options or Synthetic4RelightOptions()
    check_layout(path, options)
    scene = load_blender(path, _blender(options))
    truth = scene.truth
    assert truth is not None  # the options ask for it
    light = relit_light(Path(path), TRAINING_LIGHT)
    environment = truth.environment
    if environment is None and light is not None:
        environment = canonical_from_blender(read_environment(light))
    chosen = replace(
        truth,
        environment=environment,
        relit={name: truth.relit[name] for name in options.lights},
        relit_alpha={name: truth.relit_alpha[name] for name in options.lights},
    )
    return replace(scene, truth=chosen)


def synthetic4relight_files(path: Path, options: Synthetic4RelightOptions) -> dict[str, Path]:
    """Every file that `load_synthetic4relight` reads."""
    check_layout(path, options)
    files = blender_files(path, _blender(options))
    light = relit_light(Path(path), TRAINING_LIGHT)
    return files if light is None else files | {f"{light.parent.name}/{light.name}": light}


def check_layout(path: Path, options: Synthetic4RelightOptions) -> None:
    """DataError unless training pictures are linear, and each of `lights` has a picture per test view and a map."""
    folder = Path(path)
    train, test, _ = list_blender(folder, _blender(options))
    clipped = [shot.image for shot in train if shot.image.suffix != ".exr"]
    if clipped:
        raise DataError(
            f"{len(clipped)} training pictures are not linear", where=str(clipped[0]), expected="<view>_rgb.exr",
            fix="unpack the data set's EXR files, or use data.blender for 8-bit pictures",
        )  # fmt: skip
    pictures = relit_pictures(folder, test, False)
    for light in options.lights:
        if light not in pictures:
            raise DataError(
                f"there are no pictures relit by {light}", where=str(folder / "test_rli"),
                expected=f"test_rli/{light}_{test[0].image.stem.removesuffix('_rgba')}.png and so on",
                fix=f"unpack the data set's test_rli, or set lights: {sorted(pictures)}",
            )  # fmt: skip
        if relit_light(folder, light) is None:
            raise DataError(
                f"the environment map {light} does not exist, so nothing can be relit by it", where=str(folder),
                expected=", ".join(f"{place}/{light}.exr" for place in MAP_FOLDERS),
                fix="put InvRender's code/envmaps beside the scenes",
            )  # fmt: skip


def _blender(options: Synthetic4RelightOptions) -> BlenderOptions:
    return BlenderOptions(
        downscale=options.downscale, max_views=options.max_views, max_test_views=options.max_test_views, test="file",
        checks=options.checks,
    )  # fmt: skip
