"""Merging: neural maps of submaps that are placed to each other become one, and whether two of them may be at all.

candidates  which submaps of two maps may show the same place
joining     whether the loops between two groups of sessions allow joining them
overlap     agreement of the surfaces of two placed groups, and the verdict on joining them
changes     things that vanished or appeared between two days
fused       one neural map out of several
"""

from revisit.core.merge.fused import PlacedMap, merge_neural_maps
from revisit.core.merge.overlap import (
    MergeEvidence,
    MergeLimits,
    MergeRefusal,
    compare_pairs,
    compare_surfaces,
    loops_refusal,
    pairs_in_reach,
    refusal,
    surfaces_refusal,
)

__all__ = [
    "MergeEvidence", "MergeLimits", "MergeRefusal", "PlacedMap", "compare_pairs", "compare_surfaces", "loops_refusal",
    "merge_neural_maps", "pairs_in_reach", "refusal", "surfaces_refusal",
]  # fmt: skip
