"""Surfaces that decide on joins and faults are those of submaps that have a neural map still."""

from __future__ import annotations

import numpy as np

from revisit.service.features.graph.join_audit import _Audit


class NotingMerger:
    """`MapMerger`: notes the submaps of both groups that it is asked to compare."""

    def __init__(self) -> None:
        self.asked: list[tuple[set[int], set[int]]] = []

    def audit(self, first, second, surfaces, scale, most, progress):
        """Nothing is known."""
        self.asked.append((set(first), set(second)))


def test_submaps_without_a_neural_map_are_not_compared():
    merger, pose = NotingMerger(), np.eye(4)
    audit = _Audit(1.0, merger, task=None, surfaces=None, released=frozenset({2, 4}), progress=None)
    assert audit._by_surfaces({1: pose, 2: pose}, {3: pose, 4: pose}, 5) is None
    assert audit._by_surfaces({2: pose}, {3: pose}, 5) is None
    assert merger.asked == [({1}, {3})]
