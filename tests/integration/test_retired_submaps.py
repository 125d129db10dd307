"""The best submaps of a place stay in the index; sessions age; the evidence of rejected pairs is forgotten."""

from __future__ import annotations

from dataclasses import replace

import pytest

from revisit.core.pair_verdict import RejectionReason
from revisit.service.domain.errors import NotFound, NotKept
from revisit.service.domain.identity import SessionKey
from revisit.service.domain.retention import RetentionRule, parsed
from revisit.service.domain.states import LoopState, SubmapState
from revisit.service.features.catalogue.downloads import DownloadKind
from revisit.service.features.index.answers import SearchCriteria
from revisit.service.features.loops.decisions import ProposeLoop
from revisit.service.features.resources.paging import PageRequest
from revisit.service.features.retention.due import under_review
from revisit.service.features.retention.rules import RankedSubmap, retired
from tests.support.retained import DAY_MS, HOUR_MS, driven, retained, stored_seqs
from tests.support.service_world import SESSION, TENANT, described, memory_world, postgres_world, sqlite_world

TUESDAY, WEDNESDAY = SessionKey("town", "tuesday"), SessionKey("town", "wednesday")
SCANS = 40


@pytest.fixture(params=[memory_world, sqlite_world, postgres_world], ids=["memory", "sqlite", "postgres"])
def world(request, tmp_path):
    made = request.param(tmp_path) if request.param is sqlite_world else request.param()
    yield made
    made.context.transactions.close()


def candidate(number: int, x_m: float, **fields) -> RankedSubmap:
    values = {"frame": "a", "storey": None, "flagged": False, "mean_score": 0.0, "point_count": 1}
    return RankedSubmap(number, position_m=(x_m, 0.0, 0.0), **{**values, **fields})


def test_a_submap_with_enough_better_ones_near_it_is_retired():
    line = [candidate(number, float(number)) for number in range(10)]
    for best in (1, 2, 3):
        gone = set(retired(line, best, 2.5))
        kept = [one for one in line if one.number not in gone]
        for one in line:
            near = sum(abs(one.position_m[0] - other.position_m[0]) < 2.5 for other in kept)
            assert near >= (best if one.number in gone else 1)


def test_the_best_are_without_flags_then_well_seen_by_others_then_dense_then_new():
    better = [
        candidate(1, 0.0, mean_score=0.9, point_count=1),
        candidate(2, 0.0, mean_score=0.5, point_count=9),
        candidate(3, 0.0, mean_score=0.5, point_count=1),
        candidate(5, 0.0),
        candidate(4, 0.0),
        candidate(9, 0.0, flagged=True, mean_score=1.0, point_count=99),
    ]
    for count in range(1, len(better)):
        assert retired(reversed(better), count, 1.0) == sorted(one.number for one in better[count:])


def test_other_frames_and_storeys_are_other_places():
    apart = [candidate(1, 0.0), candidate(2, 0.0, frame="b"), candidate(3, 0.0, storey="B2")]
    assert retired(apart, 1, 5.0) == []


async def twice_driven(world) -> None:
    """Two drives over the same places, in one frame of the map."""
    for session in (SESSION, TUESDAY):
        await driven(world, SCANS, session)
    await world.use_cases.map_versions.optimise(TENANT, "town")
    world.work_off()
    world.clock.ms += HOUR_MS


async def states(world, session: SessionKey) -> list[SubmapState]:
    page = await world.use_cases.submaps.list(TENANT, session, PageRequest(100))
    return [one.state for one in page.items]


async def version(world):
    return (await world.use_cases.map_versions.list(TENANT, "town", PageRequest())).items[-1]


async def test_the_best_of_a_place_stay_and_the_map_is_as_it_was(world):
    await twice_driven(world)
    before, loops = await version(world), await loops_in(world, LoopState.ACCEPTED)
    report = await retained(world, "best=1")
    (best,) = report.rules
    both = [*await states(world, SESSION), *await states(world, TUESDAY)]
    assert best.rule is RetentionRule.BEST_SUBMAPS and best.submaps == both.count(SubmapState.RETIRED) > 0
    assert both.count(SubmapState.DESCRIBED) >= len(both) // 3
    assert await version(world) == before
    assert [str(one) for one in await loops_in(world, LoopState.ACCEPTED)] == [str(one) for one in loops]
    assert await retained(world) == report


