"""Random and hard sets of Gaussians, and cameras that look at them."""

import torch

from exmesh_graph.splat.gaussians import Gaussians


def camera(width=24, height=18, *, turn=0.4, distance=3.0, skew=0.0, shift=(0.0, 0.0), focal=1.2):
    """(intrinsics, world_to_camera), float64: off-centre by `shift` pixels, turned about y."""
    k = torch.tensor([[focal * width, skew, width / 2 + shift[0]], [0, 1.1 * focal * width, height / 2 + shift[1]]])
    intrinsics = torch.cat([k.double(), torch.tensor([[0.0, 0, 1]]).double()])
    c, s = torch.cos(torch.tensor(turn).double()), torch.sin(torch.tensor(turn).double())
    pose = torch.eye(4, dtype=torch.float64)
    pose[0, 0], pose[0, 2], pose[2, 0], pose[2, 2] = c, s, -s, c
    pose[2, 3] = distance
    return intrinsics, pose


def cloud(count, *, seed=0, size=0.2, spread=0.8, flat=0.1, opacity=1.0, degree=3, dtype=torch.float64):
    """Gaussians about the origin: `size` their long axes, `flat` the short one's share of it."""
    g = torch.Generator().manual_seed(seed)

    def normal(*shape):
        return torch.randn(*shape, generator=g, dtype=torch.float64)

    scales = torch.log(size * (0.3 + torch.rand(count, 3, generator=g, dtype=torch.float64)))
    scales[torch.arange(count), torch.randint(3, (count,), generator=g)] += torch.log(torch.tensor(flat).double())
    made = Gaussians(
        spread * normal(count, 3), scales, normal(count, 4), opacity * (1 + normal(count)),
        0.4 * normal(count, (degree + 1) ** 2, 3),
    )  # fmt: skip
    return made.map(lambda t: t.to(dtype))
