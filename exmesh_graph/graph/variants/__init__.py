"""Variants of a graph: named patches, matrices of settings, repeats over seeds, and their merge into one graph.

A patch changes the merged file before `repeat` blocks are unrolled, so that `bypass: rounds.merge` acts in every round.
The patched file goes through the same loading, unrolling and checking as any other.
"""
