"""Support for loops that are AMBIGUOUS by geometry alone, from the loops beside them (docs/decisions/0161).

When a submap has been compared with the map, its loops and those of the submaps before it on the same drive are looked
at together: an ambiguous one that they single out a hypothesis of is registered again from there, and accepted.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from revisit.core.config import PipelineConfig, VerificationConfig
from revisit.core.drive_loops import DriveLoop, DriveLoops, DriveSubmap
from revisit.core.evident_share import REACH_M
from revisit.core.geometry.se3 import Matrix4, pose_matrix
from revisit.core.neighbour_support import NeighbourSupport, find_support
from revisit.service.application.contract.events import AMBIGUOUS
from revisit.service.application.contract.recogniser import LoopVerdict
from revisit.service.application.contract.records import LoopRecord, SubmapRecord
from revisit.service.application.contract.states import GraphState, LoopState
from revisit.service.application.contract.transactions import UnitOfWork
from revisit.service.application.mapping.graph_reading import measured_covariance

SUPPORT = "support"
"""The member of a loop's evidence that says which loops beside it have decided."""

CONTRADICTED = "contradicted"
"""The member of the evidence of a loop that passed every check, but not the comparison with the loops beside it."""

REFUTED = "refuted"
"""The member of the evidence of a loop that passed every check, but not the odometry of its own drive."""

LOOK_ALIKES = "look_alikes"
"""The member of the evidence of a loop that passed every check, but stands out from no other place."""

OUTDONE = "outdone"
"""The member of the evidence of a loop that passed every check, but explains less of its submap than another place."""

OUTNUMBERED = "outnumbered"
"""The member of the evidence of a loop that passed every check, but most pairs that its pose explains did not."""

SUPPORT_LOST = "support_lost"
"""The member of the evidence of a loop that others had decided, until these were contradicted themselves."""

LOW_SCORE = "LOW_SCORE"
"""The reason of a pair that was aligned, and for which too little speaks there."""

TELLING = AMBIGUOUS, LOW_SCORE
"""Reasons of rejected loops that say of a pose whether pairs pass at it."""

Registered = Callable[[SubmapRecord, SubmapRecord, float, Matrix4], LoopVerdict]
"""Verify a pair of submaps of some similarity around a T_match_query."""


@dataclass(frozen=True)
class Beside:
    """A loop of a drive, judged just now or stored (`record`), with what it says of how its two drives lie."""

    query: SubmapRecord
    match: SubmapRecord
    similarity: float
    verdict: LoopVerdict
    record: LoopRecord | None = None

    @property
    def key(self) -> tuple[int, int, int]:
        """What tells it from others: the numbers of its submaps, and its own where it is stored."""
        return self.query.number, self.match.number, 0 if self.record is None else self.record.number

    @property
    def by_hand(self) -> bool:
        """Whether a person has made it."""
        return self.record is not None and self.record.manual

    @property
    def ambiguous(self) -> bool:
        """Whether several poses fit it."""
        return not self.verdict.accepted and self.verdict.reason == AMBIGUOUS

    @property
    def accepted_by_itself(self) -> bool:
        """Whether it was accepted, and not for the sake of other loops."""
        return self.verdict.accepted and SUPPORT not in self.verdict.evidence

    @property
    def decided_by_others(self) -> bool:
        """Whether it was accepted for the sake of other loops."""
        return self.verdict.accepted and SUPPORT in self.verdict.evidence

    @property
    def speaks(self) -> bool:
        """Whether its pair passed every check by itself: then it may contradict others, though it is not believed."""
        doubted = CONTRADICTED, LOOK_ALIKES, OUTDONE, OUTNUMBERED
        return self.accepted_by_itself or (self.ambiguous and any(name in self.verdict.evidence for name in doubted))

    @property
    def hypotheses(self) -> tuple[Matrix4, ...]:
        """Its poses T_match_query, the best first; none where it says nothing."""
        if self.verdict.T_match_query is None or not (self.verdict.accepted or self.ambiguous):
            return ()
        rivals = self.verdict.evidence.get("measurement", {}).get("rivals", ()) if self.ambiguous else ()
        return (self.verdict.T_match_query, *(np.array(one["T_match_query"], dtype=np.float64) for one in rivals))


@dataclass(frozen=True)
class DriveBefore:
    """What is stored of a drive before a submap of it.

    loops: those that say anything of how drives lie, and those whose pose had too low a score; stride_m: how far apart
    its submaps were begun. A client that posts submaps begins them where it likes.
    """

    loops: list[Beside]
    stride_m: float


