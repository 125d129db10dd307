"""`core.merge` behind the merger port. Its libraries are loaded by the first merge."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import lru_cache, partial
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from revisit.core.errors import DataLoss
from revisit.core.geometry.se3 import Matrix4
from revisit.service.adapters.core_map_optimiser import NamedGraph
from revisit.service.domain.states import ChangeKind
from revisit.service.ports.map_merger import (
    AlignedMaps,
    DescribedPlaces,
    Judgement,
    MapChange,
    PlacedSubmapMap,
    SurfaceAudit,
    SurfaceEvidence,
)
from revisit.service.ports.map_optimiser import MapGraph, Progress, TrackLoop

if TYPE_CHECKING:
    from revisit.core.implicit_map import DecoderWeights
    from revisit.core.merge import MergeEvidence, PlacedMap

REACH_M = 25.0
"""Submaps farther apart are not compared, metres in a scene of the size of a street."""

MOST_COMPARED = 100
"""Pairs of submaps for the comparison of surfaces, spread over the whole overlap: 0.1 s of a core each."""

HELD_MAPS = 64
"""Neural maps that are kept decoded: neighbours are compared one after another."""


class CoreMapMerger:
    """`MapMerger` by `core.merge` and `core.pose_graph`."""

    def candidates(self, first: DescribedPlaces, second: DescribedPlaces, k: int) -> list[tuple[int, int, float]]:
        """See `MapMerger`."""
        from revisit.core.merge.candidates import joining_candidates

        names = sorted({*first.storeys, *second.storeys} - {None}, key=str)
        numbered = {None: -1, **{name: number for number, name in enumerate(names)}}
        storeys = tuple(np.array([numbered[its] for its in one.storeys], np.int64) for one in (first, second))
        sessions = (first.sessions, second.sessions)
        found = joining_candidates(first.descriptors, second.descriptors, sessions, k, (storeys[0], storeys[1]))
        rows = zip(found.pairs.tolist(), found.similarities.tolist(), strict=True)
        return [(one, other, cosine) for (one, other), cosine in rows]

    def align(
        self, graph: MapGraph, second: frozenset[int], spare: Sequence[TrackLoop], scale: float, progress: Progress
    ) -> AlignedMaps:
        """See `MapMerger`."""
        from revisit.core.merge.joining import JoiningLoops
        from revisit.core.pose_graph import optimise

        named = NamedGraph.of(graph)
        optimised = optimise(named.posed, progress=partial(progress, "ALIGN"))
        sessions = frozenset(named.names[number] for number in second)
        found = JoiningLoops.of(named.posed, optimised, sessions, scale, named.edges(spare))
        return AlignedMaps(named.answer(optimised), found.loops, found.common_track_m, found.rival_loops)

    def compare(
        self,
        first: Sequence[PlacedSubmapMap],
        second: Sequence[PlacedSubmapMap],
        read: Callable[[str], bytes],
        scale: float,
        progress: Progress,
    ) -> SurfaceEvidence:
        """See `MapMerger`."""
        from revisit.core.merge import compare_pairs, pairs_in_reach
        from revisit.core.merge.changes import changes_between

        if not first or not second:
            return SurfaceEvidence(0, 0.0, float("inf"), 1.0, 0.0, ())
        poses = [np.stack([one.T_map_submap for one in group]) for group in (first, second)]
        pairs = pairs_in_reach(poses[0][:, :3, 3], poses[1][:, :3, 3], REACH_M * scale, most=MOST_COMPARED)
        load = _loader(read)
        placed = []
        for done, (one, other) in enumerate(pairs):
            progress("COMPARE_SURFACES", done, len(pairs))
            ends = first[one], second[other]
            placed.append((load(ends[0].sha256, ends[0].T_map_submap), load(ends[1].sha256, ends[1].T_map_submap)))
        changes = changes_between(placed)
        return _evidence(
            compare_pairs(placed),
            tuple(MapChange(ChangeKind(one.kind.value), one.centre_m, one.extent_m, one.points) for one in changes),
        )

    def audit(
        self,
        first: Mapping[int, Matrix4],
        second: Mapping[int, Matrix4],
        read: Callable[[int], bytes],
        scale: float,
        most: int,
        progress: Progress,
    ) -> SurfaceAudit | None:
        """See `MapMerger`."""
        from revisit.core.merge import MergeLimits, compare_pairs, pairs_in_reach, surfaces_refusal

        poses = [np.stack(list(group.values())) for group in (first, second)]
        rows = pairs_in_reach(poses[0][:, :3, 3], poses[1][:, :3, 3], REACH_M * scale, most=most)
        numbers = list(first), list(second)
        load = _loader(read)
        placed = []
        for done, (one, other) in enumerate(rows):
            progress("COMPARE_SURFACES", done, len(rows))
            with suppress(DataLoss):
                ends = (load(numbers[0][one], poses[0][one]), load(numbers[1][other], poses[1][other]))
                placed.append(ends)
        if rows and not placed:
            return None
        found = compare_pairs(placed)
        reason = surfaces_refusal(found, MergeLimits().scaled(scale))
        return SurfaceAudit(_evidence(found), None if reason is None else reason.value)

    def judge(self, aligned: AlignedMaps, surfaces: SurfaceEvidence | None, scale: float) -> Judgement:
        """See `MapMerger`."""
        from revisit.core.merge import MergeEvidence, MergeLimits, loops_refusal, refusal

        limits = MergeLimits().scaled(scale)
        of_loops = aligned.loops, aligned.common_track_m, aligned.rival_loops
        if surfaces is None:
            reason = loops_refusal(*of_loops, limits)
        else:
            seen = MergeEvidence(
                surfaces.common_points, surfaces.residual_m, surfaces.far_share, surfaces.seen_through_share,
                surfaces.overlap_share,
            )  # fmt: skip
            reason = refusal(seen, *of_loops, limits)
        return Judgement(None if reason is None else reason.value, asdict(limits))


def _evidence(found: MergeEvidence, changes: tuple[MapChange, ...] = ()) -> SurfaceEvidence:
    return SurfaceEvidence(
        found.common_points, found.overlap_share, found.residual_m, found.far_share, found.seen_through_share, changes
    )


Key = TypeVar("Key", str, int)


def _loader(read: Callable[[Key], bytes]) -> Callable[[Key, Matrix4], PlacedMap]:
    """What places a neural map; those of the last HELD_MAPS keys stay decoded."""
    from revisit.core.config import ImplicitMapConfig
    from revisit.core.implicit_map import NeuralMap
    from revisit.core.merge import PlacedMap

    @lru_cache(maxsize=HELD_MAPS)
    def neural_map(key: Key) -> NeuralMap:
        return NeuralMap.from_blob(read(key), _decoder(), ImplicitMapConfig())

    return lambda key, T_map_submap: PlacedMap(neural_map(key), T_map_submap)


@lru_cache(maxsize=1)
def _decoder() -> DecoderWeights:
    from revisit.core.model_bundle import load_packaged_models

    return load_packaged_models().decoder
