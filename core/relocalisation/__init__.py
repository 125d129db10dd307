"""Relocalisation as a conversation: views along a way narrow down where in a map a robot is (beyond the paper).

view_window     the last scans, joined by odometry
answer          one pose, several, or none and why
hypotheses      poses that may be true, and what one view says of them
conversation    weighs them, view by view, and decides
telling_apart   the drive after which their views would differ
looking         one view, compared with the places of a map
"""

from revisit.core.relocalisation.answer import (
    PossiblePose,
    RelocalisationAnswer,
    RelocalisationState,
    TellsApart,
    UnknownReason,
)
from revisit.core.relocalisation.conversation import ConversationState, Relocalisation, View
from revisit.core.relocalisation.hypotheses import Hypothesis

__all__ = [
    "ConversationState", "Hypothesis", "PossiblePose", "Relocalisation", "RelocalisationAnswer", "RelocalisationState",
    "TellsApart", "UnknownReason", "View",
]  # fmt: skip
