"""The service and the evaluation of a recording give one verdict on the same drive."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from revisit.core.config import PipelineConfig
from revisit.core.geometry.se3 import pose_matrix
from revisit.evaluation.described_submaps import DescribedSubmap
from revisit.evaluation.drive_acceptance import judge_drive
from revisit.evaluation.ground_truth import GroundTruth
from revisit.evaluation.loop_closure_method import Description
from revisit.evaluation.matching import search_map
from revisit.service.ports.blobs import PLACE_BLOB
from tests.integration.test_loops_beside import EqualBlocks, RowOfHouses
from tests.support.fake_recogniser import FakeRecogniser
from tests.support.service_world import SESSION, TENANT, memory_world, open_session, policy, submap

STATIONS = (*range(0, 61, 10), *range(60, -1, -10))
"""There and back: houses are passed twice."""


@dataclass(frozen=True)
class AsMethod:
    """A recogniser as the evaluation asks a method."""

    recogniser: FakeRecogniser
    config: PipelineConfig = field(default_factory=lambda: policy().pipeline)

    def verify_pair(self, query, match, similarity, initial=None):
        return self.recogniser.verify(query, match, similarity, self.config, initial)


async def driven(recogniser):
    """A drive through a service: its submaps, their places, and its loops by the ordinals of their submaps."""
    world = memory_world()
    await open_session(world)
    for number, station in enumerate(STATIONS):
        await world.use_cases.posting.post(TENANT, submap(f"s{number}", station, SESSION))
        world.work_off(recogniser)
    submaps = world.context.transactions.read(lambda uow: uow.submaps.find(TENANT)).result()
    loops = world.context.transactions.read(lambda uow: uow.loops.find(TENANT)).result()
    ordinal = {one.number: one.ordinal for one in submaps}
    places = [world.context.blobs.get(TENANT, PLACE_BLOB, one.place_sha256) for one in submaps]
    return submaps, places, {(ordinal[one.query_number], ordinal[one.match_number]): one for one in loops}


def described(submaps, places) -> list[DescribedSubmap]:
    return [
        DescribedSubmap(
            one.ordinal, (one.ordinal,), np.array(one.position_m), pose_matrix(one.T_odom_submap), 0.0,
            Description(np.frombuffer(one.descriptor, dtype="<f4"), place), None, 300,
        )
        for one, place in zip(submaps, places, strict=True)
    ]  # fmt: skip


@pytest.mark.parametrize(
    "recogniser", [RowOfHouses(30.0), RowOfHouses(1e9), EqualBlocks()], ids=["end", "row", "blocks"]
)
async def test_evaluation_judges_a_drive_as_the_service_does(recogniser):
    submaps, blobs, loops = await driven(recogniser)
    method, places = AsMethod(recogniser), described(submaps, blobs)
    positions = np.array([one.position_m for one in submaps])
    allowed = GroundTruth.of_one_drive(positions, method.config.loop, 20.0).allowed
    candidates = search_map(places, places, method.config.loop.candidates, allowed, own_map=True)
    drive = judge_drive(places, method, candidates, 1, lambda _: None)
    judged = {(n, one.match.id): one.claim for n, row in enumerate(drive.candidates) for one in row}
    assert judged.keys() == loops.keys() and loops
    for pair, claim in judged.items():
        row = loops[pair]
        assert (claim.accepted, claim.reason) == (row.state == "ACCEPTED", row.reason), pair
        assert sorted(claim.doubts) == sorted(row.evidence.get("doubts", {})), pair
        assert (claim.support is not None) == ("support" in row.evidence), pair
        if row.T_match_query is not None:
            np.testing.assert_allclose(claim.T_match_query, pose_matrix(row.T_match_query), atol=1e-12)
