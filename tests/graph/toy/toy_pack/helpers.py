"""A helper module of the toy pack."""


def sign_of(value: float) -> float:
    """1 for values from 0 on, else -1."""
    return 1.0 if value >= 0 else -1.0