async def test_a_stricter_policy_retires_more_of_the_same_version(world):
    await twice_driven(world)
    await retained(world, "best=2")
    of_two = len(await of_state(world, SubmapState.RETIRED))
    await retained(world, "best=1")
    assert len(await of_state(world, SubmapState.RETIRED)) > of_two


async def test_what_a_review_held_goes_once_it_is_decided(world):
    await twice_driven(world)
    loop = await first_pair(world, state="REJECTED", reason="AMBIGUOUS")
    held = await retained(world, "best=1")
    work = world.context.transactions
    decided = work.read(lambda uow: uow.loops.get(TENANT, "town", loop.loop_id)).result()
    work.write(lambda uow: uow.loops.replace(replace(decided, reason="OVERRULED"))).result()
    again = await retained(world)
    assert held.submaps_held > 0 and again.submaps_held == 0 and again.rules[0].submaps <= held.submaps_held


async def test_a_retired_submap_is_out_of_the_index_and_says_so(world):
    await twice_driven(world)
    await retained(world, "best=1")
    gone = await of_state(world, SubmapState.RETIRED)
    kept = await of_state(world, SubmapState.DESCRIBED)
    hits = (await world.use_cases.searches.by_submap(TENANT, kept[0].key, SearchCriteria(k=100))).hits
    assert {hit.submap for hit in hits} <= {one.key for one in kept}
    with pytest.raises(NotKept, match="retired"):
        await world.use_cases.submaps.download(TENANT, gone[0].key, DownloadKind.DESCRIPTOR)
    assert (await world.use_cases.submaps.download(TENANT, gone[0].key, DownloadKind.NEURAL)).data
    with pytest.raises(NotKept):
        await world.use_cases.loop_decisions.propose(TENANT, ProposeLoop(gone[0].key, kept[0].key))


async def of_state(world, state: SubmapState):
    pages = [await world.use_cases.submaps.list(TENANT, one, PageRequest(100)) for one in (SESSION, TUESDAY)]
    return [one for page in pages for one in page.items if one.state == state]


async def first_pair(world, **fields):
    """Set fields of the first accepted loop of the map, as if it had been judged so."""
    work = world.context.transactions
    (loop, *_) = work.read(lambda uow: uow.loops.find(TENANT, map_id="town", state="ACCEPTED")).result()
    changed = replace(loop, **fields)
    work.write(lambda uow: uow.loops.replace(changed)).result()
    return changed


NOTHING_KEPT = f"scans=none,best=1,rejected={1 / 24}d,dropped={1 / 24}d,sessions={1 / 24}d,retired={1 / 24}d"


@pytest.mark.parametrize("state", [{"state": "PROPOSED"}, {"state": "REJECTED", "reason": "AMBIGUOUS"}])
async def test_nothing_goes_that_a_review_needs(world, state):
    await twice_driven(world)
    loop = await first_pair(world, **state)
    frames_apart(world)
    report = await retained(world, NOTHING_KEPT)
    assert report.submaps_held == 2
    rows = world.context.transactions.read(lambda uow: uow.submaps.numbered(TENANT, ends(loop))).result()
    assert {(row.state, row.kept_scans) for row in rows.values()} == {("DESCRIBED", "ALL")}
    for row in rows.values():
        wanted = range(row.first_seq, row.last_seq + 1)
        session = SessionKey(row.map_id, row.session_id)
        assert set(wanted) <= set(stored_seqs(world, session))
    assert (await world.use_cases.loops.get(TENANT, "town", loop.loop_id)).state == state["state"]


def frames_apart(world) -> None:
    """Give each session of the map a frame of its own."""

    def part(uow):
        for row in uow.session_poses.find(TENANT, map_id="town"):
            uow.session_poses.replace(replace(row, frame=f"frame-{row.session_number}"))

    world.context.transactions.write(part).result()


async def test_of_an_ambiguous_pair_in_one_frame_the_scans_go_and_stays_what_a_person_looks_at():
    world = memory_world()
    await twice_driven(world)
    world.clock.ms += HOUR_MS
    loop = await first_pair(world, state="REJECTED", reason="AMBIGUOUS", manual=True)
    for by_hand, released in ((True, 2), (False, 0)):
        loop = replace(loop, manual=by_hand)
        world.context.transactions.write(lambda uow, loop=loop: uow.loops.replace(loop)).result()
        held = world.context.transactions.read(lambda uow: under_review(uow, uow.maps.get(TENANT, "town"))).result()
        assert held.retired == {*ends(loop)} and len(held.released) == released
    planned = await world.use_cases.retention.preview(TENANT, "town", parsed(NOTHING_KEPT))
    report = await retained(world, NOTHING_KEPT)
    assert report.submaps_held == planned.submaps_held == 2
    assert totals(report) == totals(planned)
    rows = world.context.transactions.read(lambda uow: uow.submaps.numbered(TENANT, ends(loop))).result()
    assert {(row.state, row.kept_scans) for row in rows.values()} == {("DESCRIBED", "NONE")}
    assert all(row.place_sha256 and row.descriptor for row in rows.values())
    assert stored_seqs(world) == stored_seqs(world, TUESDAY) == []
    for row in rows.values():
        assert (await world.use_cases.submaps.download(TENANT, row.key, DownloadKind.NEURAL)).data


