"""Make rendered scenes with known truth, by Mitsuba 3 (docs/scenes.md).

    python -m benchmarks.scenes make chair padlock --out FOLDER --worlds bpy-5.0.1-cp311-cp311-manylinux_2_28_x86_64.whl
    python -m benchmarks.scenes make --role score --out FOLDER --worlds FOLDER     # all of a role; --quick: 128 pixels
    python -m benchmarks.scenes check --out FOLDER            # digests against benchmarks/scenes.yaml
    python -m benchmarks.scenes figures --out FOLDER          # what was measured of them; digests: for the register
    python -m benchmarks.scenes lights --worlds FOLDER        # how high lights stand, for envmap.ABOVE
    python -m benchmarks.scenes sheet --out FOLDER --picture docs/pictures/scenes.jpg

Pictures that lie there are kept: an interrupted run goes on. Wants `pip install mitsuba manifold3d`, and for Mitsuba's
LLVM variant `apt-get install libllvm19`.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from dataclasses import replace
from pathlib import Path


def main() -> int:
    options = arguments()
    if options.command == "make":
        return _make(options)
    if options.command == "check":
        from benchmarks.scenes.digests import check

        return check(options.out, options.names)
    if options.command in ("digests", "figures"):
        from benchmarks.scenes import digests

        return (digests.show if options.command == "digests" else digests.figures)(options.out, options.names)
    if options.command == "lights":
        return _lights(options.worlds)
    from benchmarks.scenes.sheet import sheet

    sheet(options.out, options.names, options.picture)
    return 0


def _make(options: argparse.Namespace) -> int:
    from benchmarks.scenes.catalogue import RECIPES
    from benchmarks.scenes.make import QUICK, SAMPLE, Size, make

    if options.role:
        from benchmarks.register import of_role

        options.names += [scene.name for scene in of_role(options.role) if scene.name in RECIPES]
    unknown = [name for name in options.names if name not in RECIPES]
    if unknown or not options.names:
        print(f"no scene {', '.join(unknown) or 'is named'}: there are {', '.join(RECIPES)}", file=sys.stderr)
        return 2
    size = QUICK if options.quick else SAMPLE if options.sample else Size()
    if options.size:
        size = replace(size, pixels=options.size)
    if options.views:
        size = replace(size, train=options.views)
    for name in options.names:
        began = time.perf_counter()
        place = make(
            name, options.out, size, worlds=options.worlds, envmaps=options.envmaps, threads=options.threads,
            moves=options.moves, near=options.near, ring=options.ring,
        )  # fmt: skip
        print(f"{name}: {place}, {time.perf_counter() - began:.0f} s", flush=True)
    return 0


def _lights(worlds: Path | None) -> int:
    from benchmarks.scenes.lights import heights

    found = heights(worlds)
    for name, height in found.items():
        print(f"{name:12s} {height:6.3f}")
    print(f"mean {statistics.mean(found.values()):.3f}, deviation {statistics.pstdev(found.values()):.3f}")
    return 0


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.scenes", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    for command in ("make", "check", "digests", "figures", "sheet"):
        part = commands.add_parser(command)
        part.add_argument("names", nargs="*", help="scenes; none: all that are there")
        part.add_argument("--out", type=Path, required=True, help="the folder of the scenes' folders")
        if command == "sheet":
            part.add_argument("--picture", type=Path, required=True)
        if command == "make":
            part.add_argument("--role", choices=["choose", "score"])
            part.add_argument("--size", type=int, default=0, help="pixels on a side instead of 512")
            part.add_argument("--views", type=int, default=0, help="training pictures instead of 48")
            part.add_argument("--quick", action="store_true", help="128 pixels, few views and samples")
            part.add_argument("--sample", action="store_true", help="as small as the sample of the repository")
            part.add_argument("--worlds", type=Path, help="the wheel of bpy 5.0.1, or a folder of its world pictures")
            moves = "light that moves with the camera, into FOLDER/NAME_turntable or NAME_camera"
            part.add_argument("--moves", choices=["turntable", "camera"], default="", help=moves)
            near = "close-ups among the training pictures, into FOLDER/NAME_near"
            part.add_argument("--near", action="store_true", help=near)
            ring = "all cameras some 30 degrees up, into FOLDER/NAME_ring"
            part.add_argument("--ring", action="store_true", help=ring)
            part.add_argument("--envmaps", type=Path, help="relight by the EXR maps of this folder too")
            part.add_argument("--threads", type=int, default=0)
    part = commands.add_parser("lights")
    part.add_argument("--worlds", type=Path, help="the wheel of bpy 5.0.1, or a folder of its world pictures")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
