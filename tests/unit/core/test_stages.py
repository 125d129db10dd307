"""Stage times are measured for a caller that asks for them, and candidates follow one policy."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.candidates import CandidatePolicy
from revisit.core.config import PipelineConfig
from revisit.core.index import ExactIndex, IndexEntry
from revisit.core.model_bundle import load_packaged_models
from revisit.core.pipeline import describe, recall
from revisit.core.stages import stage, stage_times


@stage("first")
def first(number: int) -> int:
    return number + 1


@stage("second")
def failing() -> None:
    raise ValueError


def test_a_stage_is_timed_only_inside_the_block_that_asks():
    assert first(1) == 2
    with stage_times() as times:
        assert first(first(1)) == 3
        with pytest.raises(ValueError):
            failing()
    assert list(times) == ["first"] and times["first"] > 0
    first(1)
    assert list(times) == ["first"]


def test_blocks_inside_one_another_do_not_mix():
    with stage_times() as outer:
        with stage_times() as inner:
            first(1)
        assert (list(inner), list(outer)) == (["first"], [])
        first(1)
    assert list(outer) == ["first"]


def test_describing_a_place_names_every_stage_of_the_method(make_drive, shapes):
    submap = make_drive(lambda _: [shapes["ground"](), shapes["box"]((10, -6, 0), (12, 6, 5))], scans=2)
    with stage_times() as times:
        describe(submap, load_packaged_models(), PipelineConfig())
    names = ["implicit_map", "surface", "clusters", "bev", "micro", "spectra", "fusion", "place"]
    assert list(times) == names


def test_candidates_are_the_most_similar_places_but_the_neighbours_in_the_same_session():
    index = ExactIndex(2)
    entries = [IndexEntry(id=i, session=i // 10, ordinal=i % 10, position=np.zeros(3)) for i in range(20)]
    angles = np.linspace(0.0, 0.5, 20)
    index.add(entries, np.stack([np.cos(angles), np.sin(angles)], axis=1).astype(np.float32))
    policy = CandidatePolicy(session=0, too_near=frozenset({2, 3, 4, 5, 6}), count=6)
    found = [match.id for match in recall(np.array([1, 0], np.float32), index, policy)]
    assert found == [0, 1, 7, 8, 9, 10]
