"""No NaN or Inf reaches a parameter, and a fit that runs away is brought back.

Every step's terms and gradients are looked at before the optimiser moves. What the guard does about a bad one depends
on whether it stays bad at the last good state: then the view is to blame and is left out from there on; otherwise the
fit goes back to that state with half the rates. A fit also goes back when its image term, averaged over a pass of the
views, is half as large again as its best and a quarter above the start's. After a few returns it gives up on what is
not finite; a fit that ends far above its best ends with its last good state.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import torch

from exmesh_graph.errors import NumericsError
from exmesh_graph.optim import Adam
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.gbuffer import ViewBuffer

Terms = dict[str, torch.Tensor]

#: Returns to a good state before the fit is given up; each halves the rates.
RETURNS = 5
#: A gradient beyond this would overflow Adam's second moment.
LARGEST_GRADIENT = 1e18
#: The image term over its best that tells a fit which runs away.
FAR = 1.5
#: Views that tell how large the image term is before the first step.
STARTING_VIEWS = 12
#: Terms that no view has a part in.
GLOBAL_TERMS = ("environment", "chroma")


class Guard:
    """Watches a fit of `model` by `optimiser`; `evaluate(buffer, step)` computes a view's terms again.

    scale  what the learning rates are to be multiplied with
    """

    def __init__(
        self,
        model: Decomposition,
        optimiser: Adam,
        evaluate: Callable[[ViewBuffer, int], Terms],
        warn: Callable[[str], None] | None = None,
    ) -> None:
        self.model, self.optimiser, self.evaluate, self.warn = model, optimiser, evaluate, warn
        self.scale = 1.0
        self.returns = 0
        self.messages: list[str] = []
        self.window = max(len(model.buffers), 20)
        self.total, self.count = 0.0, 0
        self.first = self.best = self.last = math.inf
        self.good: Mapping[str, Any] = {}

    def start(self) -> None:
        """Before the first step: report broken photographs, take the first good state."""
        for number, reason in self.model.buffers.faults.items():
            self._say(f"view {self.model.buffers.views.names[number]} is left out: {reason}")
        self._need_views()
        self.good = self._snapshot()
        usable = [k for k in range(len(self.model.buffers)) if self.model.buffers.pixels[k]]
        chosen = usable[:: -(-len(usable) // STARTING_VIEWS)]
        with torch.no_grad():
            terms = [float(self.evaluate(self.model.buffers[k], 0)["image"]) for k in chosen]
        known = [term for term in terms if math.isfinite(term)]
        self.first = self.best = self.last = sum(known) / len(known) if known else math.inf

    def passes(self, terms: Terms, buffer: ViewBuffer, step: int) -> bool:
        """Whether the step may be taken: its terms and (after backward) its gradients are finite.

        Where they are not, the guard has dealt with it and the gradients are gone.
        Raises NumericsError when nothing it can do helps.
        """
        if _finite(torch.stack(list(terms.values())).sum()) and self._gradients_finite():
            self._watch(float(terms["image"].detach()), step)
            return True
        where = f"step {step}, view {buffer.name}"
        name, what = self._culprit(terms, buffer, step)
        self._clear()
        now = self._snapshot()
        if name not in GLOBAL_TERMS:
            self._restore(self.good)
            stays_bad = self._bad_terms(buffer, step)
            if stays_bad:
                self._restore(now)
                self.model.buffers.leave_out(buffer.number, f"{what} of its {stays_bad[0]} term")
                self._say(f"{where}: {what} of the {name} term, also at the last good state: the view is left out")
                self._need_views()
                return False
        self._return(f"{where}: {what} of the {name} term")
        return False

    def finish(self) -> None:
        """After the last step: a fit far above its best goes back to its last good state."""
        if math.isfinite(self.best) and self.last > FAR * self.best:
            self._restore(self.good)
            ends = f"the image term ends at {self.last:.4g}, at its best it was {self.best:.4g}"
            self._say(f"{ends}: the last good state is kept")

    def renew(self) -> None:
        """Compare with what comes from here on: the fit was moved away from its best on purpose."""
        self.total, self.count, self.best = 0.0, 0, math.inf
        self.good = self._snapshot()

    def state(self) -> dict[str, Any]:
        """All that the guard knows, for a checkpoint."""
        plain = {name: getattr(self, name) for name in PLAIN}
        return {**plain, "faults": dict(self.model.buffers.faults), "good": self.good}

    def restore(self, kept: Mapping[str, Any]) -> None:
        """Go on from `state`; its messages are said again."""
        for name in PLAIN:
            setattr(self, name, kept[name])
        self.good = kept["good"]
        for number, reason in kept["faults"].items():
            self.model.buffers.leave_out(number, reason)
        for message in self.messages if self.warn else ():
            self.warn(message)  # type: ignore[misc]

    def _watch(self, image: float, step: int) -> None:
        """Compare the image term, averaged over about one pass, with its best; keep the state when it is near."""
        self.total, self.count = self.total + image, self.count + 1
        if self.count < self.window:
            return
        mean, self.total, self.count = self.total / self.count, 0.0, 0
        self.last = mean
        if mean > max(FAR * self.best, 1.25 * self.first) and self.returns < RETURNS:
            self._return(f"step {step}: the image term rose to {mean:.4g} on average, from {self.best:.4g} at its best")
            return
        if mean <= 1.25 * self.best:
            self.good = self._snapshot()
        self.best = min(self.best, mean)

    def _return(self, cause: str) -> None:
        self.returns += 1
        self.scale *= 0.5
        if self.returns > RETURNS:
            raise NumericsError(
                f"the fit does not stay finite after {RETURNS} returns to its last good state",
                where=f"stage2 {cause}",
                expected="finite terms and gradients",
                fix="lower material_rate and environment_rate; check images, masks and cameras",
            )
        self._restore(self.good)
        self._clear()
        self.total, self.count = 0.0, 0
        self.last = self.best
        self._say(f"{cause}: back to the last good state, rates times {self.scale:g}")

    def _culprit(self, terms: Terms, buffer: ViewBuffer, step: int) -> tuple[str, str]:
        """(term, what is wrong with it)."""
        for name, value in terms.items():
            if not _finite(value):
                return name, f"the value {float(value.detach())}"
        names = self._bad_terms(buffer, step)
        return (names[0] if names else "summed", "a gradient that is not finite")

    def _bad_terms(self, buffer: ViewBuffer, step: int) -> list[str]:
        """Terms of a view whose value or gradient is not finite at the present state."""
        self._clear()
        bad = []
        terms = self.evaluate(buffer, step)
        for name, value in terms.items():
            if value.requires_grad:
                value.backward(retain_graph=True)
            if not (_finite(value) and self._gradients_finite()):
                bad.append(name)
            self._clear()
        return bad

    def _gradients_finite(self) -> bool:
        """The gradient of large maps is not read again where the pass that wrote it has told its largest value."""
        (*known, largest), self.model.maps.extreme = self.model.maps.extreme or (0, 0, 0.0), None
        gradients = [p.grad for p in self.optimiser.parameters if p.grad is not None and p.grad.numel()]
        extremes = [x for g in gradients for x in ([largest] if [g.data_ptr(), g._version] == known else g.aminmax())]
        return all(abs(float(extreme)) < LARGEST_GRADIENT for extreme in extremes)

    def _clear(self) -> None:
        for parameter in self.optimiser.parameters:
            parameter.grad = None

    def _snapshot(self) -> Mapping[str, Any]:
        # what a light model measured and the gains are replaced, never changed in place: they need not be copied
        return {"optimiser": _copied(self.optimiser.state()), **self.model.state()}

    def _restore(self, kept: Mapping[str, Any]) -> None:
        self.optimiser.restore(kept["optimiser"])
        self.model.restore(kept)

    def _need_views(self) -> None:
        buffers = self.model.buffers
        if len(buffers.faults) == len(buffers):
            number, reason = next(iter(buffers.faults.items()))
            raise NumericsError(
                f"no view can be used: {reason}",
                where=f"stage2, view {buffers.views.names[number]} (and all others)",
                expected="finite images and a finite loss",
                fix="check the views' images for NaN or Inf",
            )

    def _say(self, message: str) -> None:
        self.messages.append(message)
        if self.warn:
            self.warn(message)


PLAIN = ("scale", "returns", "messages", "total", "count", "first", "best", "last")


def _finite(value: torch.Tensor) -> bool:
    return bool(torch.isfinite(value))


def _copied(value: Any) -> Any:
    if isinstance(value, torch.Tensor):
        return value.detach().clone()
    if isinstance(value, Mapping):
        return {key: _copied(item) for key, item in value.items()}
    return [_copied(item) for item in value] if isinstance(value, list) else value
