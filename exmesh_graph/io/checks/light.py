"""Were training and test pictures taken alike? Brightness and colour of test views beside training views near them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from exmesh_graph.io.checks.finding import Finding

_EXPOSURE, _BALANCE = np.log(1.2), np.log(1.1)
_FEWEST = 2
#: Training views beside a test view, and the least cosine, on the mean, between their directions and its own: sides of
#: an object that lie farther apart than 40 degrees may differ by paint.
_NEAREST, _BESIDE = 3, 0.766


def check_light(
    train: tuple[np.ndarray, np.ndarray],
    held: tuple[np.ndarray, np.ndarray],
    middle: np.ndarray,
    names: tuple[str, ...],
) -> list[Finding]:
    """Compare (mean linear colours [N, 3], camera positions [N, 3]) of both splits; `middle` [3] is where they look.

    A test view's colour is set beside the mean of its three nearest training views (by direction), and each training
    view likewise beside its own: what differs by far more than those do, over the median test view, is exposure or
    white balance. Test views that no training views lie beside are not asked.
    """
    if len(names) < _FEWEST or len(train[0]) < _NEAREST + 1:
        return []
    off, beside = _differences(*held, *train, middle, 0)
    usual, _ = _differences(*train, *train, middle, 1)
    off = off[beside >= _BESIDE]
    if len(off) < _FEWEST:
        return []
    shift = np.median(off, axis=0)
    error = 3 * 1.25 * np.median(np.abs(usual - np.median(usual, axis=0)), axis=0) * 1.48 / np.sqrt(len(off))
    findings = []
    idle = "scores of the test views mean little until then"
    if abs(shift[0]) > max(_EXPOSURE, error[0]):
        times, how = np.exp(abs(shift[0])), "bright" if shift[0] > 0 else "dark"
        findings.append(Finding(
            "exposure", f"the test pictures are {times:.2f} times as {how} as training pictures from beside them",
            "another exposure, another light, or a colour space that was told wrongly",
            f"take or develop both with one exposure; {idle}", names, grave=False,
        ))  # fmt: skip
    if (np.abs(shift[1:]) > np.maximum(_BALANCE, error[1:])).any():
        red, blue = np.exp(shift[1:])
        findings.append(Finding(
            "white balance", f"the test pictures have {red:.2f} times the red and {blue:.2f} times the blue, beside "
            "green, of training pictures from beside them", "another white balance or light",
            f"develop both with one white balance; {idle}", names, grave=False,
        ))  # fmt: skip
    return findings


def mean_colours(images: Iterable[np.ndarray], alpha: Iterable[np.ndarray]) -> np.ndarray:
    """float64 [N, 3]: mean straight colour over the object, from linear premultiplied pictures, clipped at 1."""
    weight = [max(float(coverage.sum(dtype=np.float64)), 1e-9) for coverage in alpha]
    sums = [np.minimum(image, 1).sum(axis=(0, 1), dtype=np.float64) for image in images]
    return np.stack(sums) / np.array(weight)[:, None]


def _differences(
    colours: np.ndarray, places: np.ndarray, others: np.ndarray, other_places: np.ndarray, middle: np.ndarray, skip: int
) -> tuple[np.ndarray, np.ndarray]:
    """[N, 3] logarithms of (luminance, red / green, blue / green) over the mean of the nearest of the others; [N] the
    mean cosine between the directions of these and its own."""
    near = _directions(places, middle) @ _directions(other_places, middle).T
    chosen = np.argsort(-near, axis=1, kind="stable")[:, skip : skip + _NEAREST]
    values, other_values = _logarithms(colours), _logarithms(others)
    return values - other_values[chosen].mean(axis=1), np.take_along_axis(near, chosen, axis=1).mean(axis=1)


def _logarithms(colours: np.ndarray) -> np.ndarray:
    red, green, blue = np.log(np.maximum(colours, 1e-6)).T
    return np.stack([np.log(np.maximum(colours.mean(axis=1), 1e-6)), red - green, blue - green], axis=1)


def _directions(places: np.ndarray, middle: np.ndarray) -> np.ndarray:
    away = places - middle
    return away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
