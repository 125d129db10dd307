"""Flags of submaps that are findings of their session: made-up rows."""

from __future__ import annotations

from dataclasses import replace

import pytest

from revisit.service.domain.identity import SessionKey
from tests.support.fleet_in_service import fleet_in
from tests.support.service_world import TENANT, memory_world


@pytest.mark.parametrize(
    ("flag", "of_20", "told"), [("odometry_bends", 4, False), ("odometry_bends", 5, True), ("pose_jump", 1, True)]
)
async def test_an_odometry_that_bends_here_and_there_is_no_finding_of_a_drive(flag, of_20, told):
    world = memory_world()
    fleet_in(world, "town", sessions=1, submaps=20, per_pair=0)

    def flagged(uow):
        (session,) = uow.sessions.find(TENANT, map_id="town")
        uow.sessions.replace(replace(session, next_ordinal=20))
        for n, row in enumerate(uow.submaps.find(TENANT, map_id="town")):
            uow.submaps.replace(replace(row, flags=(flag,) if n < of_20 else ()))

    world.context.transactions.write(flagged).result()
    found = await world.use_cases.sessions.get(TENANT, SessionKey("town", "s0"))
    assert [(one.code, one.submaps) for one in found.findings] == [(flag, of_20)] * told
