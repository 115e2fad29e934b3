"""Views as displayed: all of them in memory, or as many as a budget holds and the rest made anew at each visit."""

from __future__ import annotations

import threading
import weakref
from collections import OrderedDict
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
import torch

from exmesh_graph.gpu.cores import share
from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.losses import display
from exmesh_graph.types import Views
from exmesh_graph.types.pictures import Pictures

PIXEL_BYTES = 16
"""Of a displayed picture and its mask."""
_AHEAD = 2
_LANES = 64  # pixels: their values fill vector registers of any width
_last: dict[tuple[int, int, int, str], tuple[torch.Tensor, torch.Tensor, list[Any]]] = {}

Pair = tuple[torch.Tensor, torch.Tensor]


def shown(
    views: Views, downscale: int, device: torch.device | str, budget: float
) -> tuple[torch.Tensor | Plane, torch.Tensor | Plane]:
    """(display images float32 [N, h, w, 3], coverage [N, h, w]) of all views at 1 / `downscale`, by area means.

    Tensors where both fit into `budget` bytes; the last ones are kept while their views live: rounds of Stage I ask
    for the same ones again, and a power for every pixel costs as much as some iterations. Else Planes, which give the
    same values.
    """
    height, width = views.height // downscale, views.width // downscale
    if PIXEL_BYTES * len(views) * height * width > budget:
        visited = Visited(views, downscale, device, budget)
        return Plane(visited, 0), Plane(visited, 1)
    key = (id(views.images), id(views.alpha), downscale, str(device))
    if key in _last:
        return _last[key][:2]
    images = torch.empty((len(views), height, width, 3), device=device)
    alpha = torch.empty((len(views), height, width), device=device)

    def put(view: int) -> None:
        images[view], alpha[view] = displayed(views, view, downscale, device)

    share(put, range(len(views)))
    _last.clear()  # not in the key: a cache
    # not in the key: a cache; the arrays' ids stand for them only while they live
    gone = [weakref.ref(array, lambda _: _last.pop(key, None)) for array in (views.images, views.alpha)]
    _last[key] = (images, alpha, gone)  # not in the key: a cache
    return images, alpha


def displayed(views: Views, view: int, downscale: int, device: torch.device | str) -> Pair:
    """One view: display image float32 [h, w, 3] and coverage [h, w]."""
    alpha = tensor_of(views.alpha[view])
    if downscale == 1 and isinstance(views.images, Pictures):
        codes = views.images.codes(view)
        if codes.dtype.kind == "u":
            image = _by_table(codes, views.images.table(view, codes.dtype), alpha)
            return image.to(device), alpha.to(device)
    colour, alpha = tensor_of(views.images[view]).to(device), alpha.to(device)
    if downscale > 1:
        height, width = (n // downscale for n in alpha.shape)
        colour, alpha = (t[: height * downscale, : width * downscale] for t in (colour, alpha))
        cells = (height, downscale, width, downscale)
        colour, alpha = colour.reshape(*cells, 3).mean(dim=(1, 3)), alpha.reshape(cells).mean(dim=(1, 3))
    return _display(colour.reshape(-1, 3), alpha.reshape(-1)).reshape(colour.shape), alpha


def _display(linear: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """`display` of pixels [P, 3] and [P]: the same bytes in whatever company a pixel comes.

    The last values of a tensor that do not fill a vector register go through another power, which rounds otherwise.
    """
    count = len(linear)
    short = -count % _LANES
    if short:
        linear, alpha = torch.nn.functional.pad(linear, (0, 0, 0, short)), torch.nn.functional.pad(alpha, (0, short))
    return display(linear.contiguous(), alpha.contiguous())[:count]


def _by_table(codes: np.ndarray, table: np.ndarray, alpha: torch.Tensor) -> torch.Tensor:
    """`display` of linear values of codes [H, W, 3 or 4]: a power for each code, not for each pixel.

    Pixels that are covered in part are left to `display` itself.
    """
    top = np.iinfo(codes.dtype).max
    values = torch.from_numpy(table)[:, None].expand(-1, 3)
    encoded = display(values, torch.ones(len(table)))[:, 0].contiguous().numpy()
    image = np.take(encoded, codes[..., :3])
    coverage = alpha.numpy()
    own = codes[..., 3] if codes.shape[2] == 4 else np.uint8(top)
    rest = (coverage < 1) | (own < top)
    if rest.any():
        some = rest & (coverage > 0) & (own > 0)
        image[rest] = 0
        linear = np.take(table, codes[some][:, :3])
        if codes.shape[2] == 4:
            linear *= (codes[some][:, 3].astype(np.float32) / np.float32(top))[:, None]
        image[some] = _display(torch.from_numpy(linear), alpha[torch.from_numpy(some)]).numpy()
    return torch.from_numpy(image)


class Visited:
    """`displayed` of views when asked for. The first ones asked for stay, as far as `budget` bytes reach: views come in
    random order, each once a round, so that keeping the last ones would hit less often. Of the others the last two
    stay, and the one that `expect` was told of, which a thread makes meanwhile.
    """

    def __init__(self, views: Views, downscale: int, device: torch.device | str, budget: float) -> None:
        self.views, self.downscale, self.device = views, downscale, torch.device(device)
        self.shape = (len(views), views.height // downscale, views.width // downscale)
        self.room = int(budget // (PIXEL_BYTES * self.shape[1] * self.shape[2]))
        self.held: dict[int, Pair] = {}
        self.recent: OrderedDict[int, Future[Pair]] = OrderedDict()
        self.lock = threading.Lock()
        self.maker = ThreadPoolExecutor(1, initializer=torch.set_num_threads, initargs=(1,))

    def pair(self, view: int) -> Pair:
        view = range(self.shape[0])[view]
        with self.lock:
            if view in self.held:
                return self.held[view]
            future = self._asked(view)
        pair = future.result()
        with self.lock:
            if len(self.held) < self.room:
                self.held[view] = pair
                self.recent.pop(view, None)
        return pair

    def expect(self, view: int) -> None:
        """Begin to make a view that will be asked for soon."""
        with self.lock:
            if view not in self.held:
                self._asked(view)

    def _asked(self, view: int) -> Future[Pair]:
        if view not in self.recent:
            while len(self.recent) >= _AHEAD:
                self.recent.popitem(last=False)
            self.recent[view] = self.maker.submit(displayed, self.views, view, self.downscale, self.device)
        self.recent.move_to_end(view)
        return self.recent[view]


class Plane:
    """Images or coverage of `Visited`, one view at a time: `plane[i]`, or `for picture in plane`."""

    def __init__(self, visited: Visited, part: int) -> None:
        self.visited, self._part = visited, part
        self.shape = visited.shape if part else (*visited.shape, 3)
        self.device = visited.device

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, view: int) -> torch.Tensor:
        return self.visited.pair(view)[self._part]

    def __iter__(self) -> Iterator[torch.Tensor]:
        return (self[view] for view in range(len(self)))
