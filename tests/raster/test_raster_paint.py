"""The painted picture against its plain form, in value and gradient, and the same bytes on any number of cores."""

import numpy as np
import pytest
import torch

from benchmarks.stability.scenes import camera, soup
from exmesh_graph.gpu.cores import cores
from exmesh_graph.raster import (
    Painter,
    antialias,
    barycentrics,
    edge_table,
    find_silhouette,
    project,
    rasterize_projected,
    shade,
)
from exmesh_graph.testing import latlong_ball


class Scene:
    """A textured mesh before a camera; the texture is noise, so that every texel's gradient counts."""

    def __init__(self, vertices, faces, uvs, uv_faces, intrinsics, pose, height, width, texels=(40, 37)):
        self.vertices, self.faces = vertices.float(), faces.int()
        self.uvs, self.uv_faces, self.size = uvs.float(), uv_faces.int(), (height, width)
        self.intrinsics, self.pose, self.table = intrinsics, pose, edge_table(faces)
        rng = torch.Generator().manual_seed(0)
        self.texture = torch.rand(*texels, 3, generator=rng)
        self.weights = torch.randn(height, width, 4, generator=rng)
        self.tints = torch.empty(0, 3)

    def tinted(self) -> "Scene":
        self.tints = torch.randn(len(self.vertices), 3, generator=torch.Generator().manual_seed(1))
        return self

    def painter(self) -> Painter:
        return Painter(
            self.faces, self.uvs, self.uv_faces, self.table, vertices=len(self.vertices),
            texels=self.texture.shape[:2], height=self.size[0], width=self.size[1],
        )  # fmt: skip

    def painted(self, painter=None, uv_gradient=True):
        def draw(projected, texture, tints):
            colour, alpha, _ = (painter or self.painter()).paint(projected, texture, tints, uv_gradient=uv_gradient)
            return torch.cat([colour, alpha[..., None]], dim=-1)

        return self.results(draw, torch.float32)

    def plain(self, dtype, uv_gradient=True):
        def draw(projected, texture, tints):
            fragments = rasterize_projected(projected.float(), self.faces, *self.size)
            inner = projected if uv_gradient else projected.detach()
            colour = shade(inner, self.faces, self.uvs, self.uv_faces, texture, fragments.face_id)
            if len(tints):
                pixels = torch.nonzero(fragments.face_id.view(-1) >= 0)[:, 0]
                face = fragments.face_id.view(-1)[pixels].long()
                weights = barycentrics(inner, self.faces, face, pixels, self.size[1])
                added = (weights[..., None] * tints[self.faces[face].long()]).sum(1)
                colour = colour.view(-1, 3).index_add(0, pixels, added).view_as(colour)
            layers = torch.cat([colour, (fragments.face_id >= 0).to(dtype)[..., None]], dim=-1)
            return antialias(layers, projected, find_silhouette(projected.float(), self.table, fragments))

        return self.results(draw, dtype)

    def results(self, draw, dtype):
        """[image, dL/dvertices, dL/dtexture, dL/dtints] of a weighted sum."""
        inputs = [t.to(dtype, copy=True).requires_grad_() for t in (self.vertices, self.texture, self.tints)]
        vertices, texture, tints = inputs
        image = draw(project(vertices, self.intrinsics, self.pose), texture, tints)
        with_tints = {"allow_unused": True, "materialize_grads": True}  # there may be none
        return [image.detach(), *torch.autograd.grad((image * self.weights).sum(), inputs, **with_tints)]


def ball(height, width, **view) -> Scene:
    vertices, faces, uvs, uv_faces = (torch.from_numpy(a) for a in latlong_ball(14, 22, 0.9))
    return Scene(vertices, faces, uvs, uv_faces, *camera(width, height, **view), height, width)


def triangles(height, width, size, **view) -> Scene:
    """Random triangles, each anywhere in the texture."""
    vertices, faces = soup(80, size, seed=height + width)
    uvs = torch.rand(3 * len(faces), 2, generator=torch.Generator().manual_seed(5))
    uv_faces = torch.arange(3 * len(faces)).view(-1, 3)
    return Scene(vertices, faces, uvs, uv_faces, *camera(width, height, **view), height, width, texels=(70, 9))


SCENES = {
    "a ball": lambda: ball(61, 83),
    "from within": lambda: ball(40, 53, distance=0.2),
    "from the surface": lambda: ball(40, 53, distance=0.9),
    "beside the picture": lambda: ball(33, 31, shift=(500.0, 0.0)),
    "one pixel": lambda: ball(1, 1),
    "one row": lambda: ball(1, 77),
    "one column": lambda: ball(90, 1),
    "small triangles": lambda: triangles(64, 47, 0.1),
    "large triangles": lambda: triangles(50, 71, 2.5, turn=0.4),
    "subpixel faces": lambda: ball(9, 11),
}


