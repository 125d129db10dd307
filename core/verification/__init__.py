"""Verification of a loop candidate: correspondences, start, registration, evidence, verdict (paper III-E, end)."""

from revisit.core.pair_verdict import (
    Authority,
    Hypothesis,
    InitialPose,
    LoopMeasurement,
    PairVerdict,
    RejectedLoop,
    RejectionReason,
    VerifiedLoop,
)
from revisit.core.verification.verdict import is_degenerate, loop_score, verify

__all__ = [
    "Authority", "Hypothesis", "InitialPose", "LoopMeasurement", "PairVerdict", "RejectedLoop", "RejectionReason",
    "VerifiedLoop", "is_degenerate", "loop_score", "verify",
]  # fmt: skip
