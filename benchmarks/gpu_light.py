"""Monte Carlo light at the paper's sample counts on a GPU: relit frames per second, and a whole Stage II iteration.

    python -m benchmarks.gpu_light                 # CUDA; 1600 x 1600 relighting, 800 x 800 iteration
    python -m benchmarks.gpu_light --quick         # small, on whatever device there is: does it run?

Relighting (the paper on an RTX A6000: 40.5 direct, 15.1 with one bounce): each frame gets a new sky, builds its
sampler, rasterises, reads the maps, traces, shades and goes to sRGB; loading, and the first frame, are left out.
N_d = 8, N_b = 16 at half resolution, N_s = 4. "mis": as many rays by the balance heuristic.
Iteration (the paper: 102 ms): one view, 2048 maps of base colour, roughness and normal, a 256 x 512 sky, direct and one
bounce, log-L1 + D-SSIM + total variation, gradient by a seed of its own or shared, Adam on everything.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import torch

from benchmarks import light_scene
from benchmarks.gradient_seed import independent_gradient
from exmesh_graph.gpu.torch_setup import pick_device
from exmesh_graph.losses import d_ssim, linear_to_srgb, log_l1, ssim_target
from exmesh_graph.raster import rasterize
from exmesh_graph.rays import make_ray_tracer
from exmesh_graph.shading import envmap
from exmesh_graph.shading.gather import gather_rows
from exmesh_graph.shading.monte_carlo import Material, MonteCarloLight, Points, coarse_points
from exmesh_graph.shading.settings import MonteCarloSettings
from exmesh_graph.stage2.surface import texel_footprint

PAPER = MonteCarloSettings()


def main() -> None:
    options = arguments()
    device = pick_device("auto" if options.quick else "cuda")
    where = f"cuda:{torch.cuda.current_device()}" if device.type == "cuda" else "cpu"
    print(torch.cuda.get_device_name() if device.type == "cuda" else f"CPU, {torch.get_num_threads()} threads")
    rows = relight(options, where) + iterate(options, where)
    for row in rows:
        print(f"{row['name']:44}{row['milliseconds']:10.1f} ms {1000 / row['milliseconds']:9.2f} / s  {row['peak']}")
    if options.out:
        options.out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def relight(options: argparse.Namespace, device: str) -> list[dict]:
    world = World(options.relight, options.sky, options.texture, device)
    skies = [torch.roll(world.scene.sky, 7 * k, dims=1).cpu() for k in range(options.frames + 1)]
    rows = []
    for name, settings, bounce in (
        ("relight, direct", PAPER, False),
        ("relight, direct, mis", PAPER.replaced(technique="mis"), False),
        ("relight, direct and one bounce", PAPER, True),
        ("relight, direct and one bounce, mis", PAPER.replaced(technique="mis"), True),
    ):
        light = MonteCarloLight(world.scene.surface, world.tracer, settings)

        @torch.no_grad()
        def frame(number: int, light: MonteCarloLight = light, bounce: bool = bounce) -> None:
            sky = skies[number].to(device)
            points, pixel, material = world.view(options.relight)
            coarse = coarse_points(points, pixel, options.relight) if bounce else None
            image = light.render(points, material, world.query() if bounce else None, sky, number, coarse=coarse)
            whole = torch.zeros(options.relight**2, 3, device=device)
            whole[pixel] = linear_to_srgb(image)

        rows.append({"name": name, **measure(frame, options.frames, device)})
    return rows


def iterate(options: argparse.Namespace, device: str) -> list[dict]:
    world = World(options.view, options.sky, options.texture, device)
    light = MonteCarloLight(world.scene.surface, world.tracer, PAPER)
    points, pixel, _ = world.view(options.view)
    coarse = coarse_points(points, pixel, options.view)
    sky = envmap.parameter_of(world.scene.sky).requires_grad_()
    maps = world.maps.requires_grad_()
    optimiser = torch.optim.Adam([maps, sky], lr=1e-2, fused=device != "cpu")
    size = (options.view, options.view)
    mask = torch.zeros(options.view**2, device=device)
    mask[pixel] = 1
    target = torch.rand(len(pixel), 3, device=device)
    shown = ssim_target(_place(linear_to_srgb(target), pixel, size))

    def image(seed: int, maps: torch.Tensor, radiance: torch.Tensor) -> torch.Tensor:
        bent, material = world.read(points.flat, world.uv_at(points.position), maps)
        here = Points(points.position, points.flat, bent, points.view)
        return light.render(here, material, world.query(maps), radiance, seed, coarse=coarse)

    def step(number: int, own_seed: bool) -> None:
        radiance = envmap.radiance_of(sky)
        if own_seed:
            found = independent_gradient(image, 2 * number, 2 * number + 1, maps, radiance)
        else:
            found = image(2 * number, maps, radiance)
        projected = _place(gather_rows(maps, *world.footprint(points.position)), pixel, size)
        loss = log_l1(found, target) + 0.2 * d_ssim(_place(linear_to_srgb(found), pixel, size), shown)
        loss = loss + 0.1 * total_variation(projected, mask.view(size) > 0) + 0.1 * envmap.total_variation(radiance)
        optimiser.zero_grad()
        (loss + 0.1 * envmap.chroma(radiance)).backward()
        optimiser.step()

    rows = []
    for name, own in (("Stage II iteration, one seed", False), ("Stage II iteration, the gradient's own seed", True)):
        rows.append({"name": name, **measure(lambda n, own=own: step(n, own), options.frames, device)})
    return rows


class World:
    """`light_scene` with its materials in texture maps [T^2, 7]: base colour, roughness, tangent-free normal offset."""

    def __init__(self, size: int, sky_height: int, texture: int, device: str) -> None:
        self.scene = light_scene.build(size, sky_height, device=device)
        self.tracer = make_ray_tracer(self.scene.vertices, self.scene.faces, device)
        self.size, self.device = texture, device
        rng = torch.Generator().manual_seed(0)
        coarse = torch.rand(1, 4, 32, 32, generator=rng)
        smooth = torch.nn.functional.interpolate(coarse, (texture, texture), mode="bilinear")[0]
        maps = torch.cat([0.2 + 0.6 * smooth, torch.zeros(3, texture, texture)])
        self.maps = maps.reshape(7, -1).T.contiguous().to(device)
        intrinsics, pose = light_scene.camera(size)
        self.intrinsics = torch.from_numpy(intrinsics).to(device)
        self.pose = torch.from_numpy(pose).to(device)

    def uv_at(self, position: torch.Tensor) -> torch.Tensor:
        """A plane's projection: overlapping, continuous, the same everywhere."""
        x, y, z = position.unbind(-1)
        return torch.stack([0.5 + 0.3 * (x + 0.4 * y), 0.5 + 0.3 * (z + 0.4 * y)], dim=1).clamp(0, 1)

    def footprint(self, position: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return texel_footprint(self.uv_at(position), self.size)

    def read(self, flat: torch.Tensor, uv: torch.Tensor, maps: torch.Tensor) -> tuple[torch.Tensor, Material]:
        found = gather_rows(maps, *texel_footprint(uv, self.size))
        bent = torch.nn.functional.normalize(flat + found[:, 4:], dim=-1)
        return bent, Material(found[:, :3], found[:, 3])

    def query(self, maps: torch.Tensor | None = None) -> Callable:
        chosen = self.maps if maps is None else maps

        def at(face: torch.Tensor, bary: torch.Tensor) -> tuple[torch.Tensor, Material]:
            surface = self.scene.surface
            return self.read(surface.face_normals[face], self.uv_at(surface.at(face, bary)), chosen)

        return at

    def view(self, size: int) -> tuple[Points, torch.Tensor, Material]:
        """Rasterise: the covered pixels' points, their places in the image and their material."""
        surface = self.scene.surface
        fragments = rasterize(surface.vertices, surface.faces.int(), self.intrinsics, self.pose, size, size)
        face = fragments.face_id.reshape(-1)
        pixel = torch.nonzero(face >= 0)[:, 0]
        face, bary = face[pixel].long(), fragments.bary.reshape(-1, 3)[pixel]
        position, flat = surface.at(face, bary), surface.face_normals[face]
        eye = torch.as_tensor(light_scene.EYE, dtype=torch.float32, device=self.device)
        view = torch.nn.functional.normalize(eye - position, dim=-1)
        flat = torch.where(((flat * view).sum(-1) < 0)[:, None], -flat, flat)
        normal, material = self.read(flat, self.uv_at(position), self.maps.detach())
        return Points(position, flat, normal, view), pixel, material


def _place(values: torch.Tensor, pixel: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    image = values.new_zeros(size[0] * size[1], values.shape[1])
    return image.index_copy(0, pixel, values).view(*size, -1)


def measure(step: Callable[[int], None], count: int, device: str) -> dict[str, object]:
    """Mean milliseconds of steps 1 to `count`; step 0 warms up."""
    cuda = device != "cpu"
    step(0)
    if cuda:
        torch.cuda.synchronize()
        torch.cuda.reset_peak_memory_stats()
    began = time.perf_counter()
    for number in range(1, count + 1):
        step(number)
    if cuda:
        torch.cuda.synchronize()
    took = (time.perf_counter() - began) / count
    peak = f"{torch.cuda.max_memory_allocated() / 2**20:.0f} MiB" if cuda else ""
    return {"milliseconds": 1000 * took, "peak": peak}


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.gpu_light", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--relight", type=int, default=1600, help="pixels on a side of a relit frame")
    parser.add_argument("--view", type=int, default=800, help="pixels on a side of a training view")
    parser.add_argument("--sky", type=int, default=256, help="rows of the environment")
    parser.add_argument("--texture", type=int, default=2048)
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--quick", action="store_true", help="small, also on a CPU")
    parser.add_argument("--out", type=Path, help="write the figures as JSON")
    options = parser.parse_args()
    if options.quick:
        options.relight, options.view, options.sky, options.texture, options.frames = 96, 64, 32, 128, 2
    return options


def total_variation(image: torch.Tensor, mask: torch.Tensor | None = None) -> torch.Tensor:
    """Mean absolute difference of horizontal plus of vertical neighbours of [H, W, C].

    `mask` bool [H, W] keeps the pairs with both ends inside; 0 where no pair is left.
    """
    total = image.new_zeros(())
    for axis in (0, 1):
        size = image.shape[axis]
        if size < 2:
            continue
        difference = (image.narrow(axis, 1, size - 1) - image.narrow(axis, 0, size - 1)).abs()
        if mask is None:
            total = total + difference.mean()
        else:
            pairs = mask.narrow(axis, 1, size - 1) & mask.narrow(axis, 0, size - 1)
            kept = torch.where(pairs[..., None], difference, 0.0).sum()
            total = total + kept / (pairs.sum() * image.shape[-1]).clamp(min=1)
    return total


if __name__ == "__main__":
    main()