def drive_before(uow: UnitOfWork, submap: SubmapRecord, config: PipelineConfig) -> DriveBefore:
    """The drive of `submap` before it, as far as loops beside one are asked."""
    most = math.ceil(REACH_M / config.submap.stride)
    earlier = uow.submaps.before(submap.tenant, submap.session_number, submap.ordinal, most)
    before = {one.number: one for one in earlier}
    apart = [math.dist(one.position_m, submap.position_m) / (submap.ordinal - one.ordinal) for one in before.values()]
    loops = [loop for loop in uow.loops.telling(submap.tenant, sorted(before), TELLING) if _says(loop)]
    matches = uow.submaps.numbered(submap.tenant, sorted({loop.match_number for loop in loops})[-1000:])
    beside = [
        Beside(before[loop.query_number], matches[loop.match_number], loop.similarity, _verdict(loop), loop)
        for loop in loops
        if loop.match_number in matches
    ]
    return DriveBefore(beside, max([config.submap.stride, *apart]))


def contradicted(loops: Sequence[Beside], config: VerificationConfig, stride_m: float) -> list[Beside]:
    """Those of the accepted `loops` that odometry or others contradict, with their verdict then: AMBIGUOUS.

    The poses that are said instead are their rivals. `stride_m`: how far apart neighbouring submaps of a drive
    were begun.
    """
    changed = []
    for drives in _by_drives(loops):
        speaking = [loop for loop in drives if loop.speaks]
        between = _between_drives(speaking, config, stride_m)
        refuted = between.refuted
        for row in np.flatnonzero(refuted | between.contradicted()).tolist():
            loop, others = speaking[row], [*speaking[:row], *speaking[row + 1 :]]
            if loop.accepted_by_itself and not loop.by_hand:
                verdict = _contradicted(loop, between.other_poses(row), others, by_odometry=bool(refuted[row]))
                changed.append(replace(loop, verdict=verdict))
    return changed


def _contradicted(
    loop: Beside, rivals: Sequence[Matrix4], others: Sequence[Beside], *, by_odometry: bool
) -> LoopVerdict:
    """The verdict of a loop of which odometry of its own drive, or the `others`, say the `rivals`."""
    overlaps = [other.verdict.evidence.get("measurement", {}).get("overlap", 0.0) for other in others]
    overlap = max(overlaps, default=0.0)
    measured = dict(loop.verdict.evidence.get("measurement", {}))
    measured["rivals"] = [{"overlap": overlap, "T_match_query": pose.tolist()} for pose in rivals]
    if by_odometry:
        off_m = float(np.linalg.norm(rivals[0][:3, 3] - loop.hypotheses[0][:3, 3]))
        told = {REFUTED: {"words": f"it passed every check, but is {off_m:.0f} m off by the odometry of its own drive"}}
    else:
        words = f"it passed every check, but so do loops beside it that say otherwise: {len(rivals)} other poses"
        told = {CONTRADICTED: {"words": words}}
    evidence = {**loop.verdict.evidence, "measurement": measured, **told}
    return replace(loop.verdict, accepted=False, reason=AMBIGUOUS, evidence=evidence)


def unsupported(loops: Sequence[Beside], config: VerificationConfig, stride_m: float) -> list[Beside]:
    """Those of the `loops` accepted for the sake of others that have lost these, with their verdict: AMBIGUOUS.

    One that agrees must have been contradicted since, and those that are left must not support the pose any more.
    """
    lost = []
    for drives in _by_drives(loops):
        if not any(_is_withdrawn(loop) for loop in drives):
            continue
        between = _between_drives(drives, config, stride_m)
        gone = [_is_withdrawn(loop) for loop in drives]
        for row, loop in enumerate(drives):
            if not loop.decided_by_others or loop.by_hand or not between.agrees_with_any(row, gone):
                continue
            poses = (loop.hypotheses[0], *_ruled_out(loop))
            support = find_support(poses, between.neighbours(row), config)
            if support is None or support.hypothesis != 0:
                lost.append(replace(loop, verdict=_without_support(loop)))
    return lost


def _is_withdrawn(loop: Beside) -> bool:
    """Whether a loop that was accepted by itself is so no more."""
    return loop.ambiguous and any(name in loop.verdict.evidence for name in (CONTRADICTED, OUTNUMBERED))


def _ruled_out(loop: Beside) -> list[Matrix4]:
    """The poses T_match_query that its support had ruled out."""
    poses = loop.verdict.evidence[SUPPORT].get("ruled_out", ())
    return [np.array(pose, dtype=np.float64) for pose in poses]


def _without_support(loop: Beside) -> LoopVerdict:
    """The verdict of a loop that has lost its support: what was ruled out are its rivals again."""
    measured = dict(loop.verdict.evidence.get("measurement", {}))
    overlap = measured.get("overlap", 0.0)
    measured["rivals"] = [{"overlap": overlap, "T_match_query": pose.tolist()} for pose in _ruled_out(loop)]
    words = "loops beside it had decided it, and were contradicted since"
    kept = {name: value for name, value in loop.verdict.evidence.items() if name != SUPPORT}
    evidence = {**kept, "measurement": measured, SUPPORT_LOST: {"words": words}}
    return replace(loop.verdict, accepted=False, reason=AMBIGUOUS, evidence=evidence)


