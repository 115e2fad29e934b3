"""The protocols of published benchmarks: their metrics, and a scene's row of the paper's table."""
