"""The table of what each part is worth judges drives as the search of a recording does."""

from __future__ import annotations

import numpy as np
import pytest

from lab.part_tables import FORMS, DescribedDrive, formed, judged
from revisit.core.config import PipelineConfig
from revisit.core.descriptor.fusion import without_parts
from revisit.evaluation.described_submaps import DescribedSubmap
from revisit.evaluation.ground_truth import GroundTruth
from revisit.evaluation.loop_closure_method import Description
from revisit.evaluation.matching import search_map
from revisit.evaluation.metrics import LoopProtocol

LOOPS = LoopProtocol(min_index_gap=3)


def there_and_back(seed: int) -> DescribedDrive:
    """Twelve places 30 m apart, out and back; what is seen of each is noisy by `seed`."""
    looks = np.random.default_rng(1).normal(size=(12, 64))
    at = 30.0 * np.array([*range(12), *reversed(range(12))])
    seen = np.concatenate([looks, looks[::-1]]) + np.random.default_rng(seed).normal(0, 0.9, (24, 64))
    vectors = (seen / np.linalg.norm(seen, axis=1, keepdims=True)).astype(np.float32)
    return DescribedDrive(vectors, np.column_stack([at, np.zeros(24), np.zeros(24)]))


def submaps(described: DescribedDrive) -> list[DescribedSubmap]:
    return [
        DescribedSubmap(n, (n,), position, np.eye(4), 0.0, Description(vector, b"", 0, {}), None, 10)
        for n, (vector, position) in enumerate(zip(described.vectors, described.positions, strict=True))
    ]


@pytest.mark.parametrize("own_map", [True, False])
@pytest.mark.parametrize("seen_otherwise", [True, False])
def test_drives_are_judged_as_the_search_of_a_recording_finds_their_submaps(own_map, seen_otherwise):
    mapped = there_and_back(2)
    queries = there_and_back(3) if seen_otherwise else mapped
    known = submaps(mapped)
    asking = submaps(queries) if seen_otherwise else known
    truth = (
        GroundTruth.within_session(queries.positions, LOOPS)
        if own_map
        else GroundTruth.between_sessions(queries.positions, mapped.positions, LOOPS.positive_radius_m)
    )
    found = search_map(asking, known, 1, truth.allowed, own_map=own_map)
    outcomes = judged(queries, mapped, LOOPS, own_map=own_map)
    assert outcomes.score.tolist() == pytest.approx([one[0].similarity if one else -np.inf for one in found], abs=1e-6)
    assert outcomes.correct.tolist() == [bool(one and truth.positives[n, one[0].id]) for n, one in enumerate(found)]
    assert outcomes.has_loop.tolist() == truth.positives.any(axis=1).tolist()
    assert outcomes.correct.sum() > 0


def test_queries_that_are_not_the_submaps_of_their_map_are_refused():
    whole = there_and_back(2)
    fewer = DescribedDrive(whole.vectors[1:], whole.positions[1:])
    with pytest.raises(ValueError, match="23 queries are not the 24 submaps"):
        judged(fewer, whole, LOOPS, own_map=True)


def test_only_parts_of_a_descriptor_are_taken_out_of_it():
    fusion = PipelineConfig().fusion
    size = fusion.macro_size + fusion.micro_size + fusion.spectrum_size + fusion.layout_size + fusion.plan_size
    vectors = np.random.default_rng(4).normal(size=(3, size)).astype(np.float32)
    described = DescribedDrive(vectors, np.zeros((3, 3)))
    whole, no_map, no_normals, no_bev = (formed(described, form, fusion).vectors for form in FORMS)
    assert whole is vectors and no_map is vectors
    assert np.array_equal(no_normals[1], without_parts(vectors[1], fusion, normals=True))
    assert np.array_equal(no_bev[2], without_parts(vectors[2], fusion, bev=True))
