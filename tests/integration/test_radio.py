"""Twins of one plan that one drive has mapped: radio that is posted with a drive tells them apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.service.domain.identity import SessionKey
from revisit.service.domain.states import LoopState
from revisit.service.features.catalogue.sessions import CreateSession
from revisit.service.features.radio.calls import RadioReading
from tests.support.fake_recogniser import FakeRecogniser
from tests.support.service_world import SESSION, TENANT, memory_world, open_session, submap
from tests.support.verdicts import rejected, verified

SECOND = SessionKey("town", "tuesday")
SECONDS = 10**9
HALL, TWIN, OTHER = (0, 10), (100, 110), (300, 310)
"""Stations on the first drive, metres."""


class Twins(FakeRecogniser):
    """Two submaps of one spot are a loop, and so are two of the same spot of the twins, 200 m apart."""

    def describe(self, given, config):
        return replace(super().describe(given, config), place=np.float64(given.T_odom_submap[0, 3]).tobytes())

    def verify(self, query, match, similarity, config, initial=None):
        off = float(np.frombuffer(query)[0] - np.frombuffer(match)[0])
        near = [off - shift for shift in (0.0, 200.0, -200.0) if abs(off - shift) < 1.0]
        return verified(se3.from_yaw(0.0, (near[0], 0.3, 0.0))) if near else rejected()


async def driven(world, session, *stations, heard) -> None:
    """A drive passes stations; `heard` says which access points it hears there."""
    for station in stations:
        at_ns = 20 * SECONDS * (station + 1)
        if (names := heard(station)) is not None:
            reading = RadioReading(at_ns, tuple(f"{name:016x}" for name in names), tuple(-50 for _ in names))
            await world.use_cases.radio.post(TENANT, session, [reading])
        posted = replace(submap(f"{session.session_id}-{station}", station, session), stamp_ns=at_ns)
        await world.use_cases.posting.post(TENANT, posted)
        world.work_off(Twins())


def heard_there(station):
    """Of three parts of the site each has access points of its own."""
    return range(10 * (station // 100), 10 * (station // 100) + 5)


def replaced(station):
    """All access points are others."""
    return [100 + name for name in heard_there(station)]


async def loops_of_the_twin(heard):
    world = memory_world()
    await open_session(world)
    await world.use_cases.sessions.create(TENANT, CreateSession(SECOND.map_id, SECOND.session_id))
    await driven(world, SESSION, *HALL, *TWIN, *OTHER, heard=heard_there)
    await driven(world, SECOND, *HALL, *TWIN, heard=heard)
    await world.use_cases.sessions.finish(TENANT, SECOND)  # no loop waits any more
    rows = world.context.transactions.read(lambda uow: uow.loops.find(TENANT)).result()
    of_query = {row.match_submap_id: row for row in rows if row.query_submap_id == "tuesday-100"}
    world.context.transactions.close()
    return of_query


async def test_a_twin_that_hears_other_radio_is_refuted_with_the_reason():
    loops = await loops_of_the_twin(heard_there)
    twin = loops["monday-300"]
    assert (twin.state, twin.reason) == (LoopState.REJECTED, "AMBIGUOUS")
    told = twin.evidence["doubts"]["RADIO_DISAGREES"]
    assert (told["radio"], told["elsewhere"]) == (0.0, 1.0) and "at another spot" in told["words"]
    assert loops["monday-100"].state == LoopState.ACCEPTED and "doubts" not in loops["monday-100"].evidence


@pytest.mark.parametrize("heard", [lambda _: None, replaced], ids=["none", "replaced"])
async def test_radio_that_says_nothing_changes_no_verdict(heard):
    loops = await loops_of_the_twin(heard)
    assert all("RADIO_DISAGREES" not in row.evidence.get("doubts", {}) for row in loops.values())
    assert loops["monday-300"].state == (await loops_of_the_twin(lambda _: None))["monday-300"].state
