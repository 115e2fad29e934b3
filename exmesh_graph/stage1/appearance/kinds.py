"""The model that a carrier's arrays describe."""

from __future__ import annotations

import numpy as np
import torch

from exmesh_graph.errors import DataError
from exmesh_graph.stage1.appearance.mlp import Mlp
from exmesh_graph.stage1.appearance.model import Model, Moments
from exmesh_graph.stage1.appearance.surface import PerFace, PerVertex
from exmesh_graph.stage1.appearance.texture import UVTexture
from exmesh_graph.types import Carrier, Stage1State


def model_of(carrier: Carrier, device: torch.device | str = "cpu") -> Model:
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
    kinds = {"per_vertex": (PerVertex, len(carrier.vertices)), "per_face": (PerFace, len(carrier.faces))}
    if carrier.appearance not in kinds:
        raise DataError(f"the state's appearance {carrier.appearance!r} is unknown", expected="a model of this version")
    kind, count = kinds[carrier.appearance]
    if len(values) != count:
        raise DataError(
            f"the state has {len(values)} {carrier.appearance} colours", expected=str(count),
            fix="let the node that changed the topology carry them (Stage1State.carried)",
        )  # fmt: skip
    return kind(values, moments)