@pytest.mark.thorough
@pytest.mark.parametrize("uv_gradient", [True, False])
@pytest.mark.parametrize("tinted", [False, True])
@pytest.mark.parametrize("name", SCENES)
def test_the_picture_and_its_gradients_are_those_of_the_plain_form(name, tinted, uv_gradient):
    """As near to the plain form in float64 as the plain form in float32 is."""
    scene = SCENES[name]().tinted() if tinted else SCENES[name]()
    ours = scene.painted(uv_gradient=uv_gradient)
    plain = scene.plain(torch.float32, uv_gradient)
    exact = scene.plain(torch.float64, uv_gradient)
    for got, near, want in zip(ours, plain, exact, strict=True):
        assert bool(torch.isfinite(got).all())
        size = float(want.norm()) + 1e-30
        bound = 3 * float((near.double() - want).norm()) / size + 1e-4
        assert float((got.double() - want).norm()) / size <= bound


def test_scenes_show_what_they_are_for():
    shown = {name: float((make().painted()[0][..., 3] > 0).float().mean()) for name, make in SCENES.items()}
    assert shown.pop("beside the picture") == 0
    assert all(share > 0.05 for share in shown.values())
    assert shown["from within"] == 1


@pytest.mark.parametrize("name", ["a ball", "large triangles"])
def test_bytes_are_the_same_on_any_number_of_cores_and_on_repeat(name):
    scene = SCENES[name]().tinted()
    painter = scene.painter()
    made = []
    for count in (1, 2, 3, 1):
        with cores(count):
            made.append([t.clone() for t in scene.painted(painter)])
    assert all(torch.equal(a, b) for other in made[1:] for a, b in zip(made[0], other, strict=True))


def test_a_painter_takes_pictures_one_after_the_other():
    """What it keeps from one picture to the next does not show in the next."""
    scene = ball(61, 83).tinted()
    painter = scene.painter()
    before = [t.clone() for t in scene.painted(painter)]
    there, scene.vertices = scene.vertices, scene.vertices + 2.5
    empty = scene.painted(painter)
    assert float(empty[0].abs().sum()) == 0
    assert float(empty[1].abs().sum()) == 0
    assert float(empty[2].abs().sum()) == 0
    assert float(empty[3].abs().sum()) == 0
    scene.vertices = there
    assert all(torch.equal(a, b) for a, b in zip(before, scene.painted(painter), strict=True))


def test_a_gradient_that_was_handed_in_is_left_as_it_was():
    scene = ball(61, 83)
    painter = scene.painter()
    projected = project(scene.vertices, scene.intrinsics, scene.pose).requires_grad_()
    colour, alpha, _ = painter.paint(projected, scene.texture)
    grad = scene.weights[..., :3].clone()
    first = torch.autograd.grad((colour, alpha), projected, (grad, scene.weights[..., 3]), retain_graph=True)[0]
    assert torch.equal(grad, scene.weights[..., :3])
    second = torch.autograd.grad((colour, alpha), projected, (grad, scene.weights[..., 3]))[0]
    assert torch.equal(first, second)


def test_a_texture_without_neighbours_is_refused():
    scene = ball(8, 8)
    scene.texture = scene.texture[:1]
    with pytest.raises(ValueError, match="2 x 2 at least"):
        scene.painter()


def test_tints_for_other_vertices_are_refused():
    scene = ball(8, 8).tinted()
    scene.tints = scene.tints[1:]
    with pytest.raises(ValueError, match="tints for"):
        scene.painted()


def test_faces_outside_the_mesh_or_the_atlas_are_refused():
    scene = ball(8, 8)
    scene.uvs = scene.uvs[:-1]
    with pytest.raises(IndexError, match="uv_faces"):
        scene.painter()
    scene = ball(8, 8)
    scene.vertices = scene.vertices[:-1]
    with pytest.raises(IndexError, match="faces"):
        scene.painter()


@pytest.mark.parametrize("cull", [False, True])
@pytest.mark.parametrize("name", SCENES)
def test_strips_show_what_a_thread_for_each_face_shows(name, cull):
    """To the bit: the arithmetic is the same, and of equal depths the lowest face is seen in both."""
    scene = SCENES[name]()
    projected = project(scene.vertices, scene.intrinsics, scene.pose)
    doubled = torch.cat([scene.faces, scene.faces.flip(0)])
    ours = rasterize_projected(projected, doubled, *scene.size, cull_back=cull)
    theirs = rasterize_projected(projected, doubled, *scene.size, cull_back=cull, large_face=0)
    for got, want in zip(ours, theirs, strict=True):
        assert np.array_equal(got.numpy(), want.numpy())
