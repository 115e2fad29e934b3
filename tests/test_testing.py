"""The helpers for node authors: scenes that are what they say, a context that keeps what a node says."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exmesh_graph import testing
from exmesh_graph.graph.declare.node import Context
from exmesh_graph.types import Artifact, Mesh


def test_the_context_offers_all_that_nodes_may_ask() -> None:
    asked = {name for name in vars(Context) if not name.startswith("_")}
    fake = testing.FakeContext()
    assert asked <= set(dir(fake))
    fake.progress(1, 4, loss=0.5)
    fake.checkpoint(1, {"x": 2})
    fake.warn("thin")
    assert (fake.steps, fake.figures, fake.offered) == ([(1, 4)], {"loss": 0.5}, (1, {"x": 2}))
    assert fake.warnings == ["thin"]
    assert testing.FakeContext(resumed=(3, {"x": 1})).resume() == (3, {"x": 1})


@pytest.mark.parametrize("made", [testing.mesh, testing.carrier, testing.state, testing.asset])
def test_the_shapes_are_closed_and_fit_the_normalised_world(made: Any, tmp_path: Path) -> None:
    value = made()
    facets = value.facets()
    assert facets["closed"]
    assert facets["manifold"]
    assert facets["units"] == "normalised"
    assert facets["uv"] == (made is not testing.mesh)
    assert np.linalg.norm(value.vertices, axis=1) == pytest.approx(0.6, abs=1e-6)
    testing.check_codec(value, tmp_path)


def test_photographs_show_the_ball_with_its_masks_and_depth() -> None:
    ball = testing.carrier()
    for subject in (ball, testing.asset(ball)):
        views = testing.views(subject, count=3, size=32)
        assert views.images.shape == (3, 32, 32, 3)
        assert views.has_masks
        covered = views.alpha.mean(axis=(1, 2))
        assert ((covered > 0.3) & (covered < 0.7)).all()
        assert (views.images[views.alpha > 0.99].max(axis=-1) > 0.02).all()
    depth = testing.depth_maps(ball, views).depth
    inside = depth > 0
    assert np.array_equal(inside, views.alpha > 0.5) or (inside != (views.alpha > 0.5)).mean() < 0.02
    assert depth[inside].min() == pytest.approx(2.5 - 0.6, abs=0.02)


def test_a_camera_looks_at_the_origin_upright() -> None:
    pose = testing.look_at([1.0, 0.5, 2.0])
    assert pose[:3, :3] @ pose[:3, :3].T == pytest.approx(np.eye(3))
    assert np.linalg.inv(pose)[:3, 3][:2] == pytest.approx([0, 0], abs=1e-12)
    assert pose[:3, 1] @ [0, 1, 0] < 0  # y points down


@dataclass(frozen=True, eq=False)
class Forgetful(Mesh):
    """A wire type that loses what it was given: one field, or the precision."""

    type_name = "Forgetful"
    forget: str = "name"
    name: str = "a"

    @classmethod
    def load(cls, folder: Path) -> Forgetful:
        value = super().load(folder)
        if value.forget == "name":
            return replace(value, name="b")
        return replace(value, vertices=value.vertices.astype(np.float16).astype(np.float32))


@pytest.mark.parametrize(("forget", "field"), [("name", "name"), ("precision", "vertices")])
def test_a_codec_that_changes_a_value_is_found(forget: str, field: str, tmp_path: Path) -> None:
    ball = testing.mesh(0)
    with pytest.raises(AssertionError, match=rf"Forgetful\.{field} changes"):
        testing.check_codec(Forgetful(ball.vertices, ball.faces, forget=forget), tmp_path)


def test_a_codec_whose_bytes_change_is_found(tmp_path: Path) -> None:
    count = iter(range(9))

    @dataclass(frozen=True, eq=False)
    class Stamped(Artifact):
        type_name = "Stamped"

        def save(self, folder: Path) -> None:
            (folder / "stamp").write_text(str(next(count)))

        @classmethod
        def load(cls, folder: Path) -> Stamped:
            return cls()

    with pytest.raises(AssertionError, match="other bytes the second time: stamp"):
        testing.check_codec(Stamped(), tmp_path)


def test_importing_the_helpers_loads_numpy_alone() -> None:
    code = "import exmesh_graph.testing, sys; print([m for m in ('torch', 'warp', 'scipy', 'pxr') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
