"""The proposal of a merge: alignment, evidence, verdict, and their report."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from itertools import compress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4, pose_row
from revisit.core.merge.evidence import ChangedThing, MergeEvidence, MergeLimits, MergeRefusal
from revisit.core.pair_verdict import LoopMeasurement, PairVerdict, RejectedLoop, VerifiedLoop
from revisit.service.domain.records import SubmapRecord
from revisit.service.domain.states import MergeVerdict
from revisit.service.features.graph.map_frames import frame_name
from revisit.service.features.merging.reading import MapSide, MergeOrder, MergeTask
from revisit.service.features.optimisation.rows import summary_of
from revisit.service.ports.map_merger import AlignedMaps, PlacedSubmapMap
from revisit.service.ports.map_optimiser import OptimisedTrack, TrackLoop


@dataclass(frozen=True)
class CrossingLoop:
    """A candidate between the two maps, and its verdict: the query is of the map that joins."""

    query: SubmapRecord
    match: SubmapRecord
    similarity: float
    verdict: PairVerdict

    @property
    def measurement(self) -> LoopMeasurement | None:
        """The measurement of a pair that passed, None of one that did not."""
        return self.verdict.measurement if isinstance(self.verdict, VerifiedLoop) else None


@dataclass(frozen=True)
class MergeProposal:
    """The findings: candidates with verdicts, the loops of `graph` among them by number, poses and surfaces.

    `refusal` is the first reason against, by `limits`; None where nothing speaks against it.
    """

    order: MergeOrder
    task: MergeTask
    crossing: tuple[CrossingLoop, ...]
    numbers: dict[int, CrossingLoop]
    aligned: AlignedMaps
    surfaces: MergeEvidence | None
    limits: MergeLimits
    refusal: MergeRefusal | None

    @property
    def verdict(self) -> MergeVerdict:
        """Before anything is committed."""
        return MergeVerdict.REFUSED if self.refusal else MergeVerdict.MERGEABLE

    def report(self) -> dict[str, Any]:
        """As JSON: verdict, alignment, evidence, changes."""
        return {
            "verdict": self.verdict.value,
            "refusal": None if self.refusal is None else self.refusal.value,
            "source": self.order.source,
            "validate_only": self.order.validate_only,
            **self._alignment(),
            "evidence": self._evidence(),
            "limits": asdict(self.limits),
            "would_change": self._would_change(),
            "changes": [_change(one) for one in self.surfaces.changes] if self.surfaces else [],
        }

    def joined(self) -> list[OptimisedTrack]:
        """The sessions of the source that lie in a frame of the map that grows."""
        return [
            track
            for track in self.aligned.optimised.tracks
            if track.session_number in self.task.source.sessions and track.anchor in self.task.target.sessions
        ]

    def _alignment(self) -> dict[str, Any]:
        """T_map_source of the first session that joins: where the frame of the source lies in that of the map."""
        first = next(iter(self.joined()), None)
        T_source_submap = None if first is None else _first_in_source(self.task.source, first)
        if first is None or T_source_submap is None:
            return {"T_map_source": None, "covariance": None, "frame": None}
        covariance = first.covariances[0]
        return {
            "T_map_source": list(pose_row(first.T_map_submap[0] @ se3.inverse(T_source_submap))),
            "covariance": covariance.ravel().tolist() if np.isfinite(covariance).all() else None,
            "frame": frame_name(first.anchor),
        }

    def _evidence(self) -> dict[str, Any]:
        reasons = Counter(one.verdict.reason.value for one in self.crossing if isinstance(one.verdict, RejectedLoop))
        found = {
            "candidates": len(self.crossing),
            "verified": sum(one.measurement is not None for one in self.crossing),
            "rejected": dict(sorted(reasons.items())),
            **asdict(self.aligned.joining),
        }
        if self.surfaces is None:
            return found
        names = (
            "common_points",
            "overlap_share",
            "residual_m",
            "far_share",
            "seen_through_share",
            "worst_stretch_share",
        )
        return _plain({**found, **{name: getattr(self.surfaces, name) for name in names}})

    def _would_change(self) -> dict[str, Any]:
        target, optimised = self.task.target.task, self.aligned.optimised
        of_target = [one for one in optimised.tracks if one.session_number in self.task.target.sessions]
        moved = summary_of(target, of_target, optimised)
        return {
            "sessions": len(self.task.source.sessions),
            "sessions_joined": len(self.joined()),
            "submaps": len(self.task.source.submaps),
            "mean_change_m": moved["mean_change_m"],
            "max_change_m": moved["max_change_m"],
        }


def _first_in_source(source: MapSide, first: OptimisedTrack) -> Matrix4 | None:
    """Where the frame of the source has the first submap of a session; None where it has a frame of its own."""
    numbers = [one.session_number for one in source.submaps]
    T_source_submap = np.asarray(source.T_map_submap[numbers.index(first.session_number)])
    return T_source_submap if np.isfinite(T_source_submap).all() else None


def _change(change: ChangedThing) -> dict[str, Any]:
    return {
        "kind": change.kind.value,
        "centre_m": list(change.centre_m),
        "extent_m": list(change.extent_m),
        "points": change.points,
    }


def _plain(fields: dict[str, Any]) -> dict[str, Any]:
    """As JSON: numbers that are not finite are None."""
    return {name: None if isinstance(one, float) and not np.isfinite(one) else one for name, one in fields.items()}


def placed_maps(side: MapSide, tracks: Iterable[OptimisedTrack], anchors: set[int]) -> list[PlacedSubmapMap]:
    """The neural maps of one of both maps that lie in the frames of `anchors`, in the order of its submaps."""
    poses: dict[int, NDArray[np.float64]] = {}
    numbers = {track.session_number: track.submaps for track in side.task.graph.tracks}
    for track in tracks:
        if track.session_number in numbers and track.anchor in anchors:
            poses.update(zip(numbers[track.session_number], track.T_map_submap, strict=True))
    held = (one for one in side.submaps if one.number in poses and one.neural_map_sha256 is not None)
    return [PlacedSubmapMap(str(one.neural_map_sha256), poses[one.number]) for one in held]


def chosen(crossing: Sequence[CrossingLoop]) -> tuple[list[CrossingLoop], list[CrossingLoop]]:
    """The accepted loops that are the best of both of their submaps, and the other accepted ones.

    Neighbours of a place see it, too, from farther away: their measurements are worse than their covariance says, and
    add nothing to that of the place itself.
    """
    accepted = [one for one in crossing if one.measurement is not None]
    best = dict[int, tuple[float, float]]()
    for one in accepted:
        for number in (one.query.number, one.match.number):
            best[number] = max(best.get(number, _quality(one)), _quality(one))
    is_best = [_quality(one) == best[one.query.number] == best[one.match.number] for one in accepted]
    return list(compress(accepted, is_best)), [one for one, kept in zip(accepted, is_best, strict=True) if not kept]


def _quality(found: CrossingLoop) -> tuple[float, float]:
    """How much of both surfaces a loop rests on, and how near they were taken: the same whichever is the query."""
    measured = found.measurement
    if measured is None:
        return 0.0, 0.0
    return round(float(measured.overlap), 9), -round(float(np.linalg.norm(measured.T_match_query[:3, 3])), 9)


def track_loop(number: int, found: CrossingLoop) -> TrackLoop:
    """A candidate that passed as a loop of the graph. Raises ValueError for another."""
    measured = found.measurement
    if measured is None:
        raise ValueError("a pair that did not pass is no loop of the graph")
    covariance = measured.covariance if np.isfinite(measured.covariance).all() else None
    return TrackLoop(number, found.match.number, found.query.number, measured.T_match_query, covariance)
