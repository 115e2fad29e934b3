"""Which small parts of a start stay: those that masks need, not those that they merely allow."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from exmesh_graph.errors import DataError
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.raster import project, rasterize_projected
from exmesh_graph.stage1.parts import without_phantoms
from exmesh_graph.testing import views


def ball(radius, centre):
    vertices, faces = icosphere(2, radius)
    return vertices + np.asarray(centre, np.float32), faces


def joined(*meshes):
    counts = np.cumsum([0] + [len(v) for v, _ in meshes])
    return (
        np.concatenate([v for v, _ in meshes]).astype(np.float32),
        np.concatenate([f + c for (_, f), c in zip(meshes, counts[:-1], strict=True)]).astype(np.int32),
    )


def seen(mesh):
    """Views of 48 x 48 pixels whose masks show `mesh`."""
    made = views(count=8, size=48)
    alpha = made.alpha.copy()
    for view in range(len(made)):
        places = project(
            torch.from_numpy(mesh[0]),
            torch.from_numpy(made.intrinsics[view]),
            torch.from_numpy(made.world_to_camera[view]),
        )
        alpha[view] = (rasterize_projected(places, torch.from_numpy(mesh[1]), 48, 48).face_id >= 0).numpy()
    return replace(made, alpha=alpha.astype(np.float32))


BODY, LEAF, PHANTOM = ball(0.5, (0, 0, 0)), ball(0.08, (0, 0.75, 0)), ball(0.06, (0, 0, 0))


def test_a_part_that_masks_show_stays_and_one_that_hides_before_the_body_goes():
    shown = seen(joined(BODY, LEAF))
    kept = without_phantoms(*joined(BODY, LEAF, PHANTOM), shown, least=0.1)
    assert [len(x) for x in kept] == [len(x) for x in joined(BODY, LEAF)]
    np.testing.assert_array_equal(kept[0][: len(BODY[0])], BODY[0])


def test_large_parts_stay_whatever_the_masks_say():
    whole = joined(BODY, PHANTOM)
    kept = without_phantoms(*whole, seen(BODY), least=1e-3)
    assert len(kept[1]) == len(whole[1])


def test_what_one_view_shows_is_a_wrong_mask():
    alpha = seen(joined(BODY, LEAF)).alpha
    alpha[1:] = seen(BODY).alpha[1:]
    kept = without_phantoms(*joined(BODY, LEAF), replace(seen(BODY), alpha=alpha), least=0.1)
    assert len(kept[1]) == len(BODY[1])


def test_views_without_masks_are_refused():
    bare = seen(BODY)
    bare = replace(bare, alpha=np.ones_like(bare.alpha))
    with pytest.raises(DataError, match="masks"):
        without_phantoms(*joined(BODY, LEAF), bare, least=0.1)
