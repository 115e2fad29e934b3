"""Files of network weights that metrics read, looked at without the networks' libraries: before minutes are spent."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from exmesh_graph.errors import MissingLibraryError

#: torchvision's indices of VGG-16's convolutions, block by block; between blocks 2 x 2 max pooling
BLOCKS = ((0, 2), (5, 7), (10, 12, 14), (17, 19, 21), (24, 26, 28))
_HOW = "make the file as docs/metrics.md says (section LPIPS), and give its path, or leave `lpips` out"


def lpips_source(path: Path | None) -> Mapping[str, Path]:
    """LPIPS's file of weights as a node's source, {} for None. MissingLibraryError as `check_lpips`."""
    return {} if path is None else {path.name: check_lpips(path)}


def check_lpips(path: Path | str | None) -> Path:
    """The file, when its header has all tensors; MissingLibraryError for none, and for one that lacks any."""
    from safetensors import SafetensorError, safe_open

    if path is None or not Path(path).is_file():
        raise MissingLibraryError(
            f"LPIPS needs the weights of its network, and {'no file' if path is None else path} is there",
            expected="a .safetensors file with VGG-16's convolutions and LPIPS's five lin layers", fix=_HOW,
        )  # fmt: skip
    try:
        with safe_open(str(path), framework="numpy") as file:
            shapes = {name: tuple(file.get_slice(name).get_shape()) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise MissingLibraryError(
            f"the LPIPS weights cannot be read ({error})", where=str(path),
            expected="a .safetensors file (pickled .pth files are not read)", fix=_HOW,
        ) from error  # fmt: skip
    for name, shape in expected_shapes().items():
        if shapes.get(name) != shape:
            raise MissingLibraryError(
                f"the LPIPS weights do not fit: {name} is {shapes.get(name, 'missing')}", where=str(path),
                expected=f"{name} of shape {shape}", fix=_HOW,
            )  # fmt: skip
    return Path(path)


def expected_shapes() -> dict[str, tuple[int, ...]]:
    """Name and shape of every tensor the weights' file must hold."""
    shapes: dict[str, tuple[int, ...]] = {}
    before = 3
    for layer, (indices, width) in enumerate(zip(BLOCKS, (64, 128, 256, 512, 512), strict=True)):
        for index in indices:
            shapes[f"features.{index}.weight"] = (width, before, 3, 3)
            shapes[f"features.{index}.bias"] = (width,)
            before = width
        shapes[f"lin{layer}.model.1.weight"] = (1, width, 1, 1)
    return shapes
