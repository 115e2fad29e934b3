"""How vertices before a topology operation become vertices after it, and how their attributes follow."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, eq=False)
class Step:
    """One operation: the kept vertices first, then the new ones, each on an edge of the old mesh.

    kept   int64 [K], old index of each kept vertex
    a, b   int64 [N], old indices of the ends of the edge that carries each new vertex
    mu     float64 [N], its place: (1 - mu) a + mu b
    """

    kept: np.ndarray
    a: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    b: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    mu: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def carry(self, values: np.ndarray, new: str = "interpolate") -> np.ndarray:
        """`values` [V, ...] at the old vertices -> at the new ones; new = "interpolate" or "zero"."""
        mu = self.mu.reshape(-1, *[1] * (values.ndim - 1))
        added = (1.0 - mu) * values[self.a] + mu * values[self.b]
        if new == "zero":
            added = np.zeros_like(added)
        return np.concatenate([values[self.kept], added.astype(values.dtype)])


@dataclass(frozen=True, eq=False)
class VertexMap:
    """A sequence of steps: what several rounds of splits or merges did to the vertices."""

    steps: tuple[Step, ...] = ()

    def then(self, step: Step) -> VertexMap:
        """This map followed by `step`."""
        return VertexMap((*self.steps, step))

    def carry(self, values: np.ndarray, new: str = "interpolate") -> np.ndarray:
        """Carry a per-vertex attribute [V, ...] through all steps; the dtype stays.

        new  what a new vertex gets: "interpolate" between the ends of its edge, or "zero". Adam's moments are
             interpolated: with a zero second moment and a late step count the first update of a new vertex is
             (1 - b1) / sqrt(1 - b2) = 3 learning rates long, whatever its gradient.
        """
        for step in self.steps:
            values = step.carry(values, new)
        return values
