"""A loop that is registered from where a person put it knows what is known of its pair (docs/decisions/0371)."""

from __future__ import annotations

import pytest

from revisit.core.geometry import se3
from revisit.core.verification import Authority
from revisit.service.domain.identity import SubmapKey
from revisit.service.domain.states import LoopEventKind, LoopState
from revisit.service.features.loops.decisions import ProposeLoop
from revisit.service.features.resources.paging import PageRequest
from tests.integration.test_loops_beside import PERIOD_M, EqualBlocks, RowOfHouses, driven_twice
from tests.support.service_world import TENANT, memory_world
from tests.support.verdicts import rejected, verified


def keys(query: str, match: str) -> tuple[SubmapKey, SubmapKey]:
    return SubmapKey("town", query.split("-")[0], query), SubmapKey("town", match.split("-")[0], match)


async def registered(world, recogniser, query: str, match: str, x_m: float | None):
    """The loop of two submaps after a worker has registered it, from x metres along where a start is given."""
    start = None if x_m is None else se3.from_yaw(0.0, (x_m, 0.3, 0.0))
    proposed = await world.use_cases.loop_decisions.propose(TENANT, ProposeLoop(*keys(query, match), start))
    world.work_off(recogniser)
    return await world.use_cases.loops.get(TENANT, "town", proposed.loop.loop_id)


class Houses(RowOfHouses):
    """A row of houses without an end, whose pairs are ambiguous wherever their registration starts."""

    def __init__(self) -> None:
        super().__init__(end_m=1e9)
        self.asked = []

    def verify(self, query, match, similarity, config, initial=None):
        self.asked.append(initial)
        return super().verify(query, match, similarity, config, initial)


@pytest.mark.parametrize("x_m", [0.0, PERIOD_M])
async def test_a_start_by_hand_in_a_row_of_equal_houses_is_ambiguous(x_m):
    world, recogniser = memory_world(), Houses()
    await driven_twice(world, recogniser)
    loop = await registered(world, recogniser, "tuesday-20", "monday-20", x_m)
    assert (loop.state, loop.reason, loop.manual) == (LoopState.REJECTED, "AMBIGUOUS", True)
    assert recogniser.asked[-1].authority is Authority.COMPETES
    assert recogniser.asked[-1].T_match_query[0, 3] == pytest.approx(x_m)


@pytest.mark.parametrize("pair", [("tuesday-20", "monday-20"), ("monday-20", "tuesday-20")], ids=["as is", "exchanged"])
async def test_the_doubts_of_a_pair_stand_against_a_start_by_hand(pair):
    world, recogniser = memory_world(), EqualBlocks()
    loops = await driven_twice(world, recogniser)
    (own,) = [loop for loop in loops if {loop.query, loop.match} == set(keys(*pair))]
    assert own.reason == "AMBIGUOUS"
    loop = await registered(world, recogniser, *pair, 0.0)
    assert (loop.state, loop.reason) == (LoopState.REJECTED, "AMBIGUOUS")
    assert loop.evidence["doubts"].keys() == own.evidence["doubts"].keys()


class OneAlone(EqualBlocks):
    """Blocks that fit wherever registration starts: another pose of a pair finds none that competes."""

    def verify(self, query, match, similarity, config, initial=None):
        if initial is not None and initial.authority is Authority.COMPETES:
            return verified(initial.T_match_query)
        return Houses().verify(query, match, similarity, config, initial)


async def test_the_poses_that_a_pair_is_known_to_have_are_rivals_of_a_start_by_hand():
    world, recogniser = memory_world(), OneAlone()
    await driven_twice(world, recogniser)
    loop = await registered(world, recogniser, "monday-20", "tuesday-20", 0.0)
    assert (loop.state, loop.reason) == (LoopState.REJECTED, "AMBIGUOUS")
    rivals = [rival["T_match_query"][0][3] for rival in loop.evidence["measurement"]["rivals"]]
    assert sorted(rivals) == pytest.approx([-PERIOD_M, PERIOD_M])