def supported(
    loops: Sequence[Beside], config: VerificationConfig, stride_m: float, register: Registered
) -> list[Beside]:
    """Those of the ambiguous `loops` that the others decide, with the verdict that they have then.

    `stride_m`: how far apart neighbouring submaps of a drive were begun.
    """
    decided = []
    for drives in _by_drives(loops):
        between = _between_drives(drives, config, stride_m)
        for row, loop in enumerate(drives):
            if not (loop.ambiguous and between.has_accepted_neighbour(row)):
                continue
            support = find_support(loop.hypotheses, between.neighbours(row), config)
            verdict = None if support is None else _registered(loop, support, config, register)
            if verdict is not None:
                decided.append(replace(loop, verdict=verdict))
    return decided


def _by_drives(loops: Iterable[Beside]) -> list[list[Beside]]:
    """The loops that say anything, by the drive that was matched."""
    return by_drives(loop for loop in loops if loop.hypotheses)


def by_drives(loops: Iterable[Beside]) -> list[list[Beside]]:
    """The loops by the drive that was matched."""
    groups: dict[int, list[Beside]] = defaultdict(list)
    for loop in loops:
        groups[loop.match.session_number].append(loop)
    return list(groups.values())


def _between_drives(loops: Sequence[Beside], config: VerificationConfig, stride_m: float) -> DriveLoops:
    """Loops between the same two drives, for what they say of each other."""
    told = [
        DriveLoop(
            on_drive(loop.query),
            on_drive(loop.match),
            loop.hypotheses,
            loop.accepted_by_itself,
            one_drive=loop.query.session_number == loop.match.session_number,
            height_m=_height_m(loop.verdict),
        )
        for loop in loops
    ]
    return DriveLoops(told, stride_m, config)


def _height_m(verdict: LoopVerdict) -> float:
    """The standard deviation of the height that a verdict tells; 0 where it tells none."""
    covariance = measured_covariance(verdict.evidence)
    return 0.0 if covariance is None else float(np.sqrt(max(covariance[2, 2], 0.0)))


def on_drive(submap: SubmapRecord) -> DriveSubmap:
    """Where a submap lies on its drive."""
    return DriveSubmap(pose_matrix(submap.T_odom_submap), submap.ordinal)


def _registered(
    loop: Beside, support: NeighbourSupport, config: VerificationConfig, register: Registered
) -> LoopVerdict | None:
    """The verdict around the hypothesis that has support; None where it is not accepted, or moved away from there."""
    hypothesis = loop.hypotheses[support.hypothesis]
    verdict = register(loop.query, loop.match, loop.similarity, hypothesis)
    if not verdict.accepted or verdict.T_match_query is None:
        return None
    moved_m = float(np.linalg.norm(verdict.T_match_query[:3, 3] - hypothesis[:3, 3]))
    if moved_m > 0.5 * config.rival_distance:
        return None
    others = [pose.tolist() for row, pose in enumerate(loop.hypotheses) if row != support.hypothesis]
    return replace(verdict, evidence={**verdict.evidence, SUPPORT: _told(support, others)})


def _told(support: NeighbourSupport, others: list[Any]) -> dict[str, Any]:
    """Support as JSON, with a sentence for people."""
    words = (
        f"{len(others)} other poses fit as well; accepted loops of {support.anchors} submaps beside it, "
        f"{support.agreeing} loops over {support.along_m:.0f} m of both drives, agree with this one alone"
    )
    return {
        "anchors": support.anchors, "agreeing": support.agreeing, "along_m": round(support.along_m, 3),
        "ruled_out": others, "words": words,
    }  # fmt: skip


def revised_evidence(stored: dict[str, Any], told: dict[str, Any]) -> dict[str, Any]:
    """The evidence of a stored loop with a new verdict; of what loops beside it say it has what the new one says."""
    asked_anew = SUPPORT, SUPPORT_LOST, OUTNUMBERED
    return {**{name: value for name, value in stored.items() if name not in asked_anew}, **told}


def _says(loop: LoopRecord) -> bool:
    """Whether a stored loop says anything of a pose: accepted and no outlier, ambiguous, or of a low score there."""
    if loop.state == LoopState.ACCEPTED:
        return loop.graph_state != GraphState.SET_ASIDE
    return loop.state == LoopState.REJECTED and loop.reason in TELLING


def _verdict(loop: LoopRecord) -> LoopVerdict:
    T_match_query = None if loop.T_match_query is None else np.array(pose_matrix(loop.T_match_query))
    return LoopVerdict(loop.state == LoopState.ACCEPTED, loop.reason, loop.score, T_match_query, loop.evidence)
