"""What split and merge share: stable scores and the greedy choice of operations that touch disjoint faces."""

from __future__ import annotations

import numpy as np


def greedy_disjoint(priority: np.ndarray, offsets: np.ndarray, touched: np.ndarray, n_faces: int) -> np.ndarray:
    """The operations that a sequential pass carries out: in order, skipping what touches a face already changed.

    priority  int [N], a permutation: 0 goes first
    offsets, touched   operation n touches the faces touched[offsets[n]:offsets[n + 1]]
    Returns their indices in order of priority. Every turn accepts all operations that go first on each of their faces
    and drops the ones they exclude; this is the lexicographically first independent set, found in few turns.
    """
    operation = np.repeat(np.arange(len(priority)), np.diff(offsets))
    face = touched
    accepted = np.zeros(len(priority), bool)
    while len(operation):
        first = np.full(n_faces, len(priority), np.int64)
        np.minimum.at(first, face, priority[operation])
        beaten = np.zeros(len(priority), bool)
        beaten[operation[first[face] < priority[operation]]] = True
        wins = operation[~beaten[operation]]
        accepted[wins] = True
        changed = np.zeros(n_faces, bool)
        changed[face[~beaten[operation]]] = True
        out = ~beaten
        out[operation[changed[face]]] = True
        left = ~out[operation]
        operation, face = operation[left], face[left]
    chosen = np.flatnonzero(accepted)
    return chosen[np.argsort(priority[chosen], kind="stable")]


def rounded(values: np.ndarray) -> np.ndarray:
    """Values relative to their largest magnitude, rounded to 1e-6: equal up to float32 rounding means equal."""
    largest = np.abs(values).max(initial=0.0)
    return np.round(values / largest, 6) if largest > 0 else np.zeros_like(values)


def rank01(values: np.ndarray) -> np.ndarray:
    """The rank of each value in its own mesh, in [0, 1]; equal values share their mean rank. Scale free."""
    _, inverse, count = np.unique(rounded(values), return_inverse=True, return_counts=True)
    end = np.cumsum(count)
    mean_rank = end - 0.5 * (count + 1)
    return (mean_rank / max(len(values) - 1, 1))[inverse]


def ranges(first: np.ndarray, size: np.ndarray) -> np.ndarray:
    """first[0], first[0] + 1, ... (size[0] of them), first[1], ..."""
    return np.arange(int(size.sum())) + np.repeat(first - (np.cumsum(size) - size), size)
