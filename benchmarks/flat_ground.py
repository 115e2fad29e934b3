"""Masks of pictures without alpha on one flat colour (`io.key`) against the alpha that they had.

python -m benchmarks.flat_ground SCENE ... [--every N]

Every N-th training picture (8-bit, with alpha) of scenes for choosing is laid on black and on white. Intersection over
union of alpha from 1/2 on (median and least), and the mean error of alpha where either is not 0.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from benchmarks.register import choosing
from exmesh_graph.io.blender import list_blender
from exmesh_graph.io.color import srgb_to_linear
from exmesh_graph.io.images import Photo, read_photo
from exmesh_graph.io.key import flat_ground, keyed
from exmesh_graph.io.settings import BlenderOptions


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--every", type=int, default=8)
    options = parser.parse_args()
    for scene in options.scenes:
        choosing(scene)
        shots, _, _ = list_blender(scene, BlenderOptions(hdr=False))
        photos = [read_photo(shot.image) for shot in shots[:: options.every]]
        for level in (0.0, 1.0):
            print(line(scene.name, level, photos), flush=True)


def line(name: str, level: float, photos: list[Photo]) -> str:
    overlaps, errors = [], []
    for photo in photos:
        bare = laid_on(photo, level)
        ground = flat_ground([bare])
        if ground is None:
            return f"{name:10s} on {level:g}: its frames are not of one colour"
        alpha = keyed(bare, ground).alpha
        true, found = photo.alpha >= 0.5, alpha >= 0.5
        overlaps.append((true & found).sum() / (true | found).sum())
        errors.append(np.abs(alpha - photo.alpha)[(alpha > 0) | (photo.alpha > 0)].mean())
    return (
        f"{name:10s} on {level:g}: IoU {np.median(overlaps):.4f}, worst {min(overlaps):.4f}, "
        f"error of alpha {np.mean(errors):.4f}"
    )


def laid_on(photo: Photo, level: float) -> Photo:
    """The photo in display colours over one of `level`, as a file of 8 bits without alpha holds it."""
    assert photo.codes is not None
    alpha = photo.alpha[..., None]
    shown = photo.codes[..., :3] / np.iinfo(photo.codes.dtype).max * alpha + (1 - alpha) * level
    codes = np.rint(255 * shown).astype(np.uint8)
    linear = srgb_to_linear(codes / 255.0).astype(np.float32)
    return Photo(linear, np.ones_like(photo.alpha), False, True, codes)


if __name__ == "__main__":
    main()
