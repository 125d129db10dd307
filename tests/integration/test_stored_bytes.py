"""What a submap leaves on the disk: which blobs, and how many bytes of rows (docs/reference/measurements.md)."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from revisit.core.acceptance import TELLING
from revisit.core.verification import RejectedLoop
from revisit.service.adapters.core_recogniser import load_recogniser
from revisit.service.domain.states import LoopState
from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.catalogue.sessions import CreateSession
from revisit.service.features.loops.claims import verdict_evidence
from revisit.service.features.resources.paging import PageRequest
from tests.contract.test_place_recogniser import CONFIG, TILTED, seen_from
from tests.support.fake_recogniser import FakeRecogniser
from tests.support.service_world import SESSION, TENANT, described, posted, sqlite_world, submap
from tests.support.stored_rows import run

SUBMAPS = 30
DESCRIPTOR_BYTES = 4 * 8  # of the fake recogniser; the real one's takes 4.1 kB

MOST_OF_A_SUBMAP = 1_600
MOST_OF_A_PAIR = 1_000
"""Bytes of rows, with their indexes and the pages that are not full."""


@pytest.fixture(scope="module")
def rejected() -> RejectedLoop:
    """The verdict of the method on two streets that have little in common."""
    own = load_recogniser()
    places = [own.describe(seen_from(TILTED, number), CONFIG).place for number in (1, 2)]
    verdict = own.verify(*places, 0.5, CONFIG)
    assert isinstance(verdict, RejectedLoop) and verdict.reason not in TELLING and verdict.measurement is not None
    return verdict


@pytest.fixture
def world(tmp_path):
    made = sqlite_world(tmp_path)
    yield made
    made.context.transactions.close()


class Rejecting(FakeRecogniser):
    """By it every pair has the same verdict."""

    model_version = "revisit-c770bc1eb8cd"

    def __init__(self, verdict: RejectedLoop) -> None:
        self.verdict = verdict

    def verify(self, *_: object, **__: object) -> RejectedLoop:
        """The verdict."""
        return self.verdict


async def stored_pairs(world, verdict: RejectedLoop) -> int:
    """Describe submaps that are all compared with others, with this verdict; how many pairs there are."""
    await world.use_cases.maps.create(TENANT, CreateMap(SESSION.map_id, leave_distance_m=0.0))
    await world.use_cases.sessions.create(TENANT, CreateSession(SESSION.map_id, SESSION.session_id))
    for number in range(SUBMAPS):
        await world.use_cases.posting.post(TENANT, submap(f"s{number}", number))
    world.work_off(Rejecting(verdict))
    return int(run(world.home / "revisit.db", "SELECT count(*) FROM loop_closures")[0][0])


async def test_a_submap_leaves_its_cloud_its_place_and_its_neural_map_and_nothing_else(world, tmp_path):
    await described(world, a=1, b=2)
    kinds = {
        path.relative_to(tmp_path / "blobs").parts[1] for path in (tmp_path / "blobs").rglob("*") if path.is_file()
    }
    assert kinds == {"cloud", "signature", "neural-map"}


async def test_the_evidence_of_a_rejected_pair_takes_at_most_a_hundred_bytes(world, rejected):
    pairs = await stored_pairs(world, rejected)
    assert pairs > 10 * SUBMAPS
    longest = run(world.home / "revisit.db", "SELECT max(length(evidence)) FROM loop_closures")
    events = run(world.home / "revisit.db", "SELECT max(length(T_match_query)), max(length(details)) FROM loop_events")
    assert longest[0][0] <= 100 and events[0][0] <= 100 and events[0][1] <= 40


async def test_what_people_are_told_of_a_rejected_pair_is_kept(world, rejected):
    await stored_pairs(world, rejected)
    loop = (await world.use_cases.loops.list(TENANT, "town", PageRequest(), state=LoopState.REJECTED)).items[0]
    known = verdict_evidence(rejected, CONFIG.verification)
    np.testing.assert_array_equal(loop.T_match_query, rejected.measurement.T_match_query.ravel())
    assert loop.evidence["thresholds"] == known["thresholds"]
    assert loop.evidence["thresholds_version"] == known["thresholds_version"]
    kept, known = loop.evidence["measurement"], known["measurement"]
    for name in ("overlap", "contrast", "seen_through", "rmse_m", "common_share", "enough_share"):
        assert kept[name] == pytest.approx(known[name], abs=5.1e-5), name
    sigma = np.sqrt(np.diag(known["covariance"]))
    off = (np.array(kept["covariance"]) - known["covariance"]) / np.outer(sigma, sigma)
    assert kept["inliers"] == known["inliers"] and np.abs(off).max() < 2e-3


@pytest.mark.parametrize("reason", TELLING)
async def test_the_evidence_of_a_pair_that_decides_about_others_is_kept_to_the_bit(world, rejected, reason):
    verdict = replace(rejected, reason=reason)
    await posted(world, a=1, b=12, c=1)
    world.work_off(Rejecting(verdict))
    (loop,) = (await world.use_cases.loops.list(TENANT, "town", PageRequest())).items
    assert loop.reason == reason
    # How distinct the place of an ambiguous one is comes to that, and members that are not JSON become JSON.
    known = json.loads(json.dumps(verdict_evidence(verdict, CONFIG.verification)))
    assert {name: loop.evidence[name] for name in known} == known


async def test_the_rows_of_a_submap_and_of_its_rejected_pairs_are_bounded(world, rejected, tmp_path):
    empty = database_bytes(tmp_path)
    pairs = await stored_pairs(world, rejected)
    grown = database_bytes(tmp_path) - empty
    assert grown <= SUBMAPS * (MOST_OF_A_SUBMAP + DESCRIPTOR_BYTES) + pairs * MOST_OF_A_PAIR


def database_bytes(home: Path) -> int:
    run(home / "revisit.db", "PRAGMA wal_checkpoint(TRUNCATE)")
    return (home / "revisit.db").stat().st_size
