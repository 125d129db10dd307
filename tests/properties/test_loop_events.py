"""Whatever people, workers and versions of the map do to loops: the events of a loop alone give its stored state."""

from __future__ import annotations

import asyncio
import contextlib
import os

from hypothesis import Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from revisit.core.errors import BadField
from revisit.service.domain.errors import AlreadyExists
from revisit.service.domain.identity import SessionKey
from revisit.service.features.loops.decisions import ProposeLoop
from revisit.service.features.loops.rows import LoopStanding
from revisit.service.features.resources.paging import PageRequest
from tests.support.fleet_in_service import fleet_in
from tests.support.service_world import TENANT, memory_world, submap

EXAMPLES = int(os.environ.get("REVISIT_LOOP_EXAMPLES", "5"))
MAP = "fleet"
SMALL = {"sessions": 2, "submaps": 16, "per_pair": 5}

which = st.integers(0, 9)


class LoopsOfAMap(RuleBasedStateMachine):
    """A small simulated fleet with right and wrong loops, and all that may change them."""

    def __init__(self) -> None:
        super().__init__()
        self.world = memory_world()
        self.runner = asyncio.Runner()
        fleet_in(self.world, MAP, 0.4, **SMALL)
        self.decided: dict[str, list[str]] = {}

    def loops(self):
        return self.world.context.transactions.read(lambda uow: uow.loops.find(TENANT, map_id=MAP)).result()

    def events(self, loop):
        found = self.world.context.transactions.read(
            lambda uow: uow.loop_events.find(TENANT, map_id=MAP, loop_id=loop.loop_id)
        )
        return found.result()

    def chosen(self, number):
        loops = self.loops()
        return loops[number % len(loops)]

    @rule(number=which, accepted=st.booleans())
    def decide(self, number, accepted):
        loop, cases = self.chosen(number), self.world.use_cases.loop_decisions
        wanted = "ACCEPTED" if accepted else "REJECTED"
        try:
            self.runner.run((cases.accept if accepted else cases.reject)(TENANT, MAP, loop.loop_id))
        except BadField:
            assert accepted and loop.T_match_query is None
            return
        if wanted != loop.state:
            self.decided.setdefault(loop.loop_id, [loop.state]).append(wanted)

    @rule(number=which)
    def take_back(self, number):
        loop, before = self.chosen(number), None
        stack = self.decided.get(loop.loop_id, [])
        try:
            before = self.runner.run(self.world.use_cases.loop_decisions.revert(TENANT, MAP, loop.loop_id))
        except BadField:
            assert len(stack) < 2
            return
        stack.pop()
        assert before.state == stack[-1]

    @rule()
    def optimise(self):
        self.runner.run(self.world.use_cases.map_versions.optimise(TENANT, MAP))
        self.world.work_off()

    @rule(number=which)
    def bring_back(self, number):
        versions = self.runner.run(self.world.use_cases.map_versions.list(TENANT, MAP, PageRequest(500))).items
        if versions:
            chosen = versions[number % len(versions)]
            again = self.runner.run(self.world.use_cases.map_versions.revert(TENANT, MAP, chosen.version))
            assert again.content_hash == chosen.content_hash

    @rule(number=which)
    def delete_a_submap(self, number):
        loop = self.chosen(number)
        if len(self.loops()) > 5:
            key = submap(loop.query_submap_id, 1, SessionKey(MAP, loop.query_session_id)).key
            self.runner.run(self.world.use_cases.submaps.delete(TENANT, key))

    @rule(number=which)
    def propose(self, number):
        loop = self.chosen(number)
        keys = (
            submap(submap_id, 1, SessionKey(MAP, session_id)).key
            for session_id, submap_id in (
                (loop.match_session_id, loop.match_submap_id),
                (loop.query_session_id, loop.query_submap_id),
            )
        )
        with contextlib.suppress(AlreadyExists):
            self.runner.run(self.world.use_cases.loop_decisions.propose(TENANT, ProposeLoop(*keys)))

    @invariant()
    def the_events_of_a_loop_give_its_state(self):
        for loop in self.loops():
            assert LoopStanding.of(self.events(loop)[-1]) == LoopStanding.of(loop)

    @invariant()
    def only_accepted_loops_have_a_verdict_of_the_graph(self):
        assert {loop.state for loop in self.loops() if loop.graph_state is not None} <= {"ACCEPTED"}

    @invariant()
    def no_event_is_left_of_a_loop_that_is_gone(self):
        left = self.world.context.transactions.read(lambda uow: uow.loop_events.find(TENANT, map_id=MAP)).result()
        assert {event.loop_id for event in left} == {loop.loop_id for loop in self.loops()}

    def teardown(self):
        self.runner.close()


TestLoopsOfAMap = LoopsOfAMap.TestCase
# Without shrinking, which takes minutes here: the steps are told as they were.
TestLoopsOfAMap.settings = settings(
    max_examples=EXAMPLES, stateful_step_count=20, deadline=None, phases=[Phase.generate]
)
