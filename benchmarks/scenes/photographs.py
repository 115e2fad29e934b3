"""Photographs of a scene as a camera takes them: a lens that bends lines, noise of a sensor, exposures that vary, JPEG.

    python -m benchmarks.scenes.photographs duck --out graphs/samples/photos --worlds bpy-5.0.1-[...].whl

    python -m benchmarks.scenes.photographs teapot --table lacquer --light interior --out FOLDER/teapot --worlds FOLDER
    python -m benchmarks.scenes.photographs brush --table cloth --turntable --out FOLDER/turned --worlds FOLDER

With `--turntable` the table turns before a camera, lamps and a wall of books that stand still. With `--aperture` the
lens has a depth of field, with `--vignetting` it darkens the corners; with `--phone` the camera raises contrast, colour
and edges and writes a smaller file.
`images/*.jpg` are what data.photos takes; `truth/` holds the object's mesh and the cameras for tests. CC0.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import numpy as np

from benchmarks.scenes import files, lights
from benchmarks.scenes.cameras import FIELD, rings, spiral
from benchmarks.scenes.catalogue import RECIPES
from benchmarks.scenes.kinds import Recipe
from benchmarks.scenes.lights import WORLDS
from benchmarks.scenes.make import levelled, lit, turning
from benchmarks.scenes.model import Model, assemble, encode
from benchmarks.scenes.render import Stage
from benchmarks.scenes.tabletop import TOPS, books, on_table

#: Pixels, one photograph in `TURNED` upright; radial distortion of the lens.
WIDTH, HEIGHT, TURNED = 720, 540, 7
LENS = (-0.11, 0.03)
#: Variance of linear light: photons (per unit of light) and read noise; spread of exposure in stops.
PHOTONS, READ, STOPS = 6e-4, 2e-6, 0.08
QUALITY, SAMPLES, TEXELS, TRUE_FACES = 88, 36, 2048, 8000
#: What a telephone does: share of an S-shaped curve, colour over gray, an unsharp mask (pixels, share), JPEG.
CONTRAST, COLOUR, EDGES, PHONE_QUALITY = 0.5, 1.2, (1.2, 0.7), 70


def main() -> None:
    options = arguments()
    recipe, out = RECIPES[options.scene], options.out
    if options.table:
        recipe = on_table(recipe, options.table, options.light)
    if not recipe.ground:
        sys.exit(f"{options.scene} stands on nothing: --table {' | '.join(TOPS)}")
    for place in ("images", "truth"):
        (out / place).mkdir(parents=True, exist_ok=True)
    model = assemble(list(recipe.solids()), recipe.paint, TEXELS, recipe.ground)
    world = lights.world(recipe.light[0], options.worlds, recipe.light[1], 2 * lights.HEIGHT)
    light = levelled(world, recipe.level)
    turned = options.turntable
    poses = (
        rings(options.count, *recipe.heights) if turned else spiral(options.count, *recipe.heights, 0.0, recipe.seed)
    )
    moving = turning(light, poses, "turntable" if turned else "")
    stage = Stage(model, background=not turned, threads=options.threads, aperture=options.aperture)
    rng = np.random.default_rng(recipe.seed)
    cameras = {}
    for k, pose in enumerate(poses):
        upright = not turned and k % TURNED == TURNED - 1
        cameras[f"IMG_{1001 + k}.jpg"] = pose.tolist()
        gain = 2 ** np.clip(rng.normal(0, STOPS), -2 * STOPS, 2 * STOPS)
        noise = rng.normal(size=(HEIGHT, WIDTH, 3))
        path = out / "images" / f"IMG_{1001 + k}.jpg"
        if not path.is_file():
            held = pose @ rolled() if upright else pose  # a camera that is held upright is turned by a quarter
            seen = stage.picture(lit(stage, moving, k), held, side(), options.samples, recipe.seed * 10_000 + k)
            if turned:  # the wall is farther away: a camera that is put higher sees other books
                seen[..., :3] += (1 - seen[..., 3:]) * books(side(), round(1000 * pose[2, 3]))
            picture, quality = photographed(seen[..., :3] * gain, noise, options.vignetting), QUALITY
            if options.phone:
                picture, quality = pleasing(picture), PHONE_QUALITY
            _write(path, picture, upright, quality)
            print(path, flush=True)
    _truth(out / "truth", model, cameras, recipe)


def side() -> int:
    """Pixels on a side of the square that is rendered: a little finer than the photograph, and a rim for the lens."""
    return int(1.5 * WIDTH)


def focal() -> float:
    """Of the photograph, pixels: the middle of the rendered square fills it."""
    return WIDTH / 2 / math.tan(FIELD / 2) / 0.94


def photographed(light: np.ndarray, noise: np.ndarray, corner: float = 1.0) -> np.ndarray:
    """Display values [HEIGHT, WIDTH, 3] of a pinhole's linear light [S, S, 3], through the lens, with noise alike.

    The lens: x_d = x (1 + k1 r^2 + k2 r^4) of the pinhole's x = X / Z (Brown's radial terms), undone by iteration.
    It falls off as a cosine's fourth power does, 1 / (1 + a r^2)^2, to `corner` of the middle's light in the corners.
    """
    from scipy.ndimage import gaussian_filter, map_coordinates

    x, y = np.meshgrid((np.arange(WIDTH) + 0.5 - WIDTH / 2) / focal(), (np.arange(HEIGHT) + 0.5 - HEIGHT / 2) / focal())
    px, py = x, y
    for _ in range(20):
        r2 = px**2 + py**2
        bend = 1 + LENS[0] * r2 + LENS[1] * r2**2
        px, py = x / bend, y / bend
    fine = len(light)
    scale = fine / 2 / math.tan(FIELD / 2)
    at = np.stack([py * scale + fine / 2 - 0.5, px * scale + fine / 2 - 0.5])
    blurred = gaussian_filter(light, (0.45 * scale / focal(), 0.45 * scale / focal(), 0))  # a pixel's extent
    seen = np.stack([map_coordinates(blurred[..., c], at, order=1, mode="nearest") for c in range(3)], -1)
    r2 = px**2 + py**2
    seen *= (1 + r2 / r2[0, 0] * (corner**-0.5 - 1))[..., None] ** -2
    return encode(np.clip(seen + np.sqrt(PHOTONS * seen.clip(0) + READ) * noise, 0, 1))


def pleasing(picture: np.ndarray) -> np.ndarray:
    """Display values [H, W, 3] as a telephone gives them."""
    from scipy.ndimage import gaussian_filter

    gray = picture.mean(-1, keepdims=True)
    vivid = np.clip(gray + COLOUR * (picture - gray), 0, 1)
    curved = vivid + CONTRAST * (vivid**2 * (3 - 2 * vivid) - vivid)
    width, share = EDGES
    return np.clip(curved + share * (curved - gaussian_filter(curved, (width, width, 0))), 0, 1)


def rolled() -> np.ndarray:
    turn = np.eye(4)
    turn[:2, :2] = [[0, -1], [1, 0]]
    return turn


def _write(path: Path, picture: np.ndarray, upright: bool, quality: int) -> None:
    from PIL import Image

    image = Image.fromarray(np.round(255 * picture).astype(np.uint8))
    exif = Image.Exif()
    exif[0x0112] = 8 if upright else 1  # orientation
    exif[0x010F], exif[0x0110] = "exmesh-graph", "rendered"
    exif.get_ifd(0x8769)[0xA405] = round(focal() / WIDTH * 36)  # focal length of 35 mm film
    image.save(path, quality=quality, subsampling=2, exif=exif)


def _truth(folder: Path, model: Model, cameras: dict[str, list], recipe: Recipe) -> None:
    """object.ply, without the table and simplified, and cameras.json: camera-to-world of the upright pictures."""
    from exmesh_graph.native import import_open3d

    o3d = import_open3d()
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(model.vertices), o3d.utility.Vector3iVector(model.faces[model.of_object()])
    )
    mesh = mesh.remove_unreferenced_vertices().merge_close_vertices(1e-6).simplify_quadric_decimation(TRUE_FACES)
    mesh.vertex_normals, mesh.triangle_normals = o3d.utility.Vector3dVector(), o3d.utility.Vector3dVector()
    o3d.io.write_triangle_mesh(str(folder / "object.ply"), mesh)
    files.write_json(folder / "cameras.json", {
        "what": "camera-to-world of each picture as it is shown: x right, y up, looking along -z; z is up in the world",
        "radius": 1.2, "lens": {"k1": LENS[0], "k2": LENS[1], "focal_px": focal()}, "light": recipe.light[0],
        "camera_to_world": cameras,
    })  # fmt: skip


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", choices=list(RECIPES))
    parser.add_argument("--table", choices=list(TOPS), default="", help="stand it on one, seen from above")
    parser.add_argument("--light", choices=WORLDS, default="", help="with --table, instead of the scene's own")
    parser.add_argument("--turntable", action="store_true", help="the object turns; camera, lamps and wall stand still")
    parser.add_argument("--aperture", type=float, default=0.0, help="radius of the lens; the object's is about 1")
    parser.add_argument("--vignetting", type=float, default=1.0, help="light in the corners, of the middle's; 1: none")
    parser.add_argument("--phone", action="store_true", help="contrast, colour and edges raised, JPEG of lower quality")
    parser.add_argument("--samples", type=int, default=SAMPLES, help="rays of a pixel")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--worlds", type=Path, required=True, help="wheel of bpy 5.0.1, or a folder of its worlds")
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--threads", type=int, default=0)
    return parser.parse_args()


if __name__ == "__main__":
    main()