async def test_a_start_by_hand_is_noted_with_who_gave_it():
    world, recogniser = memory_world(), Houses()
    await driven_twice(world, recogniser)
    by_hand = await registered(world, recogniser, "tuesday-20", "monday-20", 0.0)
    sought = await registered(world, recogniser, "tuesday-30", "monday-30", None)
    starts = []
    for loop in (by_hand, sought):
        events = await world.use_cases.loop_decisions.events(TENANT, "town", loop.loop_id, PageRequest())
        assert [event.kind for event in events.items] == [LoopEventKind.PROPOSED, LoopEventKind.VERIFIED]
        starts.append(events.items[0].details.get("start"))
    assert starts == ["by hand", None]
    rows = [row for row in await world.use_cases.audit.newest(10) if row.action == "loop_proposed"]
    named = [f"maps/town/loopClosures/{loop.loop_id}" for loop in (by_hand, sought)]
    assert [(row.subject, row.detail.get("start")) for row in rows] == list(zip(named, starts, strict=True))
    assert {row.actor for row in rows} == {"operator"}
    await world.use_cases.loop_decisions.accept(TENANT, "town", by_hand.loop_id)
    accepted = (await world.use_cases.audit.newest(1))[0]
    assert (accepted.action, accepted.detail) == ("loop_accepted", {"start": "by hand"})


class OneAloneAfterAnEnd(OneAlone):
    """As OneAlone; beyond the end of the row geometry tells the places apart."""

    def verify(self, query, match, similarity, config, initial=None):
        if initial is not None and initial.authority is Authority.COMPETES:
            return verified(initial.T_match_query)
        return RowOfHouses(end_m=30.0).verify(query, match, similarity, config, initial)


async def own_loop(world, pair):
    page = await world.use_cases.loops.list(TENANT, "town", PageRequest(500))
    (own,) = [loop for loop in page.items if {loop.query, loop.match} == set(keys(*pair)) and not loop.manual]
    return own


@pytest.mark.parametrize("recogniser", [OneAlone, EqualBlocks], ids=["other poses", "doubts"])
async def test_a_pair_that_was_ambiguous_stays_so_after_a_person_has_accepted_and_rejected_it(recogniser):
    world, pair = memory_world(), ("tuesday-20", "monday-20")
    await driven_twice(world, recogniser())
    own = await own_loop(world, pair)
    assert own.reason == "AMBIGUOUS"
    await world.use_cases.loop_decisions.accept(TENANT, "town", own.loop_id)
    await world.use_cases.loop_decisions.reject(TENANT, "town", own.loop_id)
    loop = await registered(world, recogniser(), *pair, PERIOD_M)
    assert (loop.state, loop.reason) == (LoopState.REJECTED, "AMBIGUOUS")


@pytest.mark.parametrize(("x_m", "reason"), [(PERIOD_M, "AMBIGUOUS"), (0.0, None)], ids=["another pose", "its pose"])
async def test_a_start_by_hand_joins_no_pair_in_another_pose_than_its_accepted_loop(x_m, reason):
    world, pair = memory_world(), ("tuesday-20", "monday-20")
    await driven_twice(world, OneAloneAfterAnEnd())
    own = await own_loop(world, pair)
    assert own.state == LoopState.ACCEPTED and own.evidence["support"]["ruled_out"]
    loop = await registered(world, OneAloneAfterAnEnd(), *pair, x_m)
    assert loop.reason == reason
    if reason is not None:
        await world.use_cases.loop_decisions.reject(TENANT, "town", own.loop_id)
        assert (await registered(world, OneAloneAfterAnEnd(), *pair, x_m + 0.1)).reason == "AMBIGUOUS"


class LonelyBeyond(EqualBlocks):
    """A pair without a claim of the service that fits in many poses, in one of them alone."""

    def verify(self, query, match, similarity, config, initial=None):
        if initial is None:
            return rejected()
        return (
            verified(initial.T_match_query)
            if initial.T_match_query[0, 3] > 15.0
            else Houses().verify(query, match, similarity, config, initial)
        )


async def test_starts_that_are_tried_one_after_another_find_no_pose_that_counts_alone():
    world, pair = memory_world(), ("tuesday-20", "monday-20")
    await driven_twice(world, LonelyBeyond())
    tried = [await registered(world, LonelyBeyond(), *pair, x_m) for x_m in (0.0, PERIOD_M, 2 * PERIOD_M)]
    assert [loop.reason for loop in tried] == ["AMBIGUOUS"] * 3
    exchanged = await registered(world, LonelyBeyond(), *reversed(pair), 2 * PERIOD_M)
    assert exchanged.reason == "AMBIGUOUS"
