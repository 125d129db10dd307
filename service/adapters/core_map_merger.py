"""`core.merge` behind the merger port. Its libraries are loaded by the first merge."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from revisit.core.errors import DataLoss
from revisit.core.geometry.se3 import Matrix4
from revisit.core.merge.evidence import MergeEvidence, MergeLimits
from revisit.service.adapters.core_map_optimiser import NamedGraph
from revisit.service.ports.map_merger import AlignedMaps, DescribedPlaces, PlacedSubmapMap, Surfaces
from revisit.service.ports.map_optimiser import MapGraph, Progress, TrackLoop

if TYPE_CHECKING:
    from revisit.core.implicit_map import NeuralMap
    from revisit.core.merge.fused import PlacedMap

REACH_M = 25.0
"""Submaps farther apart are not compared, metres in a scene of the size of a street."""

MOST_COMPARED = 100
"""Pairs of submaps for the comparison of surfaces, spread over the whole overlap: 0.1 s of a core each."""

HELD_MAPS = 32
"""Neural maps that are kept decoded, 1 MB each: neighbours are compared one after another."""


class CoreMapMerger:
    """`MapMerger` by `core.merge` and `core.pose_graph`."""

    limits = MergeLimits()

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
        from revisit.core.merge.joining import joining_loops
        from revisit.core.pose_graph.optimisation import optimise

        named = NamedGraph.of(graph)
        optimised = optimise(named.posed, progress=partial(progress, "ALIGN"), anchors=named.fixed)
        sessions = frozenset(named.names[number] for number in second)
        joining = joining_loops(named.posed, optimised, sessions, scale, named.edges(spare))
        return AlignedMaps(named.answer(optimised), joining)

    def compare(
        self,
        first: Sequence[PlacedSubmapMap],
        second: Sequence[PlacedSubmapMap],
        read: Callable[[str], bytes],
        scale: float,
        progress: Progress,
    ) -> MergeEvidence:
        """See `MapMerger`."""
        from revisit.core.merge.history import changes_between
        from revisit.core.merge.overlap import compare_pairs, pairs_in_reach

        if not first or not second:
            return compare_pairs(())
        poses = [np.stack([one.T_map_submap for one in group]) for group in (first, second)]
        pairs = pairs_in_reach(poses[0][:, :3, 3], poses[1][:, :3, 3], REACH_M * scale, most=MOST_COMPARED)
        load = _loader(read)
        placed = []
        for done, (one, other) in enumerate(pairs):
            progress("COMPARE_SURFACES", done, len(pairs))
            ends = first[one], second[other]
            placed.append((load(ends[0].sha256, ends[0].T_map_submap), load(ends[1].sha256, ends[1].T_map_submap)))
        return replace(compare_pairs(placed), changes=tuple(changes_between(placed)))

    def surfaces(self, read: Callable[[int], bytes]) -> Surfaces:
        """See `MapMerger`."""
        return _loader(read)

    def audit(
        self,
        first: Mapping[int, Matrix4],
        second: Mapping[int, Matrix4],
        surfaces: Surfaces,
        scale: float,
        most: int,
        progress: Progress,
    ) -> MergeEvidence | None:
        """See `MapMerger`."""
        from revisit.core.merge.overlap import compare_pairs, pairs_in_reach

        poses = [np.stack(list(group.values())) for group in (first, second)]
        rows = pairs_in_reach(poses[0][:, :3, 3], poses[1][:, :3, 3], REACH_M * scale, most=most)
        numbers = list(first), list(second)
        placed = []
        for done, (one, other) in enumerate(rows):
            progress("COMPARE_SURFACES", done, len(rows))
            with suppress(DataLoss):
                ends = (surfaces(numbers[0][one], poses[0][one]), surfaces(numbers[1][other], poses[1][other]))
                placed.append(ends)
        return None if rows and not placed else compare_pairs(placed)


Key = TypeVar("Key", str, int)


def _loader(read: Callable[[Key], bytes]) -> Callable[[Key, Matrix4], PlacedMap]:
    """What places a neural map; those of the last HELD_MAPS keys stay decoded."""
    from revisit.core.merge.fused import PlacedMap
    from revisit.service.adapters.core_neural_maps import decoded

    @lru_cache(maxsize=HELD_MAPS)
    def neural_map(key: Key) -> NeuralMap:
        return decoded(read(key))

    return lambda key, T_map_submap: PlacedMap(neural_map(key), T_map_submap)
