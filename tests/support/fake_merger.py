"""A merger whose surfaces are made up: the loops are judged as they are, for fleets without clouds."""

from __future__ import annotations

from revisit.core.merge.evidence import ChangedThing, ChangeKind, MergeEvidence, MergeLimits
from revisit.service.adapters.core_map_merger import CoreMapMerger

CAR = ChangedThing(ChangeKind.VANISHED, (12.0, 3.0, 0.8), (4.2, 1.8, 1.5), 120)


class FakeMerger(CoreMapMerger):
    """`MapMerger` that finds every overlap right; a car is gone."""

    def compare(self, first, second, read, scale, progress) -> MergeEvidence:
        """Nothing is read."""
        progress("COMPARE_SURFACES", 0, 1)
        return MergeEvidence(5_000, 0.02, 0.01, 0.001, 0.8, (CAR,))

    def audit(self, first, second, surfaces, scale, most, progress) -> MergeEvidence:
        """Nothing is read."""
        return self.compare((), (), surfaces, scale, progress)


class EasyMerger(FakeMerger):
    """One that two loops are enough for, however short the way."""

    limits = MergeLimits(loops=2, common_track_m=0.0, rival_share=1e9)
