"""Claims: candidate pairs of submaps with the verdict on each pair, and the doubts that other claims raise.

A pair is judged by itself first (`core.verification`). Then the claims of a drive are judged together: a pair that
passed every check may be doubted, and an ambiguous one may be decided by the claims beside it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from revisit.core.geometry.se3 import Matrix4
from revisit.core.pair_verdict import Hypothesis, LoopMeasurement, PairVerdict, RejectionReason, VerifiedLoop
from revisit.core.radio import RadioFingerprint


class Doubt(StrEnum):
    """Why a pair that passed every check by itself is ambiguous all the same."""

    PAIRWISE_INCONSISTENT = "PAIRWISE_INCONSISTENT"  # other loops between the two drives say another pose
    ODOMETRY_INCONSISTENT = "ODOMETRY_INCONSISTENT"  # the odometry of its own drive says another pose
    PERCEPTUAL_ALIAS = "PERCEPTUAL_ALIAS"  # nearly every other place of the drive looks like it
    BETTER_ALTERNATIVE = "BETTER_ALTERNATIVE"  # another place explains more of the submap
    LOW_CONSISTENT_SHARE = "LOW_CONSISTENT_SHARE"  # most pairs that its pose explains did not pass
    RADIO_DISAGREES = "RADIO_DISAGREES"  # it hears other radio than another spot where the submap passes, too
    SUPPORT_LOST = "SUPPORT_LOST"  # the claims that had decided it are doubted themselves
    AWAITS_CHAIN = "AWAITS_CHAIN"  # places may repeat, and its drive has not gone on for long enough to tell


@dataclass(frozen=True)
class Grounds:
    """Why a doubt was raised: a sentence for people, and the numbers in it."""

    words: str
    figures: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Support:
    """Claims beside an ambiguous one that single out its pose.

    anchors: submaps of the query's drive whose accepted loops agree; agreeing: all loops that do; along_m: metres of
    both drives that they cover; ruled_out: the other poses T_match_query (4, 4) that had fitted as well. No claims
    single it out, but: on_earth, the places on earth of both drives (docs/decisions/0362); tags, fiducials that both
    passed (docs/decisions/0369); own_odometry, that of the one drive of both submaps, over `along_m` of way
    (docs/decisions/0364).
    """

    anchors: int
    agreeing: int
    along_m: float
    ruled_out: tuple[Matrix4, ...]
    on_earth: bool = False
    own_odometry: bool = False
    tags: tuple[str, ...] = ()

    @property
    def is_help(self) -> bool:
        """Whether it counts against doubts: odometry chooses among poses, and is no witness of the place."""
        return not self.own_odometry

    @property
    def by_anchors(self) -> bool:
        """Whether anchors chose the pose: places on earth, or tags."""
        return self.on_earth or bool(self.tags)

    @property
    def _anchors(self) -> str:
        if not self.tags:
            return "anchors beside both submaps"
        return f"tags {', '.join(self.tags)}, seen beside both submaps,"

    @property
    def words(self) -> str:
        """The support as a sentence."""
        if self.by_anchors and not self.ruled_out:
            return f"loops beside it had doubted it; {self._anchors} agree with its pose"
        if self.by_anchors:
            return f"{len(self.ruled_out)} other poses fit as well; {self._anchors} agree with this one alone"
        if self.own_odometry:
            return (
                f"{len(self.ruled_out)} other poses fit as well; odometry since then, over at least "
                f"{self.along_m:.0f} m, agrees with this one alone"
            )
        return (
            f"{len(self.ruled_out)} other poses fit as well; accepted loops of {self.anchors} submaps beside it, "
            f"{self.agreeing} loops over {self.along_m:.0f} m of both drives, agree with this one alone"
        )


@dataclass(frozen=True)
class Distinctiveness:
    """How distinct a place is among the candidates of its query (docs/decisions/0161).

    compared: candidates; passing: those accepted or ambiguous; other_spots: other spots of the matched drive where the
    query would stand by one of their poses.
    """

    compared: int
    passing: int
    other_spots: int


@dataclass(frozen=True)
class Station:
    """A submap on its drive: T_odom_submap (4, 4), metres, and its number on the drive.

    drive: any number that tells drives apart; None for a cloud of no drive, which has no odometry. radio: of the place,
    None where nobody told it.
    """

    drive: int | None
    ordinal: int
    T_odom_submap: Matrix4
    radio: RadioFingerprint | None = None


@dataclass(frozen=True)
class StationInMap:
    """Where a station lies in a map that was optimised: T_map_submap (4, 4) in the frame of that name."""

    frame: str
    T_map_submap: Matrix4


@dataclass(frozen=True)
class LoopClaim:
    """One candidate pair: its two stations, the verdict on the pair alone, and the judgement of the claims beside it.

    by_hand: a person has made it; no rule changes it.
    """

    query: Station
    match: Station
    verdict: PairVerdict
    doubts: Mapping[Doubt, Grounds] = field(default_factory=dict)
    support: Support | None = None
    distinctiveness: Distinctiveness | None = None
    by_hand: bool = False

    @property
    def accepted(self) -> bool:
        """Whether it is a loop: the pair passed, no doubt stands against it without support, and it does not wait."""
        return self._stands and Doubt.AWAITS_CHAIN not in self.doubts

    @property
    def waits(self) -> bool:
        """Whether it is a loop but for its chain, which has not decided yet."""
        return self._stands and Doubt.AWAITS_CHAIN in self.doubts

    @property
    def _stands(self) -> bool:
        contradicted = not self.helped and not self.doubts.keys() <= {Doubt.AWAITS_CHAIN}
        return isinstance(self.verdict, VerifiedLoop) and not contradicted

    @property
    def helped(self) -> bool:
        """Whether others single out its pose, in spite of doubts."""
        return self.support is not None and self.support.is_help

    @property
    def accepted_by_itself(self) -> bool:
        """Whether it is a loop without the help of others."""
        return self.accepted and not self.helped

    @property
    def decided_by_others(self) -> bool:
        """Whether it is a loop for the sake of others."""
        return self.accepted and self.helped

    @property
    def reason(self) -> RejectionReason | None:
        """Why it is no loop; None where it is one."""
        if self.accepted:
            return None
        if self.waits:
            return RejectionReason.AWAITS_CHAIN
        return RejectionReason.AMBIGUOUS if isinstance(self.verdict, VerifiedLoop) else self.verdict.reason

    @property
    def ambiguous(self) -> bool:
        """Whether several poses fit it, or others doubt its own."""
        return self.reason == RejectionReason.AMBIGUOUS

    @property
    def speaks(self) -> bool:
        """Whether its pair passed by itself: then it may contradict others, though it is not believed."""
        return self.accepted_by_itself or (self.ambiguous and not self.doubts.keys().isdisjoint(_OF_A_PASSED_PAIR))

    @property
    def withdrawn(self) -> bool:
        """Whether it was accepted by itself, until others doubted it."""
        return self.ambiguous and not self.doubts.keys().isdisjoint(_WITHDRAWING)

    @property
    def tells(self) -> bool:
        """Whether it is evidence of its drive: a loop, or a pair whose reason tells whether pairs pass at its pose."""
        return self.T_match_query is not None and (self.accepted or self.reason in TELLING)

    @property
    def measurement(self) -> LoopMeasurement | None:
        """The measurement of its pair, None where the geometry was not looked at."""
        return self.verdict.measurement

    @property
    def T_match_query(self) -> Matrix4 | None:
        """Its best pose (4, 4), accepted or not; None where there is none."""
        return None if self.measurement is None else self.measurement.T_match_query

    @property
    def score(self) -> float:
        """The score 0..1 of its pair."""
        return 0.0 if self.measurement is None else float(self.measurement.score)

    @property
    def overlap(self) -> float:
        """The overlap 0..1 of its surfaces."""
        return 0.0 if self.measurement is None else float(self.measurement.overlap)

    @property
    def height_m(self) -> float:
        """The standard deviation of its height, metres; 0 where nobody measured it."""
        if self.measurement is None:
            return 0.0
        up = self.match.T_odom_submap[2, :3]  # in the frame of the match, which the sensor may tilt
        variance = float(np.nan_to_num(up @ self.measurement.covariance[:3, :3] @ up))
        return float(np.sqrt(max(variance, 0.0)))

    @property
    def hypotheses(self) -> tuple[Matrix4, ...]:
        """Its poses T_match_query (4, 4), the best first; none where it says nothing of a pose."""
        if self.measurement is None or not (self.accepted or self.ambiguous or self.waits):
            return ()
        rivals = self.measurement.rivals if self.ambiguous else ()
        return (self.measurement.T_match_query, *(rival.T_match_query for rival in rivals))

    @property
    def of_one_drive(self) -> bool:
        """Whether both submaps are of the same drive."""
        return self.query.drive is not None and self.query.drive == self.match.drive

    def doubted(self, doubt: Doubt, grounds: Grounds, instead: Sequence[Hypothesis] | None = None) -> LoopClaim:
        """The claim with a doubt, and the poses that are said `instead`, if the doubt names any."""
        doubts = {**self.doubts, doubt: grounds}
        if instead is None or self.measurement is None:
            return replace(self, doubts=doubts)
        measured = replace(self.measurement, rivals=tuple(instead))
        return replace(self, doubts=doubts, verdict=replace(self.verdict, measurement=measured))

    def without(self, *doubts: Doubt) -> LoopClaim:
        """The claim without some doubts."""
        return replace(self, doubts={one: grounds for one, grounds in self.doubts.items() if one not in doubts})


TELLING = RejectionReason.AMBIGUOUS, RejectionReason.LOW_SCORE, RejectionReason.AWAITS_CHAIN
"""Reasons of pairs that are no loops, or not yet, which tell whether pairs pass at a pose: with accepted ones, the
evidence of a drive."""

_OF_A_PASSED_PAIR = frozenset(
    {
        Doubt.PAIRWISE_INCONSISTENT,
        Doubt.PERCEPTUAL_ALIAS,
        Doubt.BETTER_ALTERNATIVE,
        Doubt.LOW_CONSISTENT_SHARE,
    }
)
"""Doubts that leave a claim its say. Odometry that refutes a claim takes it away."""

_WITHDRAWING = frozenset({Doubt.PAIRWISE_INCONSISTENT, Doubt.LOW_CONSISTENT_SHARE})


def by_matched_drive(claims: Sequence[LoopClaim], counts: Callable[[LoopClaim], bool]) -> list[list[int]]:
    """The rows of the claims that count, by the drive that was matched."""
    rows: dict[int | None, list[int]] = defaultdict(list)
    for row, claim in enumerate(claims):
        if counts(claim):
            rows[claim.match.drive].append(row)
    return list(rows.values())


def says_a_pose(claim: LoopClaim) -> bool:
    """Whether a claim says anything of a pose."""
    return bool(claim.hypotheses)
