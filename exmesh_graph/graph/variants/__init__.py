"""Variants of a graph: named patches, matrices of settings, repeats over seeds, and their merge into one graph.

A patch changes the merged file before `repeat` blocks are unrolled, so that `bypass: rounds.merge` acts in every round.
The patched file goes through the same loading, unrolling and checking as any other.
"""

from exmesh_graph.graph.variants.checked import CheckedVariant, check_variant, check_variants, variant_names
from exmesh_graph.graph.variants.declared import MAX_VARIANTS, Row, rows_of
from exmesh_graph.graph.variants.merge import Member, Merged, identities, merge
from exmesh_graph.graph.variants.patches import OPERATIONS, apply_patches

__all__ = [
    "MAX_VARIANTS",
    "OPERATIONS",
    "CheckedVariant",
    "Member",
    "Merged",
    "Row",
    "apply_patches",
    "check_variant",
    "check_variants",
    "identities",
    "merge",
    "rows_of",
    "variant_names",
]
