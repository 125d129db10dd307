"""A merge whose worker is killed goes on with the pairs that it has verified, and ends as if nothing had been."""

from __future__ import annotations

import json
from dataclasses import fields, replace

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.core.pair_verdict import LoopMeasurement, RejectedLoop, RejectionReason, VerifiedLoop
from revisit.service.calls.operations import operation_fields
from revisit.service.domain.records import SubmapRecord
from revisit.service.engines.local.files.blobs import FileBlobStore
from revisit.service.features.loops.claims import stored_verdict, verdict_of
from revisit.service.features.merging import job, portions
from revisit.service.features.merging.calls import MergeMap
from revisit.service.features.merging.reading import read_merge
from revisit.service.features.retention.removal import retire
from revisit.service.features.upkeep.sweeping import UNREFERENCED_S, collect, sweep
from revisit.service.ports.blobs import MERGE_PORTION_BLOB, BlobStore, StoredBlob
from tests.support.fake_merger import FakeMerger
from tests.support.fake_recogniser import FakeRecogniser
from tests.support.fleet_in_service import fleet_in_two
from tests.support.service_world import TENANT, World, memory_world
from tests.support.verdicts import measured


class Killed(BaseException):
    """The end of a process, as far as a worker in this one can tell."""


class CountingRecogniser(FakeRecogniser):
    """Counts the pairs that it verifies; is killed at the one of number `dies_at`."""

    def __init__(self, dies_at: int | None = None) -> None:
        self.pairs, self._dies_at = 0, dies_at

    def verify(self, *asked):
        self.pairs += 1
        if self.pairs == self._dies_at:
            raise Killed
        return super().verify(*asked)


async def merging(blobs: BlobStore | None = None) -> tuple[World, str]:
    """Two robots in a map each, and the merge of the one into the other, which waits."""
    world = memory_world(blobs=blobs)
    fleet_in_two(world, ("one", "two"), sessions=2, submaps=30, per_pair=0)
    posted = await world.use_cases.map_merges.merge(TENANT, MergeMap("one", "two"))
    return world, posted.operation.operation_id


def run(world: World, recogniser: FakeRecogniser) -> None:
    """The run of the next worker, after the lease of the last one."""
    world.clock.ms += 60_000
    world.worker(recogniser).run(world.claim())


async def ending(world: World, operation_id: str) -> tuple[dict, list]:
    """The result of a merge, and the poses of the version that it made: to a bit."""
    job = await world.use_cases.operations.get(TENANT, operation_id)
    poses = world.context.transactions.read(lambda uow: uow.session_poses.find(TENANT, map_id="one")).result()
    result = {name: value for name, value in (job.result or {}).items() if name != "merge"}
    return result, [replace(one, created_at_ns=0) for one in poses]


def kept(world: World) -> list[StoredBlob]:
    """The blobs with verdicts of merges."""
    return [blob for blob in world.context.blobs.stored(-1.0) if blob.kind == MERGE_PORTION_BLOB]


@pytest.fixture(autouse=True)
def stored_at_once(monkeypatch) -> None:
    monkeypatch.setattr(portions, "STORE_EVERY_MS", 0)