def totals(report) -> dict[str, int]:
    return {name: sum(getattr(one, name) for one in report.rules) for name in ("submaps", "scans", "loop_closures")}


def ends(loop) -> list[int]:
    return sorted({loop.query_number, loop.match_number})


async def test_an_aged_session_that_the_map_rests_on_keeps_its_poses(world):
    await twice_driven(world)
    before = await version(world)
    world.clock.ms += 31 * DAY_MS
    report = await retained(world, "sessions=30d")
    assert report.sessions_held == 2 and report.rules[0].rule is RetentionRule.SESSIONS
    assert {*await states(world, SESSION), *await states(world, TUESDAY)} == {SubmapState.RETIRED}
    assert stored_seqs(world) == [] and await version(world) == before


async def test_a_session_that_the_map_does_not_rest_on_goes_after_its_days(world):
    await twice_driven(world)
    await driven(world, SCANS, WEDNESDAY)
    await no_loops_with(world, WEDNESDAY)
    world.clock.ms += 8 * DAY_MS
    await retained(world, "dropped=9d")
    assert (await world.use_cases.sessions.get(TENANT, WEDNESDAY)).submap_count
    report = await retained(world, "dropped=7d")
    assert (report.rules[0].rule, report.rules[0].sessions) == (RetentionRule.SESSIONS, 1)
    with pytest.raises(NotFound):
        await world.use_cases.sessions.get(TENANT, WEDNESDAY)
    await world.context.erasure.all()
    assert stored_seqs(world, WEDNESDAY) == [] and len(stored_seqs(world, TUESDAY)) == SCANS


async def no_loops_with(world, session: SessionKey) -> None:
    """Forget the loops of a session and the versions of the map."""

    def forget(uow):
        for end in ("query_session_id", "match_session_id"):
            uow.loops.delete(TENANT, map_id="town", **{end: session.session_id})
        uow.session_poses.delete(TENANT, map_id="town", session_id=session.session_id)

    world.context.transactions.write(forget).result()


async def test_a_drive_that_goes_on_is_never_too_old(world):
    await described(world, a=1)
    world.clock.ms += 1000 * DAY_MS
    assert await retained(world, "sessions=1d,dropped=1d") is None


async def test_the_evidence_of_rejected_pairs_is_forgotten_after_its_days(world):
    await twice_driven(world)
    before = await loops_in(world, LoopState.REJECTED)
    world.clock.ms += 5 * DAY_MS
    assert await retained(world, "rejected=6d") is None
    report = await retained(world, "rejected=4d")
    assert report.rules[0].loop_closures == len(before) > 0
    assert await loops_in(world, LoopState.REJECTED) == []
    assert await loops_in(world, LoopState.ACCEPTED)
    gone = before[0].loop_id
    events = world.context.transactions.read(lambda uow: uow.loop_events.find(TENANT, map_id="town", loop_id=gone))
    assert events.result() == []


async def loops_in(world, state: LoopState):
    return list((await world.use_cases.loops.list(TENANT, "town", PageRequest(500), state=state)).items)


async def test_a_pair_that_a_person_has_rejected_or_a_version_names_is_remembered(world):
    await twice_driven(world)
    named = await first_pair(world, state="REJECTED", reason=RejectionReason.LOW_OVERLAP.value)
    second = (await loops_in(world, LoopState.ACCEPTED))[0]
    await world.use_cases.loop_decisions.reject(TENANT, "town", second.loop_id, "another hall")
    world.clock.ms += 400 * DAY_MS
    assert (await retained(world, "rejected=1d")).rules[0].loop_closures > 0
    for loop_id in (named.loop_id, second.loop_id):
        assert (await world.use_cases.loops.get(TENANT, "town", loop_id)).state == LoopState.REJECTED
