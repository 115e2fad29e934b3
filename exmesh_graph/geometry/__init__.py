"""Mesh connectivity, topology operations (paper sections 4.1-4.2), initial surfaces and their clean-up. Numpy only."""
