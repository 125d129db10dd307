"""Both profiles are scored alike: a place found is found, by the cosine as it is and standardised."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lab.domains.catalogue import DOMAINS
from lab.profile_tables import Drives, _masked, judged, plain_candidates
from revisit.core.profiles import Profile, profile_config
from revisit.evaluation.described_submaps import DescribedSubmap
from revisit.evaluation.loop_closure_method import Description
from revisit.evaluation.metrics import LoopProtocol

DOMAIN = replace(DOMAINS[0], loops=LoopProtocol(min_index_gap=3))


def drive(vectors: np.ndarray) -> Drives:
    """Submaps 30 m apart out, and the same ones back."""
    count = len(vectors)
    at = np.column_stack(
        [30.0 * np.array([*range(count), *reversed(range(count))]), np.zeros(2 * count), np.zeros(2 * count)]
    )
    seen = np.concatenate([vectors, vectors[::-1]])
    submaps = [
        DescribedSubmap(n, (n,), at[n], np.eye(4), 0.0, Description(seen[n], b"", 500, {"fusion": 0.1}), None, 10)
        for n in range(2 * count)
    ]
    return Drives(submaps, submaps)


def places(count: int, size: int) -> np.ndarray:
    vectors = np.random.default_rng(1).normal(size=(count, size)).astype(np.float32)
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_places_that_look_as_they_did_are_all_found_and_others_are_not() -> None:
    found = judged(drive(places(12, 64)), DOMAIN, standardised=False)
    assert found.recognition.auc.value > 0.99
    assert found.recall_at_1 == 1.0
    turned = drive(places(12, 64))
    last = turned.queries[-1].description
    assert last is not None
    wrong = turned.changed(lambda vector: places(12, 64)[5] if vector is last.vector else vector)
    assert judged(wrong, DOMAIN, standardised=True).recall_at_1 < 1.0


def test_the_cosine_as_it_is_ranks_allowed_submaps_alone() -> None:
    drives = drive(places(5, 16))
    allowed = np.zeros((10, 10), dtype=bool)
    allowed[9, [1, 4]] = True
    found = plain_candidates(drives, allowed)
    assert [match.id for match in found[9]] in ([1, 4], [4, 1]) and found[0] == ()


def test_a_part_that_is_left_out_is_zero_and_the_rest_is_a_unit_vector() -> None:
    fusion = profile_config(Profile.PAPER).fusion
    size = fusion.macro_size + fusion.micro_size + fusion.spectrum_size + fusion.layout_size + fusion.plan_size
    vector = places(1, size)[0]
    no_normals, no_bev = _masked(fusion, normals=True)(vector), _masked(fusion, bev=True)(vector)
    assert not no_normals[fusion.macro_size : -2].any() and not no_bev[: fusion.macro_size].any()
    assert np.linalg.norm(no_normals) == np.float32(1.0) or abs(np.linalg.norm(no_bev) - 1.0) < 1e-5
