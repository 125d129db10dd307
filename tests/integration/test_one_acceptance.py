"""A drive has one set of loops: the service, the evaluation of a recording and the benchmark give the same verdicts.

A cloud of no drive has one, too: the service and a map file (`test_localise_offline`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from lab.recognition.comparison import VERIFIED, ComparedSubmap, Comparison, QueriesAndMap, compare
from lab.recognition.remembered_verdicts import remembered
from revisit.core.config import PipelineConfig
from revisit.core.geometry.se3 import pose_matrix
from revisit.evaluation.described_submaps import DescribedSubmap
from revisit.evaluation.drive_acceptance import AskedPlaces, JudgedDrive, judge_drive
from revisit.evaluation.ground_truth import GroundTruth
from revisit.evaluation.loop_closure_method import Description, verdict_of_pair
from revisit.evaluation.matching import search_map
from revisit.evaluation.metrics import LoopProtocol
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

    def describe(self, submap, seed):
        raise AssertionError("the service has described it")

    def verify(self, query, match, similarity):
        return verdict_of_pair(self.verify_pair(query, match, similarity))

    def verify_pair(self, query, match, similarity, initial=None):
        return self.recogniser.verify(query, match, similarity, self.config, initial)


async def driven(recogniser):
    """A drive through a service: its submaps, their places, and its loops by the ordinals of their submaps."""
    world = memory_world()
    await open_session(world)
    for number, station in enumerate(STATIONS):
        await world.use_cases.posting.post(TENANT, submap(f"s{number}", station, SESSION))
        world.work_off(recogniser)
    await world.use_cases.sessions.finish(TENANT, SESSION)
    world.work_off(recogniser)
    submaps = world.context.transactions.read(lambda uow: uow.submaps.find(TENANT)).result()
    loops = world.context.transactions.read(lambda uow: uow.loops.find(TENANT)).result()
    ordinal = {one.number: one.ordinal for one in submaps}
    places = [world.context.blobs.get(TENANT, PLACE_BLOB, one.place_sha256) for one in submaps]
    return described(submaps, places), {(ordinal[one.query_number], ordinal[one.match_number]): one for one in loops}


def described(submaps, places) -> list[DescribedSubmap]:
    return [
        DescribedSubmap(
            one.ordinal, (one.ordinal,), np.array(one.position_m), pose_matrix(one.T_odom_submap), 0.0,
            Description(np.frombuffer(one.descriptor, dtype="<f4"), place), None, 300, seconds={"describe": 0.0},
        )
        for one, place in zip(submaps, places, strict=True)
    ]  # fmt: skip


def judged_by_evaluation(places, method) -> JudgedDrive:
    positions = np.array([one.position for one in places])
    allowed = GroundTruth.of_one_drive(positions, method.config.loop, 20.0).allowed
    candidates = search_map(places, places, method.config.loop.candidates, allowed, own_map=True)
    return judge_drive(AskedPlaces(places, places), method, candidates, 1, lambda _: None)


def loops_by_evaluation(places, method):
    drive = judged_by_evaluation(places, method)
    return {(n, one.match.id) for n, row in enumerate(drive.candidates) for one in row if one.claim.accepted}


def loops_by_benchmark(places, method, protocol=LoopProtocol(), candidates=5):
    """As `python -m lab.recognition` counts them, whose protocol and number of candidates are those of the paper."""
    submaps = [ComparedSubmap(one, (), ()) for one in places]
    comparison = Comparison(method, method.config.submap, protocol, (), candidates)
    experiment = compare("online", comparison, QueriesAndMap("drive", "drive", submaps, submaps), lambda *_: None)
    return set(experiment.result(VERIFIED).loops.pairs)


def loops_by_remembering_benchmark(places, method):
    """With verdicts remembered, as where peers are verified."""
    return loops_by_benchmark(places, remembered(method))


RECOGNISERS = pytest.mark.parametrize(
    "recogniser", [RowOfHouses(30.0), RowOfHouses(1e9), EqualBlocks()], ids=["end", "row", "blocks"]
)


@RECOGNISERS
@pytest.mark.parametrize("loops_of", [loops_by_evaluation, loops_by_benchmark, loops_by_remembering_benchmark])
async def test_a_drive_has_the_same_loops_wherever_it_is_judged(recogniser, loops_of):
    places, loops = await driven(recogniser)
    accepted = {pair for pair, loop in loops.items() if loop.state == "ACCEPTED"}
    assert loops_of(places, AsMethod(recogniser)) == accepted


@RECOGNISERS
async def test_evaluation_judges_a_drive_as_the_service_does(recogniser):
    places, loops = await driven(recogniser)
    drive = judged_by_evaluation(places, AsMethod(recogniser))
    judged = {(n, one.match.id): one.claim for n, row in enumerate(drive.candidates) for one in row}
    assert judged.keys() == loops.keys() and loops
    for pair, claim in judged.items():
        row = loops[pair]
        assert (claim.accepted, claim.reason) == (row.state == "ACCEPTED", row.reason), pair
        assert sorted(claim.doubts) == sorted(row.evidence.get("doubts", {})), pair
        assert (claim.support is not None) == ("support" in row.evidence), pair
        if row.T_match_query is not None:
            np.testing.assert_allclose(claim.T_match_query, pose_matrix(row.T_match_query), atol=1e-12)


async def test_pairs_alone_and_the_service_differ_where_houses_are_alike():
    """Else the test above could not fail."""
    recogniser = EqualBlocks()
    places, loops = await driven(recogniser)
    accepted = {pair for pair, loop in loops.items() if loop.state == "ACCEPTED"}
    drive = judged_by_evaluation(places, AsMethod(recogniser))
    alone = {
        (n, one.match.id)
        for n, row in enumerate(drive.candidates)
        for one in row
        if AsMethod(recogniser)
        .verify(places[n].description.place, places[one.match.id].description.place, 1.0)
        .accepted
    }
    assert alone > accepted or accepted - alone
