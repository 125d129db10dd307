"""Candidates of one submap are compared in turn, until the loops so far tell where the others lie (decision 0161)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from revisit.core.config import PipelineConfig
from revisit.core.geometry import se3
from revisit.service.domain.identity import SessionKey
from revisit.service.features.catalogue.sessions import CreateSession
from revisit.service.features.resources.paging import PageRequest
from tests.support.fake_recogniser import FakeRecogniser
from tests.support.service_world import SESSION, TENANT, memory_world, open_session, submap
from tests.support.verdicts import rejected, verified

ENOUGH = PipelineConfig().loop.enough
SECOND = SessionKey("town", "tuesday")
STATIONS = range(0, 60, 5)
AT_M = 30


class Street(FakeRecogniser):
    """Submaps at most 15 m apart are loops, with the true pose where `true`, else one that says something else."""

    def __init__(self, *, true: bool) -> None:
        self._true = true
        self.guesses: list[tuple[float, float | None]] = []

    def describe(self, given, config):
        return replace(super().describe(given, config), place=np.float64(given.T_odom_submap[0, 3]).tobytes())

    def verify(self, query, match, similarity, config, initial=None):
        at, other = (float(np.frombuffer(one)[0]) for one in (query, match))
        self.guesses.append((at - other, None if initial is None else float(initial.T_match_query[0, 3])))
        if abs(at - other) > 15.0:
            return rejected()
        aside_m = 0.0 if self._true else 2.0 * len(self.guesses)
        pose = se3.from_yaw(0.0, (at - other, aside_m, 0.0))
        return verified(pose)


async def loops_of_a_second_visit(recogniser):
    world = memory_world()
    await open_session(world)
    await world.use_cases.sessions.create(TENANT, CreateSession(SECOND.map_id, SECOND.session_id))
    for station in STATIONS:
        await world.use_cases.posting.post(TENANT, submap(f"monday-{station}", station, SESSION))
    world.work_off(recogniser)
    recogniser.guesses.clear()
    await world.use_cases.posting.post(TENANT, submap(f"tuesday-{AT_M}", AT_M, SECOND))
    world.work_off(recogniser)
    page = await world.use_cases.loops.list(TENANT, "town", PageRequest(500), session_id=SECOND.session_id)
    world.context.transactions.close()
    return page.items


async def test_a_place_gets_as_many_loops_with_a_drive_as_are_enough_and_a_guess_for_all_but_the_first():
    recogniser = Street(true=True)
    loops = await loops_of_a_second_visit(recogniser)
    accepted = [loop for loop in loops if loop.state == "ACCEPTED"]
    assert len(accepted) == ENOUGH
    assert len(loops) == len(recogniser.guesses) < len(STATIONS)
    first = next(row for row, (true_m, _) in enumerate(recogniser.guesses) if abs(true_m) <= 15.0)
    assert all(guess is None for _, guess in recogniser.guesses[: first + 1])
    assert recogniser.guesses[first + 1 :]
    for true_m, guess in recogniser.guesses[first + 1 :]:
        assert guess is None if abs(true_m) > 30.0 else abs(guess - true_m) < 1e-9


async def test_where_loops_contradict_each_other_every_candidate_is_compared():
    recogniser = Street(true=False)
    loops = await loops_of_a_second_visit(recogniser)
    assert len(loops) == len(recogniser.guesses) == len(STATIONS)
