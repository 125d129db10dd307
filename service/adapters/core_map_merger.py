"""`core.merge` behind the merger port. What it stands on is loaded by the first merge."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from functools import lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np

from revisit.service.adapters.core_map_optimiser import NamedGraph
from revisit.service.domain.states import ChangeKind
from revisit.service.ports.map_merger import (
    AlignedMaps,
    DescribedPlaces,
    Judgement,
    MapChange,
    PlacedSubmapMap,
    SurfaceEvidence,
)
from revisit.service.ports.map_optimiser import MapGraph, Told, TrackLoop

if TYPE_CHECKING:
    from revisit.core.implicit_map import DecoderWeights
    from revisit.core.merge import PlacedMap

REACH_M = 25.0
"""Submaps farther apart are not compared, metres in a scene of the size of a street."""

MOST_COMPARED = 100
"""Pairs of submaps whose surfaces are compared, spread over the whole overlap: 0.1 s of a core each."""

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
        self, graph: MapGraph, second: frozenset[int], spare: Sequence[TrackLoop], scale: float, told: Told
    ) -> AlignedMaps:
        """See `MapMerger`."""
        from revisit.core.merge.joining import JoiningLoops
        from revisit.core.pose_graph import optimise

        named = NamedGraph.of(graph)
        optimised = optimise(named.posed, told=partial(told, "ALIGN"))
        sessions = frozenset(named.names[number] for number in second)
        found = JoiningLoops.of(named.posed, optimised, sessions, scale, named.edges(spare))
        return AlignedMaps(named.answer(optimised), found.loops, found.common_track_m, found.rival_loops)

    def compare(
        self,
        first: Sequence[PlacedSubmapMap],
        second: Sequence[PlacedSubmapMap],
        read: Callable[[str], bytes],
        scale: float,
        told: Told,
    ) -> SurfaceEvidence:
        """See `MapMerger`."""
        from revisit.core.merge import compare_pairs, pairs_in_reach
        from revisit.core.merge.changes import changes_between

        if not first or not second:
            return SurfaceEvidence(0, 0.0, float("inf"), 1.0, 0.0, ())
        places = [np.stack([one.T_map_submap[:3, 3] for one in group]) for group in (first, second)]
        pairs = pairs_in_reach(places[0], places[1], REACH_M * scale, most=MOST_COMPARED)
        load = _loader(read)
        placed = list(_loaded(pairs, first, second, load, told))
        found = compare_pairs(placed)
        changes = changes_between(placed)
        return SurfaceEvidence(
            found.common_points, found.overlap_share, found.residual_m, found.far_share, found.seen_through_share,
            tuple(MapChange(ChangeKind(one.kind.value), one.centre_m, one.extent_m, one.points) for one in changes),
        )  # fmt: skip

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


def _loader(read: Callable[[str], bytes]) -> Callable[[PlacedSubmapMap], PlacedMap]:
    from revisit.core.config import ImplicitMapConfig
    from revisit.core.implicit_map import NeuralMap
    from revisit.core.merge import PlacedMap

    @lru_cache(maxsize=HELD_MAPS)
    def neural_map(sha256: str) -> NeuralMap:
        return NeuralMap.from_blob(read(sha256), _decoder(), ImplicitMapConfig())

    return lambda one: PlacedMap(neural_map(one.sha256), one.T_map_submap)


@lru_cache(maxsize=1)
def _decoder() -> DecoderWeights:
    from revisit.core.model_bundle import load_packaged_models

    return load_packaged_models().decoder


def _loaded(
    pairs: list[tuple[int, int]],
    first: Sequence[PlacedSubmapMap],
    second: Sequence[PlacedSubmapMap],
    load: Callable[[PlacedSubmapMap], PlacedMap],
    told: Told,
) -> Iterator[tuple[PlacedMap, PlacedMap]]:
    for done, (one, other) in enumerate(pairs):
        told("COMPARE_SURFACES", done, len(pairs))
        yield load(first[one]), load(second[other])
