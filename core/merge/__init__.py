"""Merging: neural maps of submaps that are placed to each other become one, and whether two of them may be at all.

fused      one neural map out of several
overlap    what the surfaces of two placed groups say of each other, and the verdict on joining them
"""

from revisit.core.merge.fused import PlacedMap, merge_neural_maps
from revisit.core.merge.overlap import MergeEvidence, MergeLimits, MergeRefusal, compare_surfaces, refusal

__all__ = [
    "MergeEvidence", "MergeLimits", "MergeRefusal", "PlacedMap", "compare_surfaces", "merge_neural_maps", "refusal",
]  # fmt: skip
