"""Depth of the photographs before any surface is known: multi-view, or from a network, and how the two meet."""
