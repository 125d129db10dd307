"""Acceptance: candidate pairs become loops by judging the claims of a drive together (beyond the paper).

claim               a candidate pair: verdict of its pair, doubts, support
revisits            which submaps of a drive may be loops
prediction          accepted pairs predict the pose of further candidates
radio               RADIO_DISAGREES
alternatives        PERCEPTUAL_ALIAS, BETTER_ALTERNATIVE
consistent_share    LOW_CONSISTENT_SHARE
consistency         PAIRWISE_INCONSISTENT, ODOMETRY_INCONSISTENT
map_recall          pairs tested again from the poses of a map
support             ambiguous claims decided by those beside them, SUPPORT_LOST
chain               AWAITS_CHAIN
distinctiveness     other spots where a submap would pass
rules               all of them, in order
"""

from revisit.core.acceptance.chain import is_decided_by_way, without_waiting
from revisit.core.acceptance.claim import (
    TELLING,
    Distinctiveness,
    Doubt,
    Grounds,
    LoopClaim,
    Station,
    StationInMap,
    Support,
)
from revisit.core.acceptance.map_recall import MOST_MOVED_M, accept_chosen, accept_near
from revisit.core.acceptance.prediction import PredictedPoses, verify_in_turn
from revisit.core.acceptance.rules import (
    Decided,
    Drive,
    accept,
    accept_cloud,
    accept_named,
    best_loop,
    stride_of_drive,
    submaps_asked,
)
from revisit.core.acceptance.support import VerifyNear, unsupported

__all__ = [
    "MOST_MOVED_M", "TELLING", "Decided", "Distinctiveness", "Doubt", "Drive", "Grounds", "LoopClaim", "PredictedPoses",
    "Station", "StationInMap", "Support", "VerifyNear", "accept", "accept_chosen", "accept_cloud", "accept_named",
    "accept_near", "best_loop", "is_decided_by_way", "stride_of_drive", "submaps_asked", "unsupported",
    "verify_in_turn", "without_waiting",
]  # fmt: skip
