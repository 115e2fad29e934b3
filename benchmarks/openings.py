"""Mouths of vessels that photographs find in the visual hull, beside the true surface.

    python -m benchmarks.openings graphs/samples/spot FOLDER/vase FOLDER/mug FOLDER/tin

Scenes of the NeRF-Synthetic layout with a true mesh. For each flat part of the hull that ends in creases: where it
faces, the best opening (wall, depth), by how much the error falls (share, standard errors, share of the photographs).
Then what is opened, and the Chamfer distance of the hull, and of the hull with that, in thousandths of the radius.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from benchmarks.register import find
from exmesh_graph.evaluate.metrics.mesh import bounding_radius, chamfer
from exmesh_graph.evaluate.metrics.opened import Judge, Surroundings, openings
from exmesh_graph.geometry.hull import SilhouetteField, hull_field, surface
from exmesh_graph.geometry.lids import lids
from exmesh_graph.geometry.openings import Lidded, best_opening, opened
from exmesh_graph.io.blender import load_blender
from exmesh_graph.io.settings import BlenderOptions
from exmesh_graph.io.train_size import factor_for, reduced

_LIDS_AT = 96


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path)
    for folder in parser.parse_args().scenes:
        entry = find(folder)
        print(f"{folder.name} ({entry.role if entry else 'in no register'})")
        measure(folder)


def measure(folder: Path) -> None:
    """Print what is found in one scene."""
    scene = load_blender(folder, BlenderOptions())
    views, truth = scene.train, scene.truth
    field = SilhouetteField.of_views(views)
    values, grid = hull_field(field, resolution=_LIDS_AT)
    mesh = surface(values, grid)
    around = Surroundings(reduced(views, factor_for(views, 128, 0)), *mesh)
    for lid in lids(values, grid, *mesh):
        judge = Judge(around, lid)
        told = f"  faces {np.round(lid.normal, 1) + 0.0}, radius {lid.radius:.2f}"
        best = best_opening(Lidded(values, grid, *mesh, lid), judge) if judge.able else None
        if best is not None:
            gain = judge.gain(best)
            told += (
                f"; wall {best.wall:.3f}, depth {best.depth:.2f}: {gain.share:.0%} less, {gain.sigmas:.1f} standard "
                f"errors, {gain.better:.0%} of the photographs"
            )
        print(told, flush=True)
    began = time.process_time()
    found = [opening for opening, _ in openings(values, grid, views)]
    seconds = time.process_time() - began
    for one in found:
        print(f"  opened: faces {np.round(one.lid.normal, 1) + 0.0}, wall {one.wall:.3f}, depth {one.depth:.2f}")
    fine = hull_field(field, resolution=0)
    figures = []
    if truth is not None and truth.mesh_vertices is not None and truth.mesh_faces is not None:
        scale = 1000 / bounding_radius(truth.mesh_vertices)
        for one in [surface(*fine)] + ([opened(*fine, found)] if found else []):
            figures.append(chamfer(*one, truth.mesh_vertices, truth.mesh_faces).scaled(scale)["chamfer"])
    print(f"  {seconds:.1f} processor seconds; Chamfer {' -> '.join(f'{one:.2f}' for one in figures)}", flush=True)


if __name__ == "__main__":
    main()
