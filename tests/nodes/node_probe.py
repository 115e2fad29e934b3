"""A context to run nodes in without the framework."""

from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class FakeContext:
    """What a node sees of the framework."""

    scratch: Path
    node: str = "probe"
    seed: int = 0
    warnings: list[str] = field(default_factory=list)
    steps: list[tuple[int, int]] = field(default_factory=list)

    def progress(self, step, total, **_figures):
        self.steps.append((step, total))

    def log(self, message):
        pass

    def warn(self, message):
        self.warnings.append(message)
