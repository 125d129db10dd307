"""Comparison of two described submaps by their stored places."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.verification import RejectedLoop, VerifiedLoop
from revisit.service.features.index.comparison import Comparison
from revisit.service.features.index.place_memory import RecalledPlace
from revisit.service.ports.blobs import PLACE_BLOB
from tests.support.fake_recogniser import FakeRecogniser
from tests.support.memory.blobs import MemoryBlobStore
from tests.support.records import TENANT, a_submap
from tests.support.service_world import policy

PLACE = np.float32([1, 0]).tobytes()


@pytest.mark.parametrize(("query_lost", "match_lost"), [(False, False), (True, False), (False, True)])
def test_a_pair_of_submaps_of_which_a_place_is_lost_has_a_verdict_that_tells_why(query_lost, match_lost):
    blobs = MemoryBlobStore()
    kept = blobs.put(TENANT, PLACE_BLOB, PLACE)
    query, match = (
        a_submap(name, place_sha256="0" * 64 if lost else kept) for name, lost in (("a", query_lost), ("b", match_lost))
    )
    comparison, config = Comparison(blobs, FakeRecogniser()), policy().pipeline
    verdict = comparison.verify(query, RecalledPlace(match, 0.9), config)
    if not (query_lost or match_lost):
        assert isinstance(verdict, VerifiedLoop)
        return
    assert isinstance(verdict, RejectedLoop)
    assert verdict.reason == "PLACE_LOST" and "missing" in str(verdict.message)
