"""BoW3D (Cui et al., RA-L 2022): the words of the nearest key points vote for earlier scans; matched edges decide.

Re-implemented from the paper, with the numbers of its authors' published programme for KITTI. A place is one scan.
Chosen here: a pose is looked for with each of the `candidates` scans with most votes, and the score is how many matched
edges agree on it; the authors take the first pose with more than 100 (of 64 lines) less than 3 m away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lab.baselines.link3d import SECTORS, Link3d, LinkFeatures
from lab.baselines.scan_lines import Floats, Integers
from lab.baselines.stable_triangles import rigid_fits
from revisit.core.geometry import se3

NAME = "bow3d"
_NOWHERE_M = 1e6


@dataclass(frozen=True)
class Words:
    """The words of scans: word (w,), ascending; the scan (w,) and the key point (w,), counted through, that has it."""

    word: Integers
    scan: Integers
    point: Integers

    def of(self, scans: NDArray[np.bool_]) -> Words:
        """Those of the scans that are flagged (s,)."""
        kept = scans[self.scan]
        return Words(self.word[kept], self.scan[kept], self.point[kept])

    @property
    def places_a_word(self) -> float:
        """In how many key points a word stands, on average."""
        return len(self.word) / (1 + np.count_nonzero(np.diff(self.word)))


@dataclass(frozen=True)
class Bow3d:
    """Words are of the `nearest` key points of a scan; one that stands in more than `frequent` times as many places as
    the mean word says nothing.

    A pose is the best of `poses` of three matched edges, as `judges` of the edges tell, with those within `inlier_m` of
    it; it is none where the two scans would lie more than `reach_m` apart.
    """

    link: Link3d = Link3d()
    nearest: int = 5
    frequent: float = 3.5
    candidates: int = 40
    poses: int = 300
    judges: int = 150
    inlier_m: float = 0.4
    reach_m: float = 20.0

    def words(self, scans: Sequence[LinkFeatures]) -> Words:
        """The words of scans, in the order in which they are given."""
        parts = [words_of(one, self.nearest) for one in scans]
        word = np.concatenate([np.zeros((0, SECTORS), dtype=np.int64), *parts])
        scan = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
        point, sector = np.nonzero(word)
        order = np.argsort(word[point, sector], kind="stable")
        return Words(word[point, sector][order], scan[point][order], point[order])

    def votes(self, query: LinkFeatures, known: Words) -> dict[int, int]:
        """For each scan that shares words with the query: how many one key point shares with one of the query's."""
        result: dict[int, int] = {}
        for asked in words_of(query, self.nearest):
            start = np.searchsorted(known.word, asked)
            size = np.searchsorted(known.word, asked, side="right") - start
            useful = (asked > 0) & (size > 0) & (size <= self.frequent * known.places_a_word)
            rows = np.concatenate(
                [np.arange(at, at + many) for at, many in zip(start[useful], size[useful], strict=True)] or [start[:0]]
            )
            _, first, shared = np.unique(known.point[rows], return_index=True, return_counts=True)
            for scan, count in zip(known.scan[rows[first]].tolist(), shared.tolist(), strict=True):
                result[scan] = max(result.get(scan, 0), count)
        return result

    def agreeing(self, query: LinkFeatures, place: LinkFeatures) -> tuple[int, se3.Matrix4]:
        """How many matched edges agree on T_place_query, and that pose; 0 and the identity where there is none."""
        asked, found = self._matched_edges(query, place)
        if len(asked) < 3:
            return 0, np.eye(4)
        turns, shifts = self._tried(asked, found)
        some = np.unique(np.linspace(0, len(asked) - 1, self.judges).astype(np.int64))
        # single precision is enough to tell 0.4 m, and halves the time
        away = turns.astype(np.float32) @ asked[some].T.astype(np.float32)
        away += (shifts[:, :, None] - found[some].T).astype(np.float32)
        likely = int(((away**2).sum(axis=1) < self.inlier_m**2).sum(axis=1).argmax())
        near = self._near(asked, found, turns[likely], shifts[likely])
        if near.sum() < 3:
            return 0, np.eye(4)
        turn, shift = rigid_fits(asked[near][None], found[near][None])
        return int(near.sum()), se3.from_rotation_translation(turn[0], shift[0])

    def _tried(self, asked: Floats, found: Floats) -> tuple[Floats, Floats]:
        """Rotations (h, 3, 3) and translations (h, 3) of three edges drawn at random; far away where it is too far."""
        drawn = np.random.default_rng(0).integers(0, len(asked), (self.poses, 3))
        turns, shifts = rigid_fits(asked[drawn], found[drawn])
        too_far = np.linalg.norm(shifts, axis=1) > self.reach_m
        return turns, np.where(too_far[:, None], _NOWHERE_M, shifts)

    def _near(self, asked: Floats, found: Floats, turn: Floats, shift: Floats) -> NDArray[np.bool_]:
        """Which edges (p,) agree with a pose."""
        return np.asarray(((asked @ turn.T + shift - found) ** 2).sum(axis=1) < self.inlier_m**2)

    def _matched_edges(self, query: LinkFeatures, place: LinkFeatures) -> tuple[Floats, Floats]:
        """Edges (p, 3) of matched key points in the same line."""
        pairs = self.link.matches(query.descriptors, place.descriptors)
        partner = np.full(len(query.points), -1)
        partner[pairs[:, 0]] = pairs[:, 1]
        wanted = np.where(partner < 0, -1, partner << 16)[query.edges.cluster]
        wanted = np.where(wanted < 0, -1, wanted | query.edges.line)
        stored = (place.edges.cluster << 16) | place.edges.line
        _, own, other = np.intersect1d(wanted, stored, return_indices=True)
        return query.edges.points[own], place.edges.points[other]


def words_of(features: LinkFeatures, nearest: int) -> Integers:
    """The words of the key points nearest to the sensor (k, 180): distance and sector as one number, 0 for none."""
    distances = features.descriptors[:nearest].astype(np.int64)
    return np.where(distances > 0, distances * SECTORS + np.arange(SECTORS), 0)
