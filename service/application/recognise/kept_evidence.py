"""The evidence that is kept of a pair: all of it where a rule or a map may read it again (docs/decisions/0314)."""

from __future__ import annotations

from typing import Any

from revisit.service.application.contract.recogniser import LoopVerdict
from revisit.service.application.recognise.loops_beside import TELLING

BRIEF = (
    "inliers", "overlap", "contrast", "seen_through", "rmse_m", "common_share", "enough_share", "covariance",
)  # fmt: skip
"""What people and clients are told of a pair that geometry rejected. Its pose, score and similarity are members of the
loop itself; the covariance counts where a person accepts it all the same."""


def kept_evidence(verdict: LoopVerdict) -> dict[str, Any]:
    """The evidence of a verdict; of a rejected pair that decides about no other, what people are told of it."""
    measured = verdict.evidence.get("measurement")
    if verdict.accepted or verdict.reason in TELLING or not measured:
        return verdict.evidence
    brief = {name: measured[name] for name in BRIEF if name in measured}
    return {**verdict.evidence, "measurement": brief}
