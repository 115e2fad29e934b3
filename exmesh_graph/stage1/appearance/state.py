"""From a state to appearance models: the model that it holds, and first values read from its texture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from exmesh_graph.errors import DataError, GeometryError
from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.stage1.appearance.colours import PerFace, PerVertex, UVTexture
from exmesh_graph.stage1.appearance.directional import COUNTS, Directional
from exmesh_graph.stage1.appearance.mlp import Mlp, layers, weight_count
from exmesh_graph.stage1.appearance.model import AppearanceModel, Moments
from exmesh_graph.types import Carrier, Stage1State
from exmesh_graph.uv.raster import rasterize_atlas
from exmesh_graph.uv.transfer import sample_bilinear

_INSIDE = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4], [2, 2, 2]]) / 6
_STEPS, _BATCH, _RATE = 300, 4096, 0.02


def model_of(carrier: Carrier, device: torch.device | str = "cpu") -> AppearanceModel:
    """The appearance of a carrier: the model of a Stage I state, the texture of any other (copies of the arrays)."""

    def tensor(array: np.ndarray) -> torch.Tensor:
        return torch.tensor(np.asarray(array, np.float32), device=device)

    if not isinstance(carrier, Stage1State):
        return UVTexture(tensor(carrier.texture))
    if carrier.appearance == "uv_texture":
        return UVTexture(tensor(carrier.texture), Moments(tensor(carrier.texture_m), tensor(carrier.texture_v)))
    kept = carrier.model
    values, moments = tensor(kept["values"]), Moments(tensor(kept["m"]), tensor(kept["v"]))
    if carrier.appearance == "mlp":
        frequencies, width = (int(n) for n in kept["shape"])
        return Mlp(values, moments, frequencies=frequencies, width=width, box=tensor(kept["box"]))
    if carrier.appearance == "directional":
        _of_each(values, "residuals", len(carrier.vertices))
        texture = tensor(carrier.texture), Moments(tensor(carrier.texture_m), tensor(carrier.texture_v))
        shrinkage, rate = (float(x) for x in kept["settings"])
        return Directional(*texture, values, moments, tensor(kept["mean"]), shrinkage=shrinkage, rate=rate)
    kinds = {"per_vertex": (PerVertex, len(carrier.vertices)), "per_face": (PerFace, len(carrier.faces))}
    if carrier.appearance not in kinds:
        raise DataError(f"the state's appearance {carrier.appearance!r} is unknown", expected="a model of this version")
    kind, count = kinds[carrier.appearance]
    _of_each(values, f"{carrier.appearance} colours", count)
    return kind(values, moments)


def per_vertex(state: Stage1State) -> Stage1State:
    """Colours of the vertices: the mean of the texture at their corners."""
    colours = sample_bilinear(state.texture, state.uvs[state.uv_faces].reshape(-1, 2))
    corners = state.faces.reshape(-1)
    total = np.stack([np.bincount(corners, colours[:, c], len(state.vertices)) for c in range(3)], axis=1)
    count = np.bincount(corners, minlength=len(state.vertices))[:, None]
    return _with(state, "per_vertex", np.where(count > 0, total / np.maximum(count, 1), 0.5))


def per_face(state: Stage1State) -> Stage1State:
    """Colours of the faces: the mean of the texture at four points inside."""
    corners = state.uvs[state.uv_faces]
    colours = [sample_bilinear(state.texture, np.einsum("k,fkc->fc", weights, corners)) for weights in _INSIDE]
    return _with(state, "per_face", np.mean(colours, axis=0))


def directional(state: Stage1State, *, order: int, shrinkage: float, rate: float) -> Stage1State:
    """The texture as it is, with a residual of zero; harmonics up to `order`, 1 or 2."""
    vertices, count = len(state.vertices), COUNTS[order]
    residual = np.zeros((vertices, 3 * count), np.float32)
    model = {
        "values": residual, "m": residual, "v": np.zeros(vertices, np.float32),
        "mean": np.zeros((vertices, count), np.float32), "settings": np.array([shrinkage, rate], np.float32),
    }  # fmt: skip
    return replace(state, appearance="directional", model=model)


def mlp(
    state: Stage1State, *, frequencies: int, width: int, seed: int, device: torch.device | str = "cpu"
) -> Stage1State:
    """A network fitted to the first texture by a few hundred steps over random texels; weights drawn from `seed`.

    Raises GeometryError for vertices that all lie in one point.
    """
    low, high = state.vertices.min(axis=0), state.vertices.max(axis=0)
    radius = 0.5 * float(np.linalg.norm((high - low).astype(np.float64)))
    if not radius > 0:
        raise GeometryError("the carrier has no extent", where="stage1.init, port appearance")
    rng = torch.Generator().manual_seed(seed)
    weights = torch.zeros(weight_count(frequencies, width))
    begin = 0
    for out, into in layers(frequencies, width):
        bound = (6 / into) ** 0.5 if out == width else (3 / into) ** 0.5  # He et al. 2015; no rectifier after the last
        weights[begin : begin + out * into].uniform_(-bound, bound, generator=rng)
        begin += out * (into + 1)
    box = torch.tensor([*(0.5 * (low + high)), radius], dtype=torch.float32, device=device)
    model = Mlp(weights.to(device), None, frequencies=frequencies, width=width, box=box)

    face_id, bary = rasterize_atlas(state.uvs, state.uv_faces, state.texture.shape[0])
    covered = face_id >= 0
    corners = state.vertices[state.faces[face_id[covered]]]
    points = tensor_of(np.einsum("nk,nkc->nc", bary[covered], corners)).to(device)
    colours = tensor_of(state.texture[covered]).to(device)
    model.values.requires_grad_()
    for step in range(_STEPS if len(points) else 0):
        chosen = torch.randint(len(points), (_BATCH,), generator=rng).to(device)
        error = (model.colour(points[chosen]) - colours[chosen]).abs().mean()
        (gradient,) = torch.autograd.grad(error, model.values)
        model.step((gradient,), step + 1, _RATE * (1 - step / _STEPS), 0.0)
    for moment in model.moments:
        moment.zero_()
    return replace(state, appearance="mlp", model=model.arrays())


def _of_each(values: torch.Tensor, what: str, count: int) -> None:
    if len(values) != count:
        raise DataError(
            f"the state has {len(values)} {what}", expected=str(count),
            fix="let the node that changed the topology carry them (Stage1State.carried)",
        )  # fmt: skip


def _with(state: Stage1State, kind: str, colours: np.ndarray) -> Stage1State:
    values = np.clip(colours, 0, 1).astype(np.float32)
    return replace(
        state, appearance=kind, model={"values": values, "m": np.zeros_like(values), "v": np.zeros_like(values)}
    )
