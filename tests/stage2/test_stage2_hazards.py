"""Hard inputs: black sky, a sun in one texel, extreme albedo, one pixel, one texel, nothing seen, saturation."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from exmesh_graph.errors import GeometryError
from exmesh_graph.shading import brdf, envmap
from exmesh_graph.shading.brdf_sampling import sample_specular
from exmesh_graph.shading.operators import LightTransport
from exmesh_graph.shading.specular import PrefilteredStack
from exmesh_graph.shading.transport import trace_transport
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.objective import indirect_strength, weighted_terms
from exmesh_graph.stage2.render import render_transport, render_views
from exmesh_graph.stage2.settings import DecompositionSettings
from exmesh_graph.stage2.surface import CarrierGeometry, texel_footprint

SHORT = DecompositionSettings(
    environment_height=16,
    iterations=8,
    material_rate=0.3,
    environment_rate=0.6,
    ssim_weight=0.2,
    corrections=1,
    correction_samples=2,
    indirect_ramp=2,
)


def _only_ball(asset):
    keep = (asset.vertices[asset.faces][:, :, 1] > -0.43).all(axis=1)
    return dataclasses.replace(asset, faces=asset.faces[keep], uv_faces=asset.uv_faces[keep])


def _sun(height, row, column, radiance=1e5, sky=0.0):
    image = np.full((height, 2 * height, 3), sky, np.float32)
    image[row, column] = radiance
    return image


def _all_finite(asset):
    maps = (asset.base_color, asset.roughness, asset.environment)
    return all(np.isfinite(m).all() and (m >= 0).all() for m in maps) and max(m.max() for m in maps[:2]) <= 1


def _forward(model, views_index=0, step=0):
    terms, predicted = weighted_terms(model, model.buffers[views_index], step)
    sum(terms.values()).backward()
    for parameter in (model.maps.parameter, model.environment):
        assert bool(torch.isfinite(parameter.grad).all())
    assert all(bool(torch.isfinite(value)) for value in terms.values())
    assert bool(torch.isfinite(predicted).all())
    return terms, predicted


def test_black_sky_renders_black_and_black_photographs_give_a_dark_scene(
    true_asset, cameras, carrier, train_views, transport
):
    light = render_transport(true_asset, 1, directions=32, points=1)
    one = [c[:1] for c in cameras]
    black = np.zeros((16, 32, 3), np.float32)
    assert (render_views(true_asset, *one, 40, 40, environment=black, transport=light).images == 0).all()
    dark = dataclasses.replace(train_views, images=np.zeros_like(train_views.images))
    asset, curves = fit(carrier, dark, transport, SHORT.replaced(iterations=30))
    assert _all_finite(asset)
    assert curves["image"][-1] < 0.1 * curves["image"][0]


def test_a_sun_in_one_texel_keeps_its_energy(true_asset, cameras):
    """Irradiance over a whole convex body is flux x shadow area, pi r^2 for a ball, however small the sun."""
    ball = _only_ball(true_asset)
    operators = LightTransport(trace_transport(ball.vertices, ball.faces, 512))
    for row, column in ((3, 7), (12, 50), (15, 63)):
        sun = torch.from_numpy(_sun(32, row, column)).reshape(-1, 3)
        irradiance = operators.irradiance(operators.bin_matrix(32, 64) @ sun).numpy()[:, 0]
        corner = ball.vertices[ball.faces].astype(np.float64)
        area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
        received = (area * irradiance[operators.light.face_points.reshape(len(ball.faces), -1)].mean(axis=1)).sum()
        flux = 1e5 * envmap.solid_angles(32, 64)[row]
        assert received == pytest.approx(flux * math.pi * 0.5**2, rel=0.05)
    light = render_transport(true_asset, 1, directions=64, points=1)
    sun = _sun(32, 8, 20)
    lit = render_views(true_asset, *(c[:1] for c in cameras), 40, 40, environment=sun, transport=light).images
    assert np.isfinite(lit).all()
    assert lit.min() >= 0
    assert lit.max() > 10


def test_filtered_levels_of_a_sun_keep_its_energy():
    for row in (0, 5, 16):
        sun = torch.from_numpy(_sun(32, row, 60, sky=0.1))
        stack = PrefilteredStack(32, 64)
        flux = float((sun[..., 0] * torch.from_numpy(envmap.solid_angles(32, 64)).float()[:, None]).sum())
        sizes = list(zip(stack.heights.tolist(), stack.widths.tolist(), strict=True))
        for (height, width), level in zip(sizes, stack.build(sun).split([h * w for h, w in sizes]), strict=True):
            angle = torch.from_numpy(envmap.solid_angles(height, width)).float()[:, None]
            assert float((level[:, 0].reshape(height, width) * angle).sum()) == pytest.approx(flux, rel=1e-3)
            assert float(level.min()) > 0.1 - 1e-7 * 1e5  # the Fourier filter rings by float32 rounding only


def test_a_sun_in_the_fitted_sky_has_finite_gradients(carrier, train_views, transport):
    model = Decomposition(carrier, train_views, transport, SHORT, "cpu")
    with torch.no_grad():
        model.environment.copy_(envmap.parameter_of(torch.from_numpy(_sun(16, 4, 9, sky=0.1))))
    _forward(model)
    assert float(model.environment.grad[4, 9].abs().max()) > 0  # the sun can still be dimmed


@pytest.mark.parametrize("logit", [-40.0, 40.0])
def test_pure_black_and_pure_white_materials(carrier, train_views, transport, logit):
    settings = SHORT.replaced(metallic=True)
    model = Decomposition(carrier, train_views, transport, settings, "cpu")
    with torch.no_grad():
        model.maps.parameter.fill_(logit)
    _, predicted = _forward(model)
    # roughness and metallic are at the same end: white is a rough white metal, black a dielectric at the floor
    assert 0 <= float(predicted.min()) <= float(predicted.max()) <= (1.1 if logit > 0 else 1.0)


def test_a_white_ball_in_a_white_sky_returns_what_falls_on_it(true_asset, cameras):
    """The diffuse part is exactly the sky's radiance; the coat adds its directional albedo (docs/stage2_trials.md)."""
    ball = _only_ball(true_asset)
    light = render_transport(ball, 4, directions=256, points=400)
    sky = np.ones((16, 32, 3), np.float32)
    for albedo in (0.0, 1.0):
        painted = dataclasses.replace(ball, base_color=np.full_like(ball.base_color, albedo))
        views = render_views(painted, *(c[:1] for c in cameras), 40, 40, environment=sky, transport=light)
        middle = views.images[0][views.alpha[0] > 0.99]
        assert np.median(middle) == pytest.approx(albedo + 0.04, abs=0.03)