async def test_a_killed_merge_goes_on_with_the_pairs_that_it_has_verified():
    undisturbed, merge = await merging()
    run(undisturbed, whole := CountingRecogniser())
    world, killed = await merging()
    with pytest.raises(Killed):
        run(world, CountingRecogniser(whole.pairs // 2))
    run(world, rest := CountingRecogniser())
    assert rest.pairs == whole.pairs - (whole.pairs // 2 - 1) < whole.pairs
    assert await ending(world, killed) == await ending(undisturbed, merge)
    assert kept(world) == kept(undisturbed) == []


async def test_a_merge_ends_each_portion_of_its_time_and_no_attempt_counts(monkeypatch):
    undisturbed, merge = await merging()
    run(undisturbed, whole := CountingRecogniser())
    world, portioned = await merging()
    monkeypatch.setattr(portions, "PORTION_MS", 0)
    pairs = 0
    while world.context.transactions.read(lambda uow: uow.jobs.unfinished(TENANT, [portioned])).result():
        run(world, some := CountingRecogniser())
        pairs += some.pairs
        assert some.pairs <= 1 and len(kept(world)) <= 1
    assert pairs == whole.pairs
    assert (await world.use_cases.operations.get(TENANT, portioned)).attempts == 1
    assert await ending(world, portioned) == await ending(undisturbed, merge)


async def test_a_portion_begins_with_its_first_pair_however_long_both_maps_are_read(monkeypatch):
    world, merge = await merging()

    def slowly(uow, **asked):
        world.clock.ms += 2 * portions.PORTION_MS
        return read_merge(uow, **asked)

    monkeypatch.setattr(job, "read_merge", slowly)
    run(world, CountingRecogniser())
    assert (await world.use_cases.operations.get(TENANT, merge)).state == "DONE"


async def test_verdicts_of_a_merge_that_is_cancelled_between_two_runs_are_gone():
    world, merge = await merging()
    with pytest.raises(Killed):
        run(world, CountingRecogniser(5))
    assert len(kept(world)) == 1
    world.context.transactions.write(lambda uow: uow.queue.release("w1", "killed")).result()
    cancelled = await world.use_cases.operations.cancel(TENANT, merge)
    assert (cancelled.state, kept(world)) == ("DONE", [])


async def test_a_merge_whose_kept_verdicts_are_lost_begins_anew():
    undisturbed, merge = await merging()
    run(undisturbed, whole := CountingRecogniser())
    world, killed = await merging()
    with pytest.raises(Killed):
        run(world, CountingRecogniser(whole.pairs // 2))
    world.context.blobs.delete(kept(world))
    run(world, again := CountingRecogniser())
    assert again.pairs == whole.pairs
    assert await ending(world, killed) == await ending(undisturbed, merge)


async def test_verdicts_of_a_merge_that_waits_for_hours_are_not_swept():
    undisturbed, _ = await merging()
    run(undisturbed, whole := CountingRecogniser())
    world, waiting = await merging()
    with pytest.raises(Killed):
        run(world, CountingRecogniser(whole.pairs // 2))
    for _ in range(2):  # found by the first sweep, collected after the second
        await sweep(world.context.storage)
        world.clock.ms += int(1000 * UNREFERENCED_S)
        await collect(world.context.storage)
    run(world, rest := CountingRecogniser())
    assert rest.pairs < whole.pairs
    assert (await world.use_cases.operations.get(TENANT, waiting)).state == "DONE"
    assert kept(world) == []


async def test_verdicts_of_a_merge_of_which_a_bit_has_flipped_are_found_anew(tmp_path):
    undisturbed, merge = await merging()
    run(undisturbed, whole := CountingRecogniser())
    blobs = FileBlobStore(tmp_path)
    world, damaged = await merging(blobs)
    with pytest.raises(Killed):
        run(world, CountingRecogniser(whole.pairs // 2))
    (file,) = (path for path in tmp_path.rglob("*") if path.name == kept(world)[0].sha256)
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 4
    file.write_bytes(data)
    run(world, again := CountingRecogniser())
    assert (again.pairs, blobs.quarantined()) == (whole.pairs, 1)
    assert await ending(world, damaged) == await ending(undisturbed, merge)


async def test_a_merge_copies_no_place_that_retention_has_taken_meanwhile():
    world, merge = await merging()
    numbers = [one.number for one in of_map(world, "two")[5:12]]

    def taken(uow) -> None:
        retire(uow, uow.maps.get(TENANT, "two"), numbers)

    class Meanwhile(FakeMerger):
        def align(self, *asked):
            if len(of_map(world, "two")) == 30:
                world.context.transactions.write(taken).result()
            return super().align(*asked)

    world.merger = Meanwhile()
    run(world, CountingRecogniser())
    result, _ = await ending(world, merge)
    assert result["verdict"] == "MERGED"
    copies = [one.submap_id for one in of_map(world, "one") if one.session_id == "s1"]
    assert copies == [one.submap_id for one in of_map(world, "two")] and len(copies) == 23


def of_map(world: World, map_id: str) -> list[SubmapRecord]:
    """The described submaps of a map."""
    equals = {"map_id": map_id, "state": "DESCRIBED"}
    return world.context.transactions.read(lambda uow: uow.submaps.find(TENANT, **equals)).result()


async def test_verdicts_that_rest_on_other_grounds_are_not_taken_over():
    undisturbed, _ = await merging()
    run(undisturbed, whole := CountingRecogniser())
    world, merge = await merging()
    with pytest.raises(Killed):
        run(world, CountingRecogniser(20))
    world.context.transactions.write(
        lambda uow: uow.maps.replace(replace(uow.maps.get(TENANT, "one"), min_overlap=0.11))
    ).result()
    run(world, again := CountingRecogniser())
    assert again.pairs == whole.pairs
    assert (await world.use_cases.operations.get(TENANT, merge)).state == "DONE"


async def test_what_a_merge_keeps_is_no_news_to_clients():
    world, merge = await merging()
    with pytest.raises(Killed):
        run(world, CountingRecogniser(5))
    told = operation_fields(await world.use_cases.operations.get(TENANT, merge))
    assert set(told["progress"]) == {"stage", "done", "total"}


MEASURED = measured(
    se3.from_yaw(0.1, (1.0 / 3.0, 2.0, 0.0)), 0.7, rivals=[np.eye(4)], covariance=np.diag(np.arange(6.0))
)


@pytest.mark.parametrize(
    "verdict", [VerifiedLoop(MEASURED), VerifiedLoop(replace(MEASURED, covariance=np.full((6, 6), np.nan), rivals=()))]
)
def test_a_verdict_comes_back_to_a_bit(verdict):
    found, given = verdict_of(json.loads(json.dumps(stored_verdict(verdict)))).measurement, verdict.measurement
    for field in fields(LoopMeasurement):
        if field.name != "rivals":
            np.testing.assert_array_equal(getattr(found, field.name), getattr(given, field.name))
    assert [(one.overlap, one.T_match_query.tolist()) for one in found.rivals] == [
        (one.overlap, one.T_match_query.tolist()) for one in given.rivals
    ]


def test_of_a_rejected_pair_the_reason_comes_back():
    rejected = RejectedLoop(RejectionReason.LOW_OVERLAP, message="too little")
    assert verdict_of(json.loads(json.dumps(stored_verdict(rejected)))) == rejected
