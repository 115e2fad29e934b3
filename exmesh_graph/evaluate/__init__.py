"""Metrics, scoring and the protocols of published benchmarks."""
