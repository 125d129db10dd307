"""A merger whose surfaces are made up: the loops are judged as they are, for fleets without clouds."""

from __future__ import annotations

from revisit.service.adapters.core_map_merger import CoreMapMerger
from revisit.service.domain.states import ChangeKind
from revisit.service.ports.map_merger import Judgement, MapChange, SurfaceAudit, SurfaceEvidence

CAR = MapChange(ChangeKind.VANISHED, (12.0, 3.0, 0.8), (4.2, 1.8, 1.5), 120)


class FakeMerger(CoreMapMerger):
    """`MapMerger` that finds every overlap right; a car is gone."""

    def compare(self, first, second, read, scale, progress) -> SurfaceEvidence:
        """Nothing is read."""
        progress("COMPARE_SURFACES", 0, 1)
        return SurfaceEvidence(5_000, 0.8, 0.02, 0.01, 0.001, (CAR,))

    def audit(self, first, second, read, scale, most, progress) -> SurfaceAudit:
        """Nothing is read."""
        return SurfaceAudit(self.compare((), (), read, scale, progress), None)


class EasyMerger(FakeMerger):
    """One that two loops are enough for, however short the way."""

    def judge(self, aligned, surfaces, scale) -> Judgement:
        """Nothing but the loops."""
        return Judgement(None if aligned.loops >= 2 else "TOO_FEW_LOOPS", {"loops": 2.0})
