"""Every accelerated operation on small inputs, on another device and on the CPU: values and gradients compared.

`exmesh doctor --gpu` prints it. `device: auto` takes CUDA only where it has passed (`gpu.verdict`), in a process of its
own: what a driver breaks must not break a run. `python -m exmesh_graph.device_check cuda` prints it as JSON.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch

from exmesh_graph import losses, testing
from exmesh_graph.optim import adam_step

Results = dict[str, torch.Tensor]
Trial = Callable[[torch.device], Results]

MEAN_ERROR = 2e-3
"""Of the mean magnitude: faces that the last bits of a division decide differ as wholes, but they are few."""
SAME = 0.999
"""Share of whole numbers (faces that are seen) that must be equal."""


class Outcome(NamedTuple):
    """Of one operation: `fault` is empty where both devices agree."""

    operation: str
    fault: str
    seconds: float


def check(device: torch.device | str, trials: dict[str, Trial] | None = None) -> list[Outcome]:
    """Run all operations on the CPU and on `device`. Nothing is raised: an exception is a fault."""
    outcomes = []
    for name, trial in (TRIALS if trials is None else trials).items():
        began = time.perf_counter()
        try:
            fault = difference(trial(torch.device("cpu")), trial(torch.device(device)))
        except Exception as error:  # whatever a driver, a compiler or a kernel makes of it
            fault = f"{type(error).__name__}: {str(error).strip().splitlines()[0] if str(error).strip() else 'no text'}"
        outcomes.append(Outcome(name, fault, time.perf_counter() - began))
    return outcomes


def difference(here: Results, there: Results) -> str:
    """The first result that is not the same on both devices, in words; empty where all are."""
    for name, mine in here.items():
        other = there[name].detach().cpu()
        mine = mine.detach().cpu()
        if mine.shape != other.shape:
            return f"{name} has the shape {tuple(other.shape)}, on the CPU {tuple(mine.shape)}"
        if not mine.is_floating_point():
            same = float((mine == other).double().mean()) if mine.numel() else 1.0
            if same < SAME:
                return f"{name}: {same:.1%} are as on the CPU"
            continue
        if not bool(torch.isfinite(other).all()):
            return f"{name} is not finite"
        size = float(mine.abs().double().mean())
        error = float((mine - other).abs().double().mean())
        if error > MEAN_ERROR * size:
            return f"{name} is off by {error / size if size else error:.2g} of its mean size"
    return ""


def _surface(device: torch.device) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """(projected [V, 3], a leaf; faces; camera matrices) of a ball before a camera of 96 x 80 pixels."""
    from exmesh_graph.raster import project

    ball = testing.mesh(levels=3)
    intrinsics, poses = (torch.from_numpy(a) for a in testing.cameras(2, 96))
    vertices = torch.tensor(ball.vertices, dtype=torch.float32, device=device)
    world_to_camera = torch.linalg.inv(poses[0].double())
    projected = project(vertices, intrinsics[0], world_to_camera).detach().requires_grad_()
    return projected, torch.tensor(ball.faces, dtype=torch.int32, device=device), intrinsics[0], world_to_camera


def _visibility(device: torch.device) -> Results:
    from exmesh_graph.raster import rasterize_projected

    projected, faces, *_ = _surface(device)
    return dict(rasterize_projected(projected, faces, 80, 96)._asdict())


def _picture(device: torch.device) -> Results:
    from exmesh_graph.raster import antialias, edge_table, find_silhouette, rasterize_projected, shade

    projected, faces, *_ = _surface(device)
    uvs = _random(projected.shape[0], 2).to(device) * 0.1 + 0.4
    texture = _random(64, 64, 3).to(device).requires_grad_()
    fragments = rasterize_projected(projected, faces, 80, 96)
    colour = shade(projected, faces, uvs, faces, texture, fragments.face_id)
    layers = torch.cat([colour, (fragments.face_id >= 0).float()[..., None]], dim=-1)
    image = antialias(layers, projected, find_silhouette(projected, edge_table(faces), fragments))
    return _with_gradients(image, position=projected, texture=texture)


def _texture(device: torch.device) -> Results:
    from exmesh_graph.raster import mip_pyramid, sample_mipmap, sample_texture

    texture, uv = _random(33, 20, 3).to(device).requires_grad_(), (_random(500, 2) * 3 - 1).to(device).requires_grad_()
    found = [sample_texture(texture, uv, wrap=wrap) for wrap in ("clamp", "repeat", "mirror")]
    levels = (_random(500, seed=1) * 4).to(device)
    found.append(sample_mipmap(mip_pyramid(texture), uv, levels))
    return _with_gradients(torch.cat(found), texture=texture, uv=uv)


def _rays(device: torch.device) -> Results:
    from exmesh_graph.rays import make_ray_tracer

    ball = testing.mesh(levels=3)
    tracer = make_ray_tracer(ball.vertices, ball.faces, str(device))
    origins = 2 * torch.nn.functional.normalize(_random(2000, 3) - 0.5, dim=1).numpy()
    directions = torch.nn.functional.normalize(
        _random(2000, 3, seed=1) - 0.5 - torch.from_numpy(origins), dim=1
    ).numpy()
    hits = tracer.closest_hit(origins, directions)
    blocked = tracer.any_hit(origins, directions)
    distance = torch.from_numpy(np.where(np.isfinite(hits.t), hits.t, 0))
    return {"face": torch.from_numpy(hits.face), "distance": distance, "occlusion": torch.from_numpy(blocked)}


def _gaussians(device: torch.device) -> Results:
    from exmesh_graph.splat.gaussians import Gaussians
    from exmesh_graph.splat.render import render

    count = 1500
    _, _, intrinsics, pose = _surface(device)
    cloud = Gaussians(
        means=_random(count, 3) - 0.5, scales=_random(count, 3, seed=1) - 4, rotations=_random(count, 4, seed=2) - 0.5,
        opacities=4 * _random(count, seed=3) - 2, sh=_random(count, 4, 3, seed=4) - 0.5,
    ).map(lambda t: t.to(device).requires_grad_())  # fmt: skip
    drawn = render(cloud, intrinsics, pose, 80, 96)
    image = torch.cat([drawn.colour, drawn.normal, drawn.alpha[..., None], drawn.distance[..., None]], dim=-1)
    return _with_gradients(image, **cloud.tensors())


def _reflectance(device: torch.device) -> Results:
    from exmesh_graph.shading import brdf

    normal, view, light = (torch.nn.functional.normalize(_random(500, 3, seed=s) - 0.5, dim=1) for s in range(3))
    view, light = (torch.where((v * normal).sum(1, keepdim=True) < 0, -v, v) for v in (view, light))
    colour, roughness, metallic = _random(500, 3), torch.linspace(0.1, 1, 500), torch.linspace(0, 1, 500)
    inputs = {"colour": colour, "roughness": roughness, "metallic": metallic}
    inputs = {name: value.to(device).requires_grad_() for name, value in inputs.items()}
    return _with_gradients(brdf.evaluate(*(v.to(device) for v in (normal, view, light)), *inputs.values()), **inputs)


def _environment(device: torch.device) -> Results:
    from exmesh_graph.shading import envmap
    from exmesh_graph.shading.specular import PrefilteredStack

    image = _random(32, 64, 3).to(device).requires_grad_()
    directions = torch.nn.functional.normalize(_random(500, 3) - 0.5, dim=1).to(device)
    levels = PrefilteredStack(32, 64, device).build(image)
    return _with_gradients(envmap.lookup(image, directions), environment=image) | {"prefiltered": levels}


def _losses(device: torch.device) -> Results:
    image, target = (_random(70, 44, 3, seed=s).to(device) for s in range(2))
    image.requires_grad_()
    return _with_gradients(losses.d_ssim(image, target) + losses.log_l1(image, target), image=image)


def _adam(device: torch.device) -> Results:
    values, gradient = _random(400, 3).to(device), _random(400, 3, seed=1).to(device) - 0.5
    first, second = torch.zeros_like(values), torch.zeros(400, device=device)
    for step in (1, 2):
        adam_step(values, gradient * step, first, second, step, 0.01)
    return {"values": values, "second moment": second}


def _stage_one(device: torch.device) -> Results:
    from exmesh_graph.stage1.refine import refine
    from exmesh_graph.stage1.settings import RefineSettings

    start = testing.carrier()
    new, _ = refine(
        testing.state(start, fill=0.5), testing.views(start, 2), RefineSettings(iterations=2), device=device
    )
    return {"moved vertices": torch.from_numpy(new.vertices), "texture": torch.from_numpy(new.texture)}


def _stage_two(device: torch.device) -> Results:
    from exmesh_graph.shading.transport import trace_transport, with_bounces
    from exmesh_graph.stage2.decomposition import Decomposition
    from exmesh_graph.stage2.objective import weighted_terms
    from exmesh_graph.stage2.settings import DecompositionSettings

    ball = testing.carrier()
    light = with_bounces(trace_transport(ball.vertices, ball.faces, 64, 1), 1)
    settings = DecompositionSettings(environment_height=16, indirect_ramp=1)
    model = Decomposition(ball, testing.views(ball, 2), light, settings, str(device))
    model.start()
    terms, radiance = weighted_terms(model, model.buffers[0], 1)
    leaves = {"maps": model.maps.parameter, "sky": model.environment, "common factor": model.factor.parameter}
    return {"radiance": radiance, **_with_gradients(torch.stack(list(terms.values())), **leaves)}


TRIALS: dict[str, Trial] = {
    "visibility": _visibility,
    "shading and antialiasing": _picture,
    "texture lookup and mip-maps": _texture,
    "rays": _rays,
    "Gaussians": _gaussians,
    "reflectance": _reflectance,
    "environment": _environment,
    "image losses": _losses,
    "Adam": _adam,
    "two iterations of Stage I": _stage_one,
    "a step of Stage II": _stage_two,
}


def _random(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


def _with_gradients(value: torch.Tensor, **leaves: torch.Tensor) -> Results:
    """The value, and the gradients of its sum under fixed random weights."""
    weight = _random(*value.shape, seed=9).to(value) - 0.5
    gradients: Sequence[Any] = torch.autograd.grad((value * weight).sum(), list(leaves.values()))
    named = {f"gradient of {name}": gradient for name, gradient in zip(leaves, gradients, strict=True)}
    return {"value": value, **named}


if __name__ == "__main__":
    print(json.dumps([outcome._asdict() for outcome in check(sys.argv[1])]))
