"""The stability suite: numerical hazards, each with an expected and a reached figure.

    python -m benchmarks.stability                     # the whole table; exits with 1 on any miss
    python -m benchmarks.stability --quick             # rows of about a second or less, as the tests run them
    python -m benchmarks.stability --only antialias --json table.json

Rows live in the modules `rows_*.py` of this package (see `table.row`); the tests call the same functions.
"""
