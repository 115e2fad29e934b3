"""Photographs as they should not be: `graphs/photos.yaml` ends with a result, or with an error that says what to do.

    python -m benchmarks.robust_photos FOLDER [--only NAME ...] [--node NODE ...] [--megapixels 0.2]

Folders of pictures are made from the two samples of the repository, a mirror ball and 200 pictures are drawn; then the
graph runs on each with `budget=1min`, up to `--node` (default: settle, look). A row says how it ended: cameras found,
pictures left out, whether masks were found, held-out PSNR and, of the decoy, the distance to its true surface
(`photo_sample`); or the error with its remedy. The exit status is 1 where a row failed without a remedy.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import exmesh_graph as ex
from benchmarks.drawn_photos import draw
from benchmarks.photo_sample import SAMPLE, against_truth

ROOT = Path(__file__).parents[1]
BALL, SIDE = 24, (270, 360)
_SECONDS, _RATE = 20, 15


def main() -> None:
    options = arguments()
    failed = []
    for name, make in ROWS.items():
        if options.only and name not in options.only:
            continue
        scene = make(_fresh(options.folder / name.replace(" ", "_")))
        print(f"{name:18} {outcome(name, scene, options, failed)}", flush=True)
    if failed:
        sys.exit(f"no remedy was named: {', '.join(failed)}")


def outcome(name: str, scene: Path, options: argparse.Namespace, failed: list[str]) -> str:
    """One line on how the graph ended."""
    runs = options.folder / "runs" / name.replace(" ", "_")
    command = [
        sys.executable, "-c", "from exmesh_graph.cli import main; main()", "run",
        str(ROOT / "graphs" / "photos.yaml"), "--set", f"scene={scene}",
        "--set", "budget=1min", "--set", f"views.megapixels={options.megapixels}", "--runs", str(runs),
        "--store", str(options.folder / "store"),
    ]  # fmt: skip
    for node in options.node:
        command += ["--node", node]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        said = done.stderr + done.stdout
        lines = [line.strip() for line in said.splitlines() if line.startswith("failed:") or line.strip()[:4] == "fix:"]
        if not any(line.startswith("fix:") for line in lines):
            failed.append(name)
        return " | ".join(lines) or said[-300:]
    run = ex.open_run(runs / "latest")
    figures = run["views"]["cameras"].values
    parts = [f"{figures['registered']} of {figures['pictures']} cameras"]
    if options.node != ["views"]:
        parts.append(f"masks {'found' if run['masked']['train'].has_masks else 'not found'}")
    parts += [f"left out ({reason}): {len(figures[reason])}" for reason in ("blurred", "alike") if figures.get(reason)]
    if "look" in options.node:
        parts += [f"{row['label']} {row['value']:.1f}" for row in run["look"]["metrics"].values["headline"][:1]]
    if "settle" in options.node and name in OF_THE_DECOY:
        sample = scene if (scene / "truth").is_dir() else SAMPLE
        parts.append(f"Chamfer {against_truth(run, sample)['chamfer']:.1f}")
    return ", ".join(parts)


def as_it_is(folder: Path) -> Path:
    for picture in _pictures():
        shutil.copy(picture, folder)
    return folder


def twelve(folder: Path) -> Path:
    for picture in _pictures()[::5] + _pictures()[2::5]:
        shutil.copy(picture, folder)
    return folder


def a_third_blurred(folder: Path) -> Path:
    from PIL import ImageFilter

    return _changed(folder, lambda k, image: image.filter(ImageFilter.GaussianBlur(3)) if k % 3 == 1 else image)


def two_exposures(folder: Path) -> Path:
    """Every other picture has half the light, which is 0.73 of the display value."""
    return _changed(folder, lambda k, image: image.point(lambda v: round(0.73 * v)) if k % 2 else image)


def half_upside_down(folder: Path) -> Path:
    """As a camera does that is held so and does not tell."""
    return _changed(folder, lambda k, image: image.rotate(180) if k % 2 else image)


def video(folder: Path) -> Path:
    """Twenty seconds: the camera stands at each place of the sample, for as long as it likes."""
    import av
    from PIL import Image, ImageOps

    path = folder / "clip.mp4"
    rng = np.random.default_rng(0)
    stays = rng.dirichlet(np.full(len(_pictures()), 2.0)) * _SECONDS * _RATE
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=_RATE)
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = 720, 540, "yuv420p", 12_000_000
        for picture, stay in zip(_pictures(), stays, strict=True):
            image = ImageOps.exif_transpose(Image.open(picture)).convert("RGB")
            image = image if image.width > image.height else image.rotate(90, expand=True)
            for _ in range(max(1, round(stay))):
                container.mux(stream.encode(av.VideoFrame.from_image(image)))
        container.mux(stream.encode())
    return path


def two_objects(folder: Path) -> Path:
    """The decoy, and the sample `spot` on black, in one folder."""
    from PIL import Image

    as_it_is(folder)
    for picture in sorted((ROOT / "graphs" / "samples" / "spot" / "train").glob("*.png"))[:30]:
        image = Image.open(picture).convert("RGBA")
        flat = Image.alpha_composite(Image.new("RGBA", image.size, (0, 0, 0, 255)), image).convert("RGB")
        flat.save(folder / f"spot_{picture.stem}.jpg", quality=95)
    return folder


def mirror_ball(folder: Path) -> Path:
    """A perfect mirror on a painted floor under a painted sky, drawn by its rays."""
    from PIL import Image

    rng = np.random.default_rng(0)
    floor = rng.random((64, 64, 3))
    for k in range(BALL):
        Image.fromarray((255 * _ball_picture(2 * np.pi * k / BALL, floor)).astype(np.uint8)).save(
            folder / f"ball_{k:02d}.png"
        )
    return folder


def two_hundred(folder: Path) -> Path:
    return draw(folder, 200)


def _ball_picture(angle: float, floor: np.ndarray) -> np.ndarray:
    height, width = SIDE
    eye = 4 * np.array([np.cos(angle) * 0.9, np.sin(angle) * 0.9, 0.45])
    forward = -eye / np.linalg.norm(eye)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    rays = x[..., None] * right + y[..., None] * down + 1.2 * width * forward
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    half = rays @ eye
    inner = half**2 - (eye @ eye - 1)
    hit = inner > 0
    at = eye + (-half - np.sqrt(np.maximum(inner, 0)))[..., None] * rays
    mirrored = rays - 2 * (rays * at).sum(-1, keepdims=True) * at
    return np.where(hit[..., None], _around(at, mirrored, floor), _around(np.broadcast_to(eye, at.shape), rays, floor))


def _around(origin: np.ndarray, rays: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """The floor z = -1 with its paint, else the sky: [H, W, 3]."""
    far = np.where(rays[..., 2] < -1e-3, (-1 - origin[..., 2]) / np.minimum(rays[..., 2], -1e-3), 0)
    place = origin + far[..., None] * rays
    cell = (np.floor(place[..., :2] * 4).astype(int)) % 64
    painted = floor[cell[..., 0], cell[..., 1]]
    sky = 0.5 + 0.4 * np.sin(np.stack([5 * rays[..., 0], 7 * rays[..., 1], 3 * rays[..., 2]], axis=-1))
    return np.where((far > 0)[..., None], painted, sky)


def _changed(folder: Path, change: Callable[[int, Any], Any]) -> Path:
    """The sample, upright, each picture changed by its number."""
    from PIL import Image, ImageOps

    for k, picture in enumerate(_pictures()):
        image = ImageOps.exif_transpose(Image.open(picture)).convert("RGB")
        change(k, image).save(folder / picture.name, quality=95)
    return folder


def _pictures() -> list[Path]:
    return sorted((SAMPLE / "images").glob("*.jpg"))


def _fresh(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder


ROWS: dict[str, Callable[[Path], Path]] = {
    "as it is": as_it_is,
    "twelve": twelve,
    "a third blurred": a_third_blurred,
    "two exposures": two_exposures,
    "half upside down": half_upside_down,
    "video": video,
    "two objects": two_objects,
    "mirror ball": mirror_ball,
    "two hundred": two_hundred,
}
OF_THE_DECOY = ("as it is", "twelve", "a third blurred", "two exposures", "half upside down", "two hundred")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="+", choices=list(ROWS), default=[])
    parser.add_argument("--node", nargs="+", default=["settle", "look"])
    parser.add_argument("--megapixels", type=float, default=0.2)
    return parser.parse_args()


if __name__ == "__main__":
    main()
