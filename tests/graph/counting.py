"""A graph with one long node, for tests that stop and resume it."""


def count(more: str = "", name: str = "n", steps: int = 60) -> str:
    """The node `name` counts to `steps`; `more` is what else it is told."""
    return f'nodes: {{a: {{type: toy.const}}, {name}: {{type: toy.count, number: "@a.number", steps: {steps}{more}}}}}'
