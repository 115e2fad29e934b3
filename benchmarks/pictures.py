"""Sharpness and distance of the pictures of a folder: the figures by which `data.photos` leaves some out.

    python -m benchmarks.pictures ../shared/data/temple_ring/image ../shared/data/dtu_scan24/image \\
        graphs/samples/chair/train

Columns: least and largest sharpness over the median; the last picture's over itself under a Gaussian blur of 0.5, 0.7,
1 and 2 pixels and under a movement over 2, 3 and 5 pixels; least and median displacement of neighbours by name, in per
cent of the width; processor seconds.
"""

from __future__ import annotations

import argparse
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter, uniform_filter1d

from exmesh_graph.io.formats import PLAIN
from exmesh_graph.io.images import read_raw
from exmesh_graph.io.selection import displacement, grey_of, measure, sharpness


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="+")
    for folder in parser.parse_args().folder:
        files = sorted(file for file in folder.iterdir() if file.suffix.lower() in PLAIN)
        start = time.process_time()
        sharp, thumbs = measure(files)
        seconds = time.process_time() - start
        middle = np.nanmedian(sharp)
        moved = 100 * np.array([displacement(a, b) for a, b in pairwise(thumbs)])
        grey = grey_of(read_raw(files[-1]), 1024)
        blurs = [gaussian_filter(grey, s) for s in (0.5, 0.7, 1, 2)] + [uniform_filter1d(grey, n) for n in (2, 3, 5)]
        print(
            f"{folder} ({len(files)})  {np.nanmin(sharp) / middle:.2f} {np.nanmax(sharp) / middle:.2f}  "
            + " ".join(f"{sharpness(blur) / sharpness(grey):.2f}" for blur in blurs)
            + f"  {np.nanmin(moved):.2f} {np.nanmedian(moved):.2f}  {seconds:.1f} s"
        )


if __name__ == "__main__":
    main()
