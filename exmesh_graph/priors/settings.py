"""What the depth priors are told: the parameters of the solvers, and of their nodes. Loads no torch."""

from __future__ import annotations

from pathlib import Path

from pydantic import field_validator

from exmesh_graph.params import Params, param


def odd(window: int, unit: str) -> int:
    """The side of a window; ValueError where it has no middle."""
    if window % 2 == 0:
        raise ValueError(f"a window of {window} {unit} has no middle {unit[:-1]}: write {window + 1}")
    return window


class SweepSettings(Params):
    """Of `plane_sweep.plane_sweep`."""

    planes: int = param(128, ge=8, le=1024, doc="Depths tried for every pixel, over the unit sphere.")
    neighbours: int = param(4, ge=1, le=16, unit="views", doc="Views compared with, about 10 degrees away.")
    window: int = param(9, ge=3, le=31, unit="pixels", doc="Side of the compared windows, in reduced pictures; odd.")
    downscale: int = param(2, ge=1, le=16, doc="Compare pictures reduced by this factor.")
    min_score: float = param(0.6, ge=-1, le=1, doc="Least correlation of the windows.")
    agreeing: int = param(2, ge=0, unit="views", doc="Neighbours that must have found the same point.")
    tolerance: float = param(0.01, gt=0, le=1, doc="How far those may be off, as a share of the depth.")

    @field_validator("window")
    @classmethod
    def _has_a_middle(cls, window: int) -> int:
        return odd(window, "pixels")


class NetworkSettings(Params):
    """Of `depth_anything.estimate`."""

    model: str = param(
        "depth-anything/DA3-BASE", min_length=1, doc="Model on the Hugging Face hub; unused where weights are given."
    )
    revision: str = param("", doc="Branch, tag or commit of the model; empty: the newest.")
    weights: Path | None = param(None, doc="Folder with config.json and model.safetensors, instead of the hub.")
    resolution: int = param(504, ge=56, le=4096, unit="pixels", doc="Longest side of the pictures in the network.")
    batch: int = param(8, ge=1, unit="views", doc="Views that the network sees at once; bounds memory.")
    cameras: bool = param(True, doc="Tell the network the cameras; false for the monocular and metric models.")


class PatchMatchSettings(Params):
    """Of `patch_match.estimate.patch_match`."""

    side: int = param(640, ge=32, unit="px", doc="Compare pictures whose longer side is at most this.")
    sources: int = param(4, ge=1, le=16, unit="views", doc="Views compared with, about 15 degrees away.")
    best: int = param(2, ge=1, le=8, unit="views", doc="How many of them, the most alike, decide at a pixel.")
    window: int = param(5, ge=3, le=9, unit="samples", doc="Side of the compared windows; odd.")
    step: int = param(2, ge=1, le=3, unit="pixels", doc="Between a window's samples; 1: finer, where paint is rich.")
    trials: int = param(2, ge=0, le=16, unit="planes", doc="Random planes tried at a pixel in an iteration.")
    min_score: float = param(
        0.4, ge=-1, le=1, doc="Least confidence in views without a mask; with one, other views alone decide."
    )
    agreeing: int = param(2, ge=0, unit="views", doc="Neighbours, of up to eight, that must have found the same point.")
    tolerance: float = param(0.01, gt=0, le=1, doc="How far those may be off, as a share of the depth.")

    @field_validator("window")
    @classmethod
    def _has_a_middle(cls, window: int) -> int:
        return odd(window, "samples")
