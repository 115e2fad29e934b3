"""A context to run nodes in without the framework."""

from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class FakeContext:
    """What a node sees of the framework."""

    scratch: Path = Path()
    node: str = "probe"
    key: str = "0" * 64
    seed: int = 0
    threads: int = 1
    warnings: list[str] = field(default_factory=list)
    steps: list[tuple[int, int]] = field(default_factory=list)

    lines: list[str] = field(default_factory=list)

    figures: dict[str, float] = field(default_factory=dict)

    def progress(self, step, total, **figures):
        self.steps.append((step, total))
        self.figures = figures

    def checkpoint(self, step, state):
        pass

    def resume(self):
        return None

    def log(self, message):
        self.lines.append(message)

    def warn(self, message):
        self.warnings.append(message)