def test_views_of_one_pixel_and_views_that_see_nothing(carrier, train_views, transport):
    """Eight views: one is reduced to a single pixel, one to none; the others carry the fit."""
    alpha = train_views.alpha.copy()
    row, column = np.argwhere(alpha[2] > 0.99)[len(np.argwhere(alpha[2] > 0.99)) // 2]
    alpha[2] = 0
    alpha[2, row, column] = 1
    alpha[5] = 0
    views = dataclasses.replace(train_views, alpha=alpha, images=train_views.images * (alpha > 0)[..., None])
    asset, curves = fit(carrier, views, transport, SHORT)
    assert _all_finite(asset)
    assert np.isfinite(curves["loss"]).all()
    # all photographs of one pixel each
    k = views.intrinsics[:1].copy()
    k[:, :2, 2] = 0.5
    tiny = dataclasses.replace(
        views,
        names=("only",),
        images=np.full((1, 1, 1, 3), 0.3, np.float32),
        alpha=np.ones((1, 1, 1), np.float32),
        intrinsics=k,
        camera_to_world=views.camera_to_world[:1],
    )
    asset, _ = fit(carrier, tiny, transport, SHORT)
    assert _all_finite(asset)


@pytest.mark.parametrize("size", [1, 2])
def test_maps_of_one_texel(carrier, train_views, transport, size):
    index, weight = texel_footprint(torch.rand(20, 2), size)
    assert int(index.max()) < size * size
    torch.testing.assert_close(weight.sum(1), torch.ones(20))
    asset, _ = fit(carrier, train_views, transport, SHORT.replaced(texture_size=size))
    assert asset.base_color.shape == (size, size, 3)
    assert _all_finite(asset)


def test_saturated_highlights_pull_no_further(carrier, train_views, transport):
    """Photographs at the top of their range everywhere: a prediction above it has neither loss nor gradient."""
    full = dataclasses.replace(
        train_views, images=np.repeat(train_views.alpha[..., None], 3, axis=3).astype(np.float32), clipped=True
    )
    settings = SHORT.replaced(material_weight=0, environment_weight=0, chroma_weight=0)
    model = Decomposition(carrier, full, transport, settings, "cpu")
    assert all(bool(buffer.clipped.all()) for buffer in model.buffers)
    with torch.no_grad():
        model.environment.copy_(envmap.parameter_of(torch.full_like(model.environment, 40.0)))
    terms, predicted = _forward(model)
    assert float(predicted.min()) > 1
    assert float(terms["image"]) == 0
    area = max(math.prod(buffer.box) / len(buffer.pixel) for buffer in model.buffers)
    assert float(terms["ssim"]) == pytest.approx(0, abs=1e-6 * area)
    assert float(model.maps.parameter.grad.abs().max()) < 1e-8
    linear = Decomposition(carrier, dataclasses.replace(full, clipped=False), transport, settings, "cpu")
    assert not any(bool(buffer.clipped.any()) for buffer in linear.buffers)  # an EXR has no top


def test_an_8_bit_255_is_clipped_and_254_is_not(carrier, train_views, transport):
    code = ((np.arange(256) / 255 + 0.055) / 1.055) ** 2.4
    for value, clipped in ((code[255], True), (code[254], False)):
        images = (value * train_views.alpha[..., None] * np.ones(3)).astype(np.float32)
        views = dataclasses.replace(train_views, images=images, clipped=True)
        buffer = Decomposition(carrier, views, transport, SHORT, "cpu").buffers[0]
        assert bool((buffer.clipped == clipped).all())


def test_partly_covered_pixels_compare_straight_colours(carrier, train_views, transport):
    """Photographs are premultiplied; a pixel covered by half shows half the surface's radiance."""
    half = np.where(train_views.alpha > 0.99, 0.5, 0).astype(np.float32)
    views = dataclasses.replace(train_views, images=0.3 * half[..., None] * np.ones(3, np.float32), alpha=half)
    settings = SHORT.replaced(min_coverage=0.4)
    buffer = Decomposition(carrier, views, transport, settings, "cpu").buffers[0]
    np.testing.assert_allclose(buffer.target.numpy(), 0.3, rtol=1e-5)
    np.testing.assert_allclose(buffer.coverage.numpy(), 0.5)


def test_faces_without_area_and_cameras_on_the_horizon(true_asset):
    """Zero normals, a camera behind the face, one in its plane: unit vectors and cosines stay in range."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 0, -1], [2, 0, 0]], np.float32)
    flat = dataclasses.replace(
        true_asset,
        vertices=vertices,
        faces=np.array([[0, 1, 2], [0, 1, 3]], np.int32),
        uvs=np.zeros((3, 2), np.float32),
        uv_faces=np.zeros((2, 3), np.int32),
    )
    geometry = CarrierGeometry(flat)
    face, bary = torch.tensor([0, 0, 1]), torch.full((3, 3), 1 / 3)
    for eye in ([0.2, 3.0, -0.2], [0.2, -3.0, -0.2], [5.0, 0.0, -0.3]):
        samples = geometry.samples(face, bary, torch.tensor(eye))
        for name in ("normal", "view", "reflected"):
            torch.testing.assert_close(getattr(samples, name).norm(dim=1), torch.ones(3), atol=1e-4, rtol=0)
        assert bool(((samples.n_v > 0) & (samples.n_v <= 1)).all())


@pytest.mark.parametrize("roughness", [0.0, 0.08, 0.5, 1.0])
def test_sampler_at_grazing_angles_and_below_the_horizon(roughness):
    normal = torch.tensor([[0.0, 0, 1]]).expand(4, 3)
    view = torch.nn.functional.normalize(torch.tensor([[1.0, 0, 1e-5], [1.0, 0, -0.1], [0, 0, 1], [0, 0, -1]]), dim=1)
    alpha = brdf.alpha_of(torch.full((4,), roughness))
    uniform = torch.rand(1, 512, 2, generator=torch.Generator().manual_seed(0)).expand(4, 512, 2)
    light, weight, pdf, v_h = sample_specular(normal, view, alpha, uniform)
    for value in (light, weight, pdf, v_h):
        assert bool(torch.isfinite(value).all())
    torch.testing.assert_close(light.norm(dim=-1), torch.ones(4, 512), atol=1e-3, rtol=0)
    assert float(weight.mean(dim=1).max()) <= 1.0 + 1e-4  # white furnace: G / G1 never gains


def test_a_smooth_metal_ball_shows_the_sky_in_its_place(true_asset, cameras):
    """Absolute orientation of the specular light: each pixel of a mirror is the sky towards the reflected ray."""
    ball = _only_ball(true_asset)
    mirror = dataclasses.replace(
        ball,
        base_color=np.ones_like(ball.base_color),
        roughness=np.full_like(ball.roughness, 0.1),
        metallic=np.ones_like(ball.roughness),
    )
    intrinsics, poses = (c[:1] for c in cameras)
    light = render_transport(mirror, 0, directions=16, points=1)
    for height in (32, 25):  # 25 rows are resampled for the pyramid
        d = envmap.texel_directions(height, 2 * height)
        sky = (1 + d @ np.array([[0.9, 0.0, 0.1], [0.0, 0.8, 0.1], [0.0, 0.1, 0.7]])).astype(np.float32)
        views = render_views(mirror, intrinsics, poses, 40, 40, environment=sky, specular_samples=8, transport=light)
        row, column = np.nonzero(views.alpha[0] > 0.99)
        normal = views.normal[0][row, column]
        pixel = np.stack([column + 0.5, row + 0.5, np.ones(len(row))], 1) @ np.linalg.inv(intrinsics[0]).T
        ray = pixel @ poses[0][:3, :3].T
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        facing = -(ray * normal).sum(1)
        reflected = ray + 2 * facing[:, None] * normal
        expected = 1 + reflected @ np.array([[0.9, 0.0, 0.1], [0.0, 0.8, 0.1], [0.0, 0.1, 0.7]])
        clear = facing > 0.4
        error = np.abs(views.images[0][row, column] - expected)[clear]
        assert np.median(error) < 0.03
        assert np.percentile(error, 95) < 0.12


def test_diffuse_light_comes_from_where_it_is_in_the_sky(true_asset):
    """Absolute orientation and size: irradiance of 1 + d.a over the sphere is pi + (2 pi / 3) n.a on a convex body."""
    ball = _only_ball(true_asset)
    operators = LightTransport(trace_transport(ball.vertices, ball.faces, 1024))
    axes = np.array([[0.6, 0.0, 0.2], [0.0, 0.5, -0.3], [0.1, 0.2, 0.6]])
    sky = (1 + envmap.texel_directions(32, 64) @ axes).astype(np.float32)
    found = operators.irradiance(operators.bin_matrix(32, 64) @ torch.from_numpy(sky).reshape(-1, 3)).numpy()
    used = np.unique(operators.light.face_points)
    expected = math.pi + 2 * math.pi / 3 * operators.light.normals[used] @ axes
    np.testing.assert_allclose(found[used], expected, rtol=0.06)


def test_the_objective_is_equations_21_to_24(carrier, train_views, transport):
    """Every term of one step against its formula written out with numpy-like plainness."""
    from exmesh_graph.losses import d_ssim

    settings = SHORT.replaced(log_weight=0.7, ssim_weight=0.3, iterations=100, indirect_ramp=10)
    model = Decomposition(carrier, train_views, transport, settings, "cpu")
    buffer, step = model.buffers[1], 25
    terms, predicted = weighted_terms(model, buffer, step)
    log = (torch.log1p(predicted) - torch.log1p(buffer.target)).abs().mean(1)
    assert float(terms["image"]) == pytest.approx(0.7 * float((log * buffer.coverage).sum() / buffer.coverage.sum()))
    pictures = []
    for values in (predicted, buffer.target):
        encoded = values.clamp(0, 1)
        encoded = torch.where(encoded <= 0.0031308, 12.92 * encoded, 1.055 * encoded ** (1 / 2.4) - 0.055)
        picture = torch.zeros(40 * 40, 3)
        picture[buffer.pixel] = encoded
        pictures.append(torch.nn.functional.pad(picture.reshape(40, 40, 3), (0, 0, 5, 5, 5, 5)))
    area = 50 * 50 / len(buffer.pixel)  # D-SSIM's sum over the picture by the number of its pixels on the surface
    assert float(terms["ssim"]) == pytest.approx(0.3 * area * float(d_ssim(*pictures)), rel=1e-4)
    # eq. 24: lambda_chroma(t) = lambda_0 (1 - t / T); a red sky so that the term is not zero
    with torch.no_grad():
        model.environment[..., 0] += 1
    sky = envmap.radiance_of(model.environment)
    chroma = weighted_terms(model, buffer, step)[0]["chroma"]
    assert float(chroma) == pytest.approx(settings.chroma_weight * 0.75 * float(envmap.chroma(sky)))
    # eq. 20: lambda_ind grows linearly to its target
    assert [indirect_strength(settings, s) for s in (0, 4, 9, 50)] == pytest.approx([0.1, 0.5, 1.0, 1.0])


def test_one_step_of_light_equals_its_integral(carrier, train_views, transport):
    """The diffuse part of shade(): f_d I with f_d = a / pi, under a white sky without interreflection: a x openness."""
    model = Decomposition(carrier, train_views, transport, SHORT, "cpu")
    buffer = model.buffers[0]
    buffer.light.specular_scale.zero_()
    with torch.no_grad():
        shaded, material = model.shade(buffer, model.prepare(0.0, 0))
    open_sky = buffer.samples(model.geometry).normal[:, 1] > 0.7  # upwards on the ball: nothing above it
    height = buffer.samples(model.geometry).position[:, 1]
    top = open_sky & (height > 0.1)
    np.testing.assert_allclose(shaded[top].numpy(), material.base_color[top].numpy(), rtol=0.06)
    assert float((shaded <= material.base_color * 1.06).float().mean()) == 1


def test_reflections_of_the_object_in_itself_are_seen(true_asset, cameras):
    """A metal slab under the ball and a white sky: a white ball shows in it, a black one leaves a hole."""
    slab_texels = np.broadcast_to((np.arange(64) + 0.5) / 64 > 0.64, (64, 64))
    sky = np.ones((16, 32, 3), np.float32)
    light = render_transport(true_asset, 1, directions=128, points=1500)
    pictures = []
    for ball in (0.9, 0.0):
        painted = dataclasses.replace(
            true_asset,
            base_color=np.where(slab_texels[..., None], 1, ball * np.ones(3)).astype(np.float32),
            roughness=np.full_like(true_asset.roughness, 0.1),
            metallic=slab_texels.astype(np.float32),
        )
        views = render_views(
            painted, *(c[:1] for c in cameras), 40, 40, environment=sky, transport=light, specular_samples=16
        )
        slab = (views.normal[0][..., 1] > 0.99) & (views.alpha[0] > 0.99) & (views.albedo[0][..., 0] > 0.99)
        pictures.append(views.images[0][slab][:, 0])
    white, black = pictures
    hole = black < 0.05
    assert hole.sum() > 10
    assert white[hole].mean() > 0.1  # the ball's underside, lit from the sides
    assert np.median(white[~hole]) == pytest.approx(1, abs=0.02)


def test_a_light_transport_of_another_mesh_is_refused_and_a_flat_normal_map_changes_nothing(true_asset, cameras):
    ball = _only_ball(true_asset)
    light = render_transport(ball, 0, directions=16, points=1)
    one = [c[:1] for c in cameras]
    with pytest.raises(GeometryError, match="another mesh"):
        render_views(true_asset, *one, 40, 40, transport=light)
    up = np.zeros((*ball.roughness.shape, 3), np.float32)
    up[..., 2] = 1
    flat = render_views(dataclasses.replace(ball, normal=up), *one, 40, 40, transport=light)
    np.testing.assert_allclose(flat.images, render_views(ball, *one, 40, 40, transport=light).images, atol=1e-3)


def test_the_fit_looks_the_sky_up_where_the_view_is_mirrored(carrier, train_views, transport):
    model = Decomposition(carrier, train_views, transport, SHORT, "cpu")
    for buffer in model.buffers[:3]:
        surface = buffer.samples(model.geometry)
        view = torch.nn.functional.normalize(buffer.camera - surface.position, dim=1)
        mirrored = 2 * (view * surface.normal).sum(1, keepdim=True) * surface.normal - view
        looked = envmap.direction_of(buffer.light.env_u, buffer.light.env_v)
        torch.testing.assert_close(looked, mirrored, atol=1e-3, rtol=0)
